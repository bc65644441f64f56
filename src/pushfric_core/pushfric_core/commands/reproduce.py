"""The command `reproduce`."""

import pathlib
from typing import Annotated

import typer

from pushfric_core.commands.application import Application
from pushfric_core.commands.console import console, say
from pushfric_core.commands.options import RUNS, DaskOption, JobsOption
from pushfric_core.paper import reproduce as paper

app = Application()


@app.command()
def reproduce(
    out: Annotated[pathlib.Path, typer.Option(help="Folder to write: the report; a second call continues there.")] = RUNS
    / "reproduce",
    seeds: Annotated[int, typer.Option(help="Number of repetitions, each with its own noise.", min=1, max=10_000)] = 20,
    jobs: JobsOption = -1,
    dask: DaskOption = None,
) -> None:
    _, written = paper.reproduce(out, seeds, jobs, dask, console)
    say(f"report: {written}")
