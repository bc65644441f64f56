"""The commands `reproduce` and `study`, which `./pushfric` starts as `python bench/paper reproduce`."""

import pathlib
import sys
from typing import Annotated

import typer

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2]))  # started as `python bench/paper`, from any folder

from bench.paper import reproduce as paper
from bench.paper import study as studies
from bench.program import start
from pushfric_core.commands.application import Application
from pushfric_core.commands.console import console, say
from pushfric_core.commands.options import RUNS, DaskOption, JobsOption

app = Application(pretty_exceptions_enable=False)


@app.command()
def reproduce(
    out: Annotated[pathlib.Path, typer.Option(help="Folder to write: the report.")] = RUNS / "reproduce",
    seeds: Annotated[int, typer.Option(help="Number of repetitions, each with its own noise.", min=1, max=10_000)] = 20,
    jobs: JobsOption = -1,
    dask: DaskOption = None,
) -> None:
    """Reproduce the paper's tables and figures from simulated pushes: report.html, tables.json, images."""
    say(f"report: {paper.reproduce(out, seeds, jobs, dask, console)}")


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
    """Measure how far the estimates can be relied on, with simulated pushes of many seeds and with real ones."""
    studies.study(out, seeds, pushes, jobs, dask, console)
    say(f"report: {out / 'study.md'}")


if __name__ == "__main__":
    start(app, "./pushfric")
