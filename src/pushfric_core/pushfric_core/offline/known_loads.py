"""A cell checked against statics: how far p_CF is estimated from where known loads put it."""

import math
import pathlib
from typing import NamedTuple

import pydantic

from pushfric_core.estimation.batch import Warn
from pushfric_core.files.object_file import Strict, read_yaml
from pushfric_core.offline.estimation import Choices, estimate_from


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
