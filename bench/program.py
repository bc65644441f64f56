"""How a program of the checkout starts."""

from functools import partial

import typer

from pushfric_core.commands.cli import main
from pushfric_core.commands.program import run, undoing


def start(app: typer.Typer, name: str) -> None:
    """Run its command line and end the process."""
    run(undoing(partial(main, app, name)))
