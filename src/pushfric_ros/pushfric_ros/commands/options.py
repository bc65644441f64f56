"""Arguments and options that several commands have."""

import dataclasses
import pathlib
import re
from collections.abc import Iterator
from typing import Annotated, Any

import typer
import typer.core

from pushfric_core.errors import InvalidInput
from pushfric_core.table_1 import TABLE_1
from pushfric_ros.files.node_settings import VIEW_PORT, ViewConfig

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
    typer.Option("--support-points", help="Support points: a CSV with columns x,y [m].", show_default=False),
]
PartialFlag = Annotated[bool, typer.Option("--partial", help="Accept a damaged bag even if messages are missing.")]
NamespaceOption = Annotated[str, typer.Option("--namespace", help="Namespace of the cell.")]
HeadlessFlag = Annotated[bool, typer.Option("--headless", help="Print a line for each push instead of a live display.")]

AUTO_VIEW = "auto"
"""The address that stands for a --view without an address."""


class WithView(typer.core.TyperCommand):
    """A command with the option --view, which may stand alone."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Give a lone --view the address that it stands for."""
        return list(super().parse_args(ctx, [f"--view={AUTO_VIEW}" if lone else arg for arg, lone in _with_lone_view(args)]))


def _with_lone_view(args: list[str]) -> Iterator[tuple[str, bool]]:
    for arg, following in zip(args, [*args, ""][1:], strict=True):
        yield arg, arg == "--view" and ADDRESS.fullmatch(following) is None


ADDRESS = re.compile(r"(?:(?P<host>\[[^\]]+\]|[^:/\s]+):)?(?P<port>[0-9]{1,5})")

ADDRESS_METAVAR = "[[HOST:]PORT]"

ViewOption = Annotated[
    str,
    typer.Option(
        "--view",
        help=f"Show the run in a browser, on this machine alone unless a HOST is given; at port {VIEW_PORT} unless a PORT is.",
        metavar=ADDRESS_METAVAR,
        show_default=False,
    ),
]


def view_at(address: str, settings: ViewConfig) -> ViewConfig | None:
    """Where the view is served; None: not at all.

    Args:
        address: what --view was given; empty if --view was not given.
        settings: of the cell, for what the address does not say.
    Raises:
        InvalidInput: `address` is not an address.
    """
    if not address:
        return None
    if address == AUTO_VIEW:
        return settings.protected()
    found = ADDRESS.fullmatch(address)
    if found is None:
        raise InvalidInput(f"--view must be a port or HOST:PORT, got {address!r}")
    try:
        view = dataclasses.replace(settings, port=int(found["port"]))
        view = dataclasses.replace(view, host=found["host"].strip("[]")) if found["host"] else view
        return view.protected()  # here, so that a view that is started again keeps its token
    except ValueError as error:
        raise InvalidInput(f"--view {address}: {error}") from error


def _processes(jobs: int) -> int:
    if jobs == 0:
        raise InvalidInput("--jobs must be -1, or 1 or more, got 0")
    return jobs


JobsOption = Annotated[int, typer.Option(help="Number of processes; -1: one for each core.", min=-1, callback=_processes)]
DaskOption = Annotated[
    str | None,
    typer.Option("--dask", help="Scheduler of a Dask cluster to run on instead.", metavar="ADDRESS", show_default=False),
]
