"""The command `reproduce`."""

import pathlib
from typing import Annotated

import typer

from pushfric_core.errors import InvalidInput
from pushfric_ros.commands.console import console
from pushfric_ros.commands.recorded_run import RUNS
from pushfric_ros.paper import reproduce as paper

app = typer.Typer(add_completion=False)


@app.command()
def reproduce(
    out: Annotated[pathlib.Path, typer.Option(help="Folder of the report; a second call continues there.")] = RUNS
    / "reproduce",
    seeds: Annotated[int, typer.Option(help="Number of repetitions, each with its own noise.", min=1, max=10_000)] = 20,
    jobs: Annotated[int, typer.Option(help="Number of processes; -1: one for each core.", min=-1)] = -1,
    dask: Annotated[
        str | None,
        typer.Option("--dask", help="Scheduler of a Dask cluster to run on instead.", metavar="ADDRESS", show_default=False),
    ] = None,
) -> None:
    if jobs == 0:
        raise InvalidInput("--jobs must be -1, or 1 or more, got 0")
    _, written = paper.reproduce(out, seeds, jobs, dask, console)
    console.print(f"report: {written}", markup=False)
