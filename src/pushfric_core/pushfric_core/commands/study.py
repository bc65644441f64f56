"""The command `study`."""

import pathlib
from typing import Annotated

import typer

from pushfric_core.commands.application import Application
from pushfric_core.commands.console import console, say
from pushfric_core.commands.options import RUNS, DaskOption, JobsOption
from pushfric_core.paper import study as paper

app = Application()


@app.command()
def study(
    out: Annotated[pathlib.Path, typer.Option(help="Folder to write: study.json and study.md.")] = RUNS / "study",
    seeds: Annotated[int, typer.Option(help="Simulated runs for each case.", min=1, max=10_000)] = 200,
    pushes: Annotated[
        pathlib.Path | None, typer.Option(help="push_points.csv of zhou2015, to study real pushes too.", show_default=False)
    ] = None,
    jobs: JobsOption = -1,
    dask: DaskOption = None,
) -> None:
    paper.study(out, seeds, pushes, jobs, dask, console)
    say(f"report: {out / 'study.md'}")
