"""The most probable w and mu_c after some pushes, and how it rests on each sector of the contacts.

The curvature of the likelihood alone promises too much, because friction departs from its model alike in pushes alike. So the
contacts are divided into sectors by bearing, and the scatter between these is added, as for clustered data (Bell and McCaffrey,
"Bias reduction in standard errors for linear regression with multi-stage samples", 2002).
"""

import math
from collections.abc import Generator
from typing import NamedTuple

import numpy as np

from pushfric_core.belief.constants import COMMON, FLOOR, MOST_STRETCHES, SECTORS, WHITES, WIDER
from pushfric_core.belief.fit import Fit, Problem, damped, fitting, problem_of, smaller, solved, spread_cost, student
from pushfric_core.belief.linearisation import with_bounds
from pushfric_core.belief.stretches import Steps, stretches, thinned
from pushfric_core.geometry.planar import Array

STARTS, FIRST_STEPS, FIRST_STRETCHES = (-1.0, 0.0, 1.0), 3, 50
"""Each way in which pushes stick and slide may have a mode of its own. So the search tries some steps from these mu_c, in
standard deviations of its logarithm, and goes on from the best. So many stretches at most choose it; the mode rests on all."""

LEAST_FREEDOM = 0.05
"""A sector that draws the mode to its own errors wholly shows none; they are enlarged as if this share of them were left."""


class PosteriorMode(NamedTuple):
    """A mode, and how it rests on each of g sectors of the contacts."""

    problem: Problem
    fit: Fit
    size: float  # of the support [m]
    changes: Array  # (g, n + 1) that each sector's own errors make to the parameters; their squares add up to a variance
    cost: float  # negative log likelihood of each sector by the fit to the others

    @property
    def w(self) -> Array:
        """Support friction distribution (n,)."""
        return self.problem.w(self.fit.parameters)

    @property
    def tilt(self) -> Array:
        """The change (n, 2) of the log pressure by a shift of p_CF [1/m]: that of a load that tips, on what bears it."""
        arms = self.problem.place.points - self.w @ self.problem.place.points
        spread = (self.w[:, None] * arms).T @ arms
        return np.asarray(arms @ np.linalg.pinv(spread, 1e-9, hermitian=True))


def common_misfit(problem: Problem, fit: Fit, size: float) -> float:
    """Standard deviation of p_CF, along each axis, from a misfit that pushes have in common [m].

    Args:
        problem: the pushes.
        fit: the mode.
        size: of the support [m].
    """
    shared = COMMON * fit.scale / problem.length * problem.place.arm
    return math.hypot(FLOOR * size, shared)


def finding(points: Array, steps: Steps, size: float) -> Generator[None, None, PosteriorMode | None]:
    """The mode over support points (n, 2) [m]; None if nothing moves into the object; pauses after each step.

    It is sought for an area and for feet; the one whose sectors foretell each other better is taken.
    """
    data = stretches(thinned(steps, MOST_STRETCHES), size)
    if data is None:
        return None
    area, feet = (problem_of(points, data, white) for white in WHITES)
    first = thinned(steps, FIRST_STRETCHES)
    few = area if first is steps else problem_of(points, stretches(first, size) or data, WHITES[0])
    yield
    begun: list[Fit] = []
    for start in STARTS:
        begun += [(yield from fitting(few, np.append(np.zeros(len(points)), start), FIRST_STEPS))]
    of_area = yield from fitting(area, max(begun, key=lambda one: one.evidence).parameters)
    if data.sticks.any():
        data = with_bounds(area.place, data, area.w(of_area.parameters))
        area, feet = area._replace(data=data), feet._replace(data=data)
        of_area = yield from fitting(area, of_area.parameters)
    alike = np.append(solved(feet.root, area.root @ of_area.parameters[:-1]), of_area.parameters[-1])
    of_feet = yield from fitting(feet, alike)
    modes = []
    for problem, fit in ((area, of_area), (feet, of_feet)):
        modes.append(PosteriorMode(problem, fit, size, *_left_out(problem, fit)))
        yield
    return min(modes, key=lambda one: one.cost)


def _left_out(problem: Problem, found: Fit) -> tuple[Array, float]:
    """The last two parts of `Mode`; of fewer than three pushes, no changes, and the evidence for the mode."""
    data = problem.data
    pushes, of_stretch = np.unique(data.push, return_inverse=True)
    if len(pushes) < 3:
        return np.zeros((0, len(found.parameters))), -found.evidence
    arms = data.contacts[data.begins] - problem.place.middle
    first = np.unique(of_stretch, return_index=True)[1]
    bearings = np.arctan2(arms[first, 1], arms[first, 0])
    order = np.argsort(bearings, kind="stable")
    gaps = np.diff(bearings[order], append=bearings[order[0]] + 2 * math.pi)
    order = np.roll(order, -1 - int(np.argmax(gaps)))  # from the widest gap on, however the object's frame is turned
    groups = np.array_split(order, min(SECTORS, len(pushes)))
    forced = np.isfinite(data.ratios)
    scaled, off = found.rows, np.sqrt(found.weights) * found.off
    square = smaller(scaled)
    changes, left = [], found.off.copy()
    for group in groups:
        inside = np.isin(of_stretch, group)
        rows = np.concatenate((np.repeat(inside, 3), inside[forced]))
        own = scaled[rows]
        left[rows] += found.slopes[rows] @ damped(scaled[~rows], own.T @ off[rows])
        # how much the group itself has drawn the mode to its own errors
        sizes, axes = np.linalg.eigh(np.eye(len(own)) - own @ damped(scaled, own.T, square))
        freed = axes @ ((axes.T @ off[rows]) / np.sqrt(np.maximum(sizes, LEAST_FREEDOM)))
        changes.append(damped(scaled, own.T @ freed, square))
    return math.sqrt(WIDER) * np.array(changes), student(problem, left)[0] + spread_cost(problem, found.roots, found.scale)
