"""Simulated pushes for the study: its objects, how they move, and what a camera sees of them."""

import contextlib
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from pushfric_core.datasets.zhou2015 import CORNERS, GRID
from pushfric_core.errors import PushfricError
from pushfric_core.estimation.estimate import Estimate
from pushfric_core.estimation.estimator import Estimator, EstimatorConfig
from pushfric_core.estimation.push_plan import PlannedPush
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array
from pushfric_core.geometry.support import Support
from pushfric_core.geometry.table_1 import FEET, FLAT, TABLE_1
from pushfric_core.paper.experiments import CONDUCT, PLACEMENT, Frames, motion
from pushfric_core.trajectories.observation import Observation

NOISES = {"FEET": FEET, "FLAT": FLAT}


class Studied(NamedTuple):
    """An object of the study."""

    outline: Outline
    support: Support
    mu_c: float
    support_points: Array
    plans: Mapping[str, tuple[int, ...]]  # pushes along each edge
    longest_turn: float  # of a push [rad]


def of_table_1(name: str) -> Studied:
    """An object of Table 1, without a plan; the flat ones turn quickly, and their pushes end early."""
    known = TABLE_1[name]
    return Studied(known.outline, known.support, known.mu_c, known.support_points, {}, CONDUCT[name].longest_turn)


def objects() -> dict[str, Studied]:
    """Those whose p_CF is studied, with the numbers of pushes of each plan."""
    rectangle = TABLE_1["wood_rect4"]
    triangle = Outline(np.array(CORNERS))
    feet = Support(np.array(((0.03, 0.03), (0.09, 0.03), (0.03, 0.09))), np.full(3, 1 / 3))
    unequal = Support(rectangle.support.points, np.array((0.4, 0.3, 0.2, 0.1)))
    on_long_sides = {"all": (5, 2, 5, 2), "eight": (3, 1, 3, 1)}
    return {
        "unequal_feet": of_table_1("wood_rect4")._replace(support=unequal, plans=on_long_sides),
        "triangle": Studied(
            triangle, feet, 0.3, triangle.grid(10, 10, GRID.inset), {"all": (5, 5, 5), "eight": (3, 2, 3)}, math.inf
        ),
        "delrin_rect_right": of_table_1("delrin_rect_right")._replace(plans=on_long_sides),
    }


def moved(studied: Studied, pushes: Sequence[PlannedPush], rng: np.random.Generator) -> list[Frames]:
    """What happens in each push; a push in which the tip wedges is left out."""
    found = []
    for push in pushes:
        error = rng.normal(0.0, PLACEMENT, 3)
        try:
            found.append(motion(studied.outline, studied.support, studied.mu_c, push, error, studied.longest_turn))
        except PushfricError:
            continue
    return found


def estimated(data: Iterable[Observation], points: Array, config: EstimatorConfig) -> tuple[Estimator, Estimate]:
    """The estimator after all data points, and its estimate."""
    estimator = Estimator(points, config)
    for observation in data:
        with contextlib.suppress(PushfricError):  # the estimator refuses this observation, as in a live run
            estimator.add(observation)
    return estimator, estimator.estimate()
