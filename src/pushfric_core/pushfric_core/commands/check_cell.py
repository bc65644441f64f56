"""The command `check-cell`."""

import math
import pathlib
from typing import Annotated, NamedTuple

import pydantic
import typer
from rich import box
from rich.console import Console
from rich.table import Table

from pushfric_core.commands.application import STDOUT, Application
from pushfric_core.commands.console import warn, write_json
from pushfric_core.commands.options import JsonOption
from pushfric_core.estimation.batch import Warn
from pushfric_core.files.yaml_files import Strict, read_yaml
from pushfric_core.offline.estimation import Choices, estimate_from
from pushfric_core.records import to_json


class Trial(Strict):
    """Pushes of the plate with one load."""

    data: str  # bag, or CSV of observations; counts from the file's folder
    mass: pydantic.NonNegativeFloat = 0.0  # of the load [kg]
    at: tuple[pydantic.FiniteFloat, pydantic.FiniteFloat] = (0.0, 0.0)  # its centre of mass, object frame [m]


class LoadsFile(Strict):
    """A plate, and what it was loaded with."""

    mass: pydantic.PositiveFloat  # of the plate [kg]
    center: tuple[pydantic.FiniteFloat, pydantic.FiniteFloat] = (0.0, 0.0)  # its centre of mass, object frame [m]
    object: str = ""  # of the plate; empty: the one next to each bag
    trials: list[Trial] = pydantic.Field(min_length=1)


class CheckedTrial(NamedTuple):
    """A trial."""

    data: str
    expected: tuple[float, float]  # p_CF by statics, object frame [m]
    found: tuple[float, float]  # the estimated one [m]
    within: float | None  # what the estimate claims, with 90 % [m]; None: nothing
    doubts: int  # number of those about the data

    @property
    def off(self) -> float:
        """Distance of the two [m]."""
        return math.dist(self.expected, self.found)


def check_loads(path: pathlib.Path, warn: Warn) -> list[CheckedTrial]:
    """Estimate each trial, and compare it with statics.

    If the coefficient of friction is the same all over, p_CF lies below the common centre of mass, whatever the plate rests on.

    Args:
        path: of the loads' YAML.
        warn: called as by `estimate_from`.
    Raises:
        InvalidInput: the file, or one of the data that it names, is unusable.
    """
    file = read_yaml(path, LoadsFile)
    name = str(path.parent / file.object) if file.object.endswith((".yaml", ".yml")) else file.object
    checked = []
    for trial in file.trials:
        share = trial.mass / (file.mass + trial.mass)
        x, y = ((1 - share) * own + share * load for own, load in zip(file.center, trial.at, strict=True))
        estimation = estimate_from(path.parent / trial.data, Choices(name), warn)
        u, v = estimation.result.believed_center.tolist()
        checked.append(CheckedTrial(trial.data, (x, y), (u, v), estimation.result.confidence, len(estimation.ledger.doubts)))
    return checked


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
