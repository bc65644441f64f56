"""Options of commands that talk to a running cell, or start one."""

import dataclasses
import re
from collections.abc import Iterator
from typing import Annotated, Any

import typer

from pushfric_core.cell.node_settings import VIEW_PORT, ViewConfig
from pushfric_core.commands.application import PlainCommand
from pushfric_core.errors import InvalidInput, blaming

HeadlessFlag = Annotated[bool, typer.Option("--headless", help="Print a line for each push instead of a live display.")]
PlannerFlag = Annotated[bool, typer.Option("--planner", help="Also start a node that answers planners.")]
NamespaceOption = Annotated[str, typer.Option("--namespace", help="Namespace of the cell.")]
LONGEST_STROKE, FASTEST_STROKE = 0.5, 0.5
"""Bounds on what a person at a cell asks of the pusher [m, m/s]; more is likely to be in millimetres."""

AUTO_VIEW = "auto"
"""The address that stands for a --view without an address."""


class WithView(PlainCommand):
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
    with blaming(f"--view {address}"):
        view = dataclasses.replace(settings, port=int(found["port"]))
        view = dataclasses.replace(view, host=found["host"].strip("[]")) if found["host"] else view
        return view.protected()  # here, so that a view that is started again keeps its token
