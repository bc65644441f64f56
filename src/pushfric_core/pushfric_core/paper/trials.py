"""Simulated pushes for the study: its objects, how they move, and what a camera sees of them."""

import contextlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
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

SPACING = 0.003
"""Spacing of the places that stand for an area [m]."""

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


def shapes() -> dict[str, Studied]:
    """More supports under larger outlines, on grids that fit none of them: four areas, and feet anywhere."""
    angle = Outline(np.array(((0, 0), (0.12, 0), (0.12, 0.05), (0.05, 0.05), (0.05, 0.12), (0, 0.12))) - 0.04)
    turns = np.arange(12) * math.pi / 6
    disc = Outline(0.055 * np.column_stack((np.cos(turns), np.sin(turns))))
    plate = Outline.rectangle(0.13, 0.09)
    five = Support(
        np.array(((-0.05, -0.03), (0.05, -0.035), (0.055, 0.03), (-0.02, 0.036), (0.005, 0.0))),
        np.array((0.3, 0.15, 0.25, 0.2, 0.1)),
    )
    three = Support(np.array(((-0.047, -0.028), (0.052, -0.012), (-0.006, 0.033))), np.array((0.25, 0.45, 0.3)))
    rim = _area(disc, lambda x, y: np.asarray(np.hypot(x, y) > 0.035, dtype=float))
    eccentric = _area(plate, lambda x, y: 1 + 1.6 * x / 0.065 + 0.9 * y / 0.045)
    runners = _area(plate, lambda x, y: (np.abs(np.abs(y) - 0.035) < 0.006) * (0.8 + 0.2 * np.sign(y)))
    supports = {
        "L": (angle, _area(angle, lambda x, y: np.ones_like(x)), (4, 1, 2, 2, 1, 4)),
        "ring": (disc, rim, (2, 1) * 6),
        "eccentric": (plate, eccentric, (5, 3, 5, 3)),
        "runners": (plate, runners, (5, 3, 5, 3)),
        "five_feet": (plate, five, (5, 3, 5, 3)),
        "three_feet": (plate, three, (5, 3, 5, 3)),
    }
    return {
        name: Studied(outline, support, 0.3, outline.grid(8, 6, 0.005), {"all": counts}, math.inf)
        for name, (outline, support, counts) in supports.items()
    }


def _area(outline: Outline, pressure: Callable[[Array, Array], Array]) -> Support:
    """A support all over an outline, with a pressure as a function of the places' coordinates [m]."""
    columns, rows = (outline.size / SPACING).astype(int)
    points = outline.grid(int(columns), int(rows), SPACING / 4)
    weights = np.maximum(np.asarray(pressure(*points.T), dtype=float), 0.0)
    return Support(points[weights > 0], weights[weights > 0] / weights.sum())


def eight_places(outline: Outline, rng: np.random.Generator) -> list[PlannedPush]:
    """Perpendicular pushes at eight places, drawn evenly along the edges but for their ends."""
    edges = rng.choice(len(outline.lengths), 8, p=outline.lengths / outline.lengths.sum())
    return [PlannedPush(int(edge), float(rng.uniform(-0.42, 0.42) * outline.lengths[edge])) for edge in edges]


def moved(studied: Studied, pushes: Sequence[PlannedPush], rng: np.random.Generator) -> list[Frames]:
    """The course of each push; a push in which the tip wedges is left out."""
    found = []
    for push in pushes:
        error = rng.normal(0.0, PLACEMENT, 3)
        try:
            found.append(motion(studied.outline, studied.support, studied.mu_c, push, error, studied.longest_turn))
        except PushfricError:
            continue
    return found


def estimated(data: Iterable[Observation], points: Array, config: EstimatorConfig) -> tuple[Estimator, Estimate]:
    """The estimator after all observations, and its estimate."""
    estimator = Estimator(points, config)
    for observation in data:
        with contextlib.suppress(PushfricError):  # the estimator refuses this observation, as in a live run
            estimator.add(observation)
    return estimator, estimator.estimate()
