"""The command `export`."""

import pathlib
from typing import Annotated

import typer

from pushfric_core.commands.application import Application
from pushfric_core.commands.console import say
from pushfric_core.commands.options import CellOption, ObjectOption, PartialFlag
from pushfric_core.commands.planning import ModelArgument, known
from pushfric_core.errors import InvalidInput
from pushfric_core.files.disk import make_folder, write_whole
from pushfric_core.formats.body import GRAVITY, HEIGHT, PUSHER_RADIUS
from pushfric_core.formats.export import FORMATS
from pushfric_core.formats.export import export as exported

app = Application()


@app.command()
def export(
    model: ModelArgument,
    to: Annotated[str, typer.Option(help=f"One of {', '.join(FORMATS)}.", metavar="FORMAT", show_default=False)],
    mass: Annotated[float | None, typer.Option(help="Of the object [kg].", show_default=False)] = None,
    table_friction: Annotated[float | None, typer.Option(help="Coefficient of the table.", show_default=False)] = None,
    gravity: Annotated[float, typer.Option(help="[m/s^2].")] = GRAVITY,
    pusher_radius: Annotated[float, typer.Option(help="Of the round tip [m].")] = PUSHER_RADIUS,
    height: Annotated[
        float | None, typer.Option(help=f"Of the object [m]; by default its own, or {HEIGHT:g}.", show_default=False)
    ] = None,
    samples: Annotated[
        int | None, typer.Option(help="Write this many of the belief's samples instead of the mean.", min=1, show_default=False)
    ] = None,
    out: Annotated[pathlib.Path, typer.Option(help="Folder to write to.")] = pathlib.Path("."),
    object_name: ObjectOption = "",
    namespace: CellOption = None,
    partial: PartialFlag = False,
) -> None:
    """Slow motions depend neither on the mass nor on the table's friction. The files say which of them is assumed."""
    with known(model, object_name, namespace, partial) as (file, pushed):
        make_folder(out)
        friction = file.friction()
        if samples is not None and len(friction.w) == 1:
            raise InvalidInput(f"{model}: has a single sample, not some to draw {samples} models from; leave out --samples")
        names = [pushed.name] if samples is None else [f"{pushed.name}_{k:0{len(str(samples - 1))}}" for k in range(samples)]
        for name, one in zip(names, [friction] if samples is None else friction.drawn(samples), strict=True):
            try:
                files = exported(
                    one,
                    pushed.outline,
                    to,
                    name=name,
                    mass=mass,
                    table_friction=table_friction,
                    total_friction=file.total_friction,
                    gravity=gravity,
                    height=height if height is not None else pushed.height or HEIGHT,
                    pusher_radius=pusher_radius,
                    rests_on=file.rests_on,
                )
            except ValueError as error:
                raise InvalidInput(f"{model}: cannot be exported: {error}") from error
            for written, text in files.items():
                write_whole(out / written, text)
                say(f"wrote {out / written}")
