"""Arguments and options that several commands have."""

import pathlib
import sys
from typing import Annotated

import typer

from pushfric_core.commands.application import STDOUT, SUFFIX
from pushfric_core.errors import InvalidInput
from pushfric_core.files.disk import make_folder
from pushfric_core.geometry.table_1 import TABLE_1

RUNS = pathlib.Path("runs")
"""Folder for bags and reports, unless the command line gives another."""

Input = Annotated[pathlib.Path, typer.Argument(help="Bag (folder or .mcap), or CSV of observations.")]
ObjectOption = Annotated[
    str,
    typer.Option(
        "--object",
        help=f"Object YAML, or one of {', '.join(TABLE_1)}. A bag may contain it as object.yaml.",
        metavar="NAME|FILE",
    ),
]
GridOption = Annotated[
    tuple[int, int] | None, typer.Option("--grid", help="Support points: a grid of NX by NY over the object.", metavar="NX NY")
]
SupportPointsOption = Annotated[
    pathlib.Path | None, typer.Option("--support-points", help="Support points: a CSV with columns x,y [m].")
]
PartialFlag = Annotated[bool, typer.Option("--partial", help="Accept a damaged bag even if messages are missing.")]
ForceFlag = Annotated[bool, typer.Option("--force", help="Overwrite existing files without asking.")]
CellOption = Annotated[str | None, typer.Option("--namespace", help="Namespace of the cell, for a bag of several.")]


def permit(target: pathlib.Path, force: bool, question: str, instead: str) -> None:
    """Ask before a file is overwritten; this comes before any work.

    Args:
        target: the file.
        force: value of the option.
        question: to a person at a terminal, if there is such a file.
        instead: what else can be given, for the error.
    Raises:
        InvalidInput: the file exists, and there is no terminal to ask.
    """
    if force or not target.exists():
        return
    if not sys.stdin.isatty():
        raise InvalidInput(f"{target} exists: give --force, or {instead}")
    typer.confirm(f"{target} exists. {question}", abort=True, err=True)


def _processes(jobs: int) -> int:
    if jobs == 0:
        raise InvalidInput("--jobs must be -1, or 1 or more, got 0")
    return jobs


JobsOption = Annotated[int, typer.Option(help="Number of processes; -1: one for each core.", min=-1, callback=_processes)]
DaskOption = Annotated[
    str | None, typer.Option("--dask", help="Scheduler of a Dask cluster to run on instead.", metavar="ADDRESS")
]


def _checked(where: str | None) -> str | None:
    """Refuse, before any work is done, what cannot be written."""
    if where is None or where == STDOUT:
        return where
    file = pathlib.Path(where)
    if file.suffix != SUFFIX or file.is_dir():
        raise InvalidInput(f"{file}: expected the name of a file to write that ends in {SUFFIX}")
    make_folder(file.parent)
    return where


JsonOption = Annotated[
    str | None,
    typer.Option(
        "--json",
        help="Print only the result, as JSON, on stdout; with FILE.json, print as usual and write the JSON there.",
        metavar="[FILE.json]",
        callback=_checked,
    ),
]

LedgerOption = Annotated[
    str | None,
    typer.Option(
        "--ledger",
        help="Print what became of every message, on stderr and in the JSON; with FILE.json, write it there.",
        metavar="[FILE.json]",
        callback=_checked,
    ),
]
