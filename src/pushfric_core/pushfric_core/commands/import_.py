"""The command `import`."""

import pathlib
from typing import Annotated

import typer

from pushfric_core.commands.application import Application
from pushfric_core.commands.console import say
from pushfric_core.datasets import cpush, mitpush, stablepush, zhou2015
from pushfric_core.errors import InvalidInput
from pushfric_core.wording import counted

app = Application()

IMPORTERS = {
    zhou2015.NAME: zhou2015.import_pushes,
    stablepush.NAME: stablepush.import_stable_pushes,
    mitpush.NAME: mitpush.import_pushes,
}
"""Public data sets by name; that of cpush takes several sources."""

NAMES = (*IMPORTERS, cpush.NAME)


@app.command()
def import_(
    dataset: Annotated[str, typer.Argument(help=f"Name of the public data set: {', '.join(NAMES)}.", show_default=False)],
    sources: Annotated[
        list[pathlib.Path],
        typer.Argument(
            help="Part of the data set: for zhou2015 a log or push_points.csv, for stablepush stable_pushes.csv, for mitpush a "
            "clone of PlanarManipulationToolBox, for cpush the files of one or more runs.",
            show_default=False,
        ),
    ],
    out: Annotated[
        pathlib.Path,
        typer.Option(
            help="Folder to write: the bag, or a bag for each of several logs or objects; for mitpush and cpush, CSV files.",
            show_default=False,
        ),
    ],
) -> None:
    if dataset == cpush.NAME:
        imported = cpush.import_runs(sources, out)
    elif dataset not in IMPORTERS:
        raise InvalidInput(f"unknown data set {dataset!r}; expected {' or '.join(NAMES)}")
    elif len(sources) > 1:
        raise InvalidInput(f"{sources[1]}: only {cpush.NAME} takes more than one source")
    else:
        imported = IMPORTERS[dataset](sources[0], out)
    for written in imported:
        say(f"{written.path}: {counted(written.observations, 'observation')} of {written.object}")
