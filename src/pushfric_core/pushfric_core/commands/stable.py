"""The command `stable`."""

import pathlib
from typing import Annotated

import typer

from pushfric_core.commands.application import Application
from pushfric_core.commands.json_option import JsonOption
from pushfric_core.commands.options import CellOption, ObjectOption, PartialFlag
from pushfric_core.commands.planning import ModelArgument, known
from pushfric_core.commands.result import answer
from pushfric_core.files.csv_files import TURNED, read_edge_pushes
from pushfric_core.mechanics.prediction import stability

app = Application()


@app.command()
def stable(
    model: ModelArgument,
    pushes: Annotated[pathlib.Path, typer.Option(help=f"CSV with the columns {', '.join(TURNED)}.", show_default=False)],
    object_name: ObjectOption = "",
    namespace: CellOption = None,
    partial: PartialFlag = False,
    json: JsonOption = None,
) -> None:
    """The margin is the least wrench that would make the object slip, as a share of the support friction."""
    with known(model, object_name, namespace, partial) as (file, pushed):
        found = stability(file.friction(), *read_edge_pushes(pushes, pushed.outline))
        rows = [
            {"stable": bool(holds), "margin": float(margin), "probability": float(probability)}
            for holds, margin, probability in zip(*found, strict=True)
        ]
        lines = (
            f"{number}: {'holds' if row['stable'] else 'slips'}, margin {row['margin']:.4f} of the support friction"
            for number, row in enumerate(rows, 1)
        )
        answer(rows, json, lines)
