"""Options of commands that talk to a running cell, or start one."""

import dataclasses
from typing import Annotated

import typer

from pushfric_core.cell.node_settings import VIEW_PORT, CellConfig, ViewConfig
from pushfric_core.commands.application import ADDRESS, AUTO_VIEW
from pushfric_core.errors import InvalidInput, blaming

HeadlessFlag = Annotated[bool, typer.Option("--headless", help="Print a line for each push instead of a live display.")]
PlannerFlag = Annotated[bool, typer.Option("--planner", help="Also start a node that answers planners.")]


def _namespace(text: str) -> str:
    with blaming("--namespace"):
        return CellConfig(f"/{text.strip('/')}").namespace


NamespaceOption = Annotated[str, typer.Option("--namespace", help="Namespace of the cell.", callback=_namespace)]
LONGEST_STROKE, FASTEST_STROKE = 0.5, 0.5
"""Bounds on what a person at a cell asks of the pusher [m, m/s]; more is likely to be in millimetres."""

ViewOption = Annotated[
    str,
    typer.Option(
        "--view",
        help=f"Show the run in a browser, on this machine alone unless a HOST is given; at port {VIEW_PORT} unless a PORT is.",
        metavar="[[HOST:]PORT]",
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


def view_to_serve(address: str, settings: ViewConfig) -> ViewConfig | None:
    """The same, once it is known that a page can be served there: before anything is made or started."""
    if (view := view_at(address, settings)) is not None:
        from pushfric_core.page.server import bound  # imported late: most runs show no page

        for socket in bound(view):
            socket.close()
    return view
