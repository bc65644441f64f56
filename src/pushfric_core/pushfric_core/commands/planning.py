"""The commands `predict`, `stable` and `export`, and their model: from a file, or estimated from a bag or a CSV."""

import contextlib
import math
import pathlib
from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import typer

from pushfric_core.commands.application import Application
from pushfric_core.commands.console import say, warn
from pushfric_core.commands.options import CellOption, JsonOption, ObjectOption, PartialFlag
from pushfric_core.commands.result import answer
from pushfric_core.errors import InvalidInput, blaming
from pushfric_core.files.csv_files import MOVED, TURNED, read_edge_pushes, read_point_pushes
from pushfric_core.files.disk import make_folder, write_whole
from pushfric_core.files.model_file import SUFFIXES, ModelFile, load_model
from pushfric_core.files.object_file import ObjectModel
from pushfric_core.formats.body import GRAVITY, HEIGHT, PUSHER_RADIUS
from pushfric_core.formats.export import FORMATS
from pushfric_core.formats.export import export as exported
from pushfric_core.mechanics.prediction import predict as predicted
from pushfric_core.mechanics.prediction import stability
from pushfric_core.offline.estimation import Choices, estimate_from

ModelArgument = Annotated[
    pathlib.Path, typer.Argument(metavar="MODEL", help="Model YAML (from estimate --save), bag, or CSV of observations.")
]


@contextlib.contextmanager
def known(
    source: pathlib.Path, object_name: str, namespace: str | None, partial: bool
) -> Iterator[tuple[ModelFile, ObjectModel]]:
    """The model in a file with its object, or estimated from the observations of a bag or a CSV with the recorded settings.

    What a command prints within is in doubt, and it ends with exit code 1, if the bag is.

    Args:
        source: the file or the bag.
        object_name: name or file of the object; empty for a model, which has its own.
        namespace: of the cell; None: a bag has only one.
        partial: accept a bag from which messages may be missing.
    Raises:
        InvalidInput: the source cannot be read, or it does not say which object was pushed.
    """
    if source.suffix in SUFFIXES:
        if object_name:
            raise InvalidInput(f"{source}: a model has its own object; give --object only with a bag or a CSV")
        doubts, (file, model) = False, load_model(source)
    else:
        estimation = estimate_from(source, Choices(object_name, partial=partial, namespace=namespace), warn)
        if estimation.result.contradiction is not None:
            raise InvalidInput(f"{source}: {estimation.result.contradiction}")
        doubts, file, model = bool(estimation.ledger.doubts), estimation.to_model(), estimation.model
    for reason in file.made.verdict or ():
        warn(f"the model is not to be used: {reason}")
    yield file, model
    if doubts and not partial:
        raise typer.Exit(1)


app = Application()


@app.command()
def predict(
    model: ModelArgument,
    pushes: Annotated[pathlib.Path, typer.Option(help=f"CSV with the columns {', '.join(MOVED)}.")],
    object_name: ObjectOption = "",
    namespace: CellOption = None,
    partial: PartialFlag = False,
    json: JsonOption = None,
) -> None:
    """The spread is an angle: 90 % of measured twists lie within it of the predicted one."""
    with known(model, object_name, namespace, partial) as (file, pushed):
        friction = file.friction()
        found = predicted(friction, *read_point_pushes(pushes, pushed.outline))
        rows = [
            {
                "twist": found.twists[push].tolist(),
                "mode": found.modes[push].value,
                "spread": float(found.spread[push]),
                "force": found.forces[push].tolist(),
                "covariance": found.covariance[push].tolist(),
            }
            for push in range(len(found.modes))
        ]
        if friction.limit is not None:
            warn(friction.limit)
        answer(rows, json, _lines(rows))


def _lines(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    for number, row in enumerate(rows, 1):
        vx, vy, omega = row["twist"]
        motion = f"vx {vx:z.5g} m, vy {vy:z.5g} m, omega {omega:z.5g} rad"
        yield f"{number}: {row['mode']}, {motion}; 90 % within {math.degrees(row['spread']):.1f} degrees"


@app.command()
def stable(
    model: ModelArgument,
    pushes: Annotated[pathlib.Path, typer.Option(help=f"CSV with the columns {', '.join(TURNED)}.")],
    object_name: ObjectOption = "",
    namespace: CellOption = None,
    partial: PartialFlag = False,
    json: JsonOption = None,
) -> None:
    """The margin is the least wrench that would make the object slip, as a share of the support friction."""
    with known(model, object_name, namespace, partial) as (file, pushed):
        found = stability(file.friction(), *read_edge_pushes(pushes, pushed.outline))
        rows = [
            {"stable": bool(holds), "margin": float(margin), "probability": float(probability)}
            for holds, margin, probability in zip(*found, strict=True)
        ]
        lines = (
            f"{number}: {'holds' if row['stable'] else 'slips'}, margin {row['margin']:z.4f} of the support friction"
            for number, row in enumerate(rows, 1)
        )
        answer(rows, json, lines)


@app.command()
def export(
    model: ModelArgument,
    to: Annotated[str, typer.Option(help=f"One of {', '.join(FORMATS)}.", metavar="FORMAT")],
    mass: Annotated[float | None, typer.Option(help="Of the object [kg].")] = None,
    table_friction: Annotated[float | None, typer.Option(help="Coefficient of the table.")] = None,
    gravity: Annotated[float, typer.Option(help="[m/s^2].")] = GRAVITY,
    pusher_radius: Annotated[float, typer.Option(help="Of the round tip [m].")] = PUSHER_RADIUS,
    height: Annotated[float | None, typer.Option(help=f"Of the object [m]; by default its own, or {HEIGHT:g}.")] = None,
    samples: Annotated[
        int | None, typer.Option(help="Write this many of the belief's samples instead of the mean.", min=1)
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
        if friction.limit is not None:
            warn(friction.limit)
        if samples is not None and len(friction.w) == 1:
            raise InvalidInput(f"{model}: has a single sample, not some to draw {samples} models from; leave out --samples")
        names = [pushed.name] if samples is None else [f"{pushed.name}_{k:0{len(str(samples - 1))}}" for k in range(samples)]
        for name, one in zip(names, [friction] if samples is None else friction.drawn(samples), strict=True):
            with blaming(f"{model}: cannot be exported"):
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
            for written, text in files.items():
                write_whole(out / written, text)
                say(f"wrote {out / written}")
