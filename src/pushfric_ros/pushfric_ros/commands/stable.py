"""The command `stable`."""

import pathlib
from typing import Annotated

import typer
from rich.console import Console

from pushfric_core.prediction import stability
from pushfric_ros.commands.console import warn
from pushfric_ros.commands.json_option import STDOUT, JsonOption, write_json
from pushfric_ros.commands.options import ObjectOption
from pushfric_ros.commands.planning import ModelArgument, known
from pushfric_ros.files.pushes_file import TURNED, read_edge_pushes
from pushfric_ros.report.report import to_json

app = typer.Typer(add_completion=False)


@app.command()
def stable(
    model: ModelArgument,
    pushes: Annotated[pathlib.Path, typer.Option(help=f"CSV with the columns {', '.join(TURNED)}.", show_default=False)],
    object_name: ObjectOption = "",
    json: JsonOption = None,
) -> None:
    """The margin is the least wrench that would make the object slip, as a share of the support friction."""
    outline, friction = known(model, object_name, warn)
    found = stability(friction, *read_edge_pushes(pushes, outline))
    rows = [
        {"stable": bool(holds), "margin": float(margin), "probability": float(probability)}
        for holds, margin, probability in zip(*found, strict=True)
    ]
    write_json(to_json(rows), json)
    if json == STDOUT:
        return
    output = Console(highlight=False, markup=False, soft_wrap=True)
    for number, row in enumerate(rows, 1):
        says = "holds" if row["stable"] else "slips"
        output.print(f"{number}: {says}, margin {row['margin']:.4f} of the support friction")
