"""The command `import`."""

import pathlib
from typing import Annotated

import typer

from pushfric_core.errors import InvalidInput
from pushfric_ros.bags import zhou2015
from pushfric_ros.commands.console import console

app = typer.Typer(add_completion=False)


@app.command()
def import_(
    dataset: Annotated[str, typer.Argument(help=f"Which public data set: {zhou2015.NAME}.", show_default=False)],
    source: Annotated[pathlib.Path, typer.Argument(help="A log of it, or push_points.csv.", show_default=False)],
    out: Annotated[pathlib.Path, typer.Option(help="Folder of the bag; of several logs, a bag each.", show_default=False)],
) -> None:
    if dataset != zhou2015.NAME:
        raise InvalidInput(f"unknown data set {dataset!r}; expected {zhou2015.NAME}")
    for written in zhou2015.import_pushes(source, out):
        console.print(f"{written.bag}: {written.observations} observations of {written.object}", markup=False)
