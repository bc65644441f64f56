"""The command `import`."""

import pathlib
from typing import Annotated

import typer

from pushfric_core.bags import stablepush, zhou2015
from pushfric_core.commands.application import Application
from pushfric_core.commands.console import console
from pushfric_core.errors import InvalidInput
from pushfric_core.wording import counted

app = Application()

IMPORTERS = {zhou2015.NAME: zhou2015.import_pushes, stablepush.NAME: stablepush.import_stable_pushes}
"""Public data sets by name."""


@app.command()
def import_(
    dataset: Annotated[str, typer.Argument(help=f"Name of the public data set: {', '.join(IMPORTERS)}.", show_default=False)],
    source: Annotated[
        pathlib.Path,
        typer.Argument(
            help="File of the data set: for zhou2015 a log or push_points.csv, for stablepush stable_pushes.csv.",
            show_default=False,
        ),
    ],
    out: Annotated[
        pathlib.Path,
        typer.Option(help="Folder to write: the bag, or a bag for each of several logs or objects.", show_default=False),
    ],
) -> None:
    if dataset not in IMPORTERS:
        raise InvalidInput(f"unknown data set {dataset!r}; expected {' or '.join(IMPORTERS)}")
    for written in IMPORTERS[dataset](source, out):
        console.print(f"{written.bag}: {counted(written.observations, 'observation')} of {written.object}", markup=False)
