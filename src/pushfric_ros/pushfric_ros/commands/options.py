"""Arguments and options that several commands have."""

import pathlib
from typing import Annotated

import typer

from pushfric_core.errors import InvalidInput
from pushfric_core.table_1 import TABLE_1

Input = Annotated[pathlib.Path, typer.Argument(help="Bag (folder or .mcap), or CSV of observations.", show_default=False)]
ObjectOption = Annotated[
    str,
    typer.Option(
        "--object",
        help=f"Object YAML, or one of {', '.join(TABLE_1)}. A bag may contain it as object.yaml.",
        show_default=False,
    ),
]
GridOption = Annotated[
    tuple[int, int] | None,
    typer.Option("--grid", help="Support points: a grid of NX by NY over the object.", metavar="NX NY", show_default=False),
]
SupportPointsOption = Annotated[
    pathlib.Path | None,
    typer.Option("--support-points", help="Support points: a CSV with columns x,y (m).", show_default=False),
]
JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else there.")]
PartialFlag = Annotated[bool, typer.Option("--partial", help="Accept a damaged bag, from which messages are missing.")]
NamespaceOption = Annotated[str, typer.Option("--namespace", help="Of the cell.")]
HeadlessFlag = Annotated[bool, typer.Option("--headless", help="Print a line for each push instead of a live display.")]


def _processes(jobs: int) -> int:
    if jobs == 0:
        raise InvalidInput("--jobs must be -1, or 1 or more, got 0")
    return jobs


JobsOption = Annotated[int, typer.Option(help="Number of processes; -1: one for each core.", min=-1, callback=_processes)]
DaskOption = Annotated[
    str | None,
    typer.Option("--dask", help="Scheduler of a Dask cluster to run on instead.", metavar="ADDRESS", show_default=False),
]
