"""The command `import`."""

import pathlib
from typing import Annotated

import typer

from pushfric_core.errors import InvalidInput
from pushfric_ros.bags import stablepush, zhou2015
from pushfric_ros.commands.console import console

app = typer.Typer(add_completion=False)

IMPORTERS = {zhou2015.NAME: zhou2015.import_pushes, stablepush.NAME: stablepush.import_stable_pushes}
"""Public data sets by name."""


@app.command()
def import_(
    dataset: Annotated[str, typer.Argument(help=f"Name of the public data set: {', '.join(IMPORTERS)}.", show_default=False)],
    source: Annotated[
        pathlib.Path,
        typer.Argument(help="Of zhou2015 a log or push_points.csv, of stablepush stable_pushes.csv.", show_default=False),
    ],
    out: Annotated[
        pathlib.Path, typer.Option(help="Folder of the bag; of several logs or objects, a bag each.", show_default=False)
    ],
) -> None:
    if dataset not in IMPORTERS:
        raise InvalidInput(f"unknown data set {dataset!r}; expected {' or '.join(IMPORTERS)}")
    for written in IMPORTERS[dataset](source, out):
        console.print(f"{written.bag}: {written.observations} observations of {written.object}", markup=False)
