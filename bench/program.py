"""How a program of the checkout starts, and runs what takes long."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

import typer
from rich.progress import track

from pushfric_core.commands.cli import main
from pushfric_core.commands.console import console
from pushfric_core.commands.program import run, undoing
from pushfric_core.offline.many import results


def start(app: typer.Typer, name: str) -> None:
    """Run its command line and end the process."""
    run(undoing(partial(main, app, name)))


def results_of(work: Callable[[Any], Any], arguments: Sequence[Any], jobs: int, dask: str | None) -> Iterable[Any]:
    """The result for each argument, in order of completion, while the terminal shows how many there are."""
    return track(results(work, arguments, jobs, dask), "runs", len(arguments), console=console)
