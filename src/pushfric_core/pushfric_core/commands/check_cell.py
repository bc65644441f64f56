"""The command `check-cell`."""

import pathlib
from typing import Annotated

import typer
from rich import box
from rich.console import Console
from rich.table import Table

from pushfric_core.commands.application import Application
from pushfric_core.commands.console import warn
from pushfric_core.commands.json_option import STDOUT, JsonOption, write_json
from pushfric_core.offline.known_loads import check_loads
from pushfric_core.records import to_json

app = Application()


@app.command()
def check_cell(
    loads: Annotated[pathlib.Path, typer.Argument(help="YAML of the plate, its loads and their data.", show_default=False)],
    limit: Annotated[float, typer.Option(help="How far p_CF may be off [m].", min=0.0, max=0.1)] = 0.003,
    json: JsonOption = None,
) -> None:
    """Exit code 1: some p_CF is off by more than the limit, or its data are in doubt."""
    checked = check_loads(loads, warn)
    write_json(to_json({"trials": [one._asdict() | {"off": one.off} for one in checked]}), json)
    if json != STDOUT:
        table = Table(box=box.SIMPLE_HEAD)
        table.add_column("data")
        for head in ("p_CF by statics [mm]", "estimated [mm]", "off by [mm]", "claimed within [mm]"):
            table.add_column(head, justify="right")
        for one in checked:
            places = (f"({1e3 * x:.2f}, {1e3 * y:.2f})" for x, y in (one.expected, one.found))
            claimed = "-" if one.within is None else f"{1e3 * one.within:.2f}"
            table.add_row(one.data, *places, f"{'✗ ' * (one.off > limit)}{1e3 * one.off:.2f}", claimed)
        Console().print(table)
    if any(one.off > limit or one.doubts for one in checked):
        raise typer.Exit(1)
