"""The command `predict`."""

import math
import pathlib
from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import typer

from pushfric_core.commands.application import Application
from pushfric_core.commands.console import warn
from pushfric_core.commands.json_option import JsonOption
from pushfric_core.commands.options import CellOption, ObjectOption, PartialFlag
from pushfric_core.commands.planning import ModelArgument, known
from pushfric_core.commands.result import answer
from pushfric_core.files.csv_files import MOVED, read_point_pushes
from pushfric_core.mechanics.prediction import predict as predicted

app = Application()


@app.command()
def predict(
    model: ModelArgument,
    pushes: Annotated[pathlib.Path, typer.Option(help=f"CSV with the columns {', '.join(MOVED)}.", show_default=False)],
    object_name: ObjectOption = "",
    namespace: CellOption = None,
    partial: PartialFlag = False,
    json: JsonOption = None,
) -> None:
    """The spread is an angle: 90 % of measured twists lie within it of the predicted one."""
    with known(model, object_name, namespace, partial) as (file, pushed):
        friction = file.friction()
        found = predicted(friction, *read_point_pushes(pushes, pushed.outline))
        rows = [
            {
                "twist": found.twists[push].tolist(),
                "mode": found.modes[push].value,
                "spread": float(found.spread[push]),
                "force": found.forces[push].tolist(),
                "covariance": found.covariance[push].tolist(),
            }
            for push in range(len(found.modes))
        ]
        if friction.limit is not None:
            warn(friction.limit)
        answer(rows, json, _lines(rows))


def _lines(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    for number, row in enumerate(rows, 1):
        vx, vy, omega = row["twist"]
        spread = math.degrees(row["spread"])
        yield f"{number}: {row['mode']}, vx {vx:.5g} m, vy {vy:.5g} m, omega {omega:.5g} rad; 90 % within {spread:.1f} degrees"
