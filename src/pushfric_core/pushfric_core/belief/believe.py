"""From the pushes of a run to samples of w and mu_c.

The curvature of the likelihood alone promises too much, because friction departs from its model alike in pushes alike. So the
contacts are divided into sectors by bearing, and the scatter between these is added, as for clustered data (Bell and McCaffrey,
"Bias reduction in standard errors for linear regression with multi-stage samples", 2002). mu_c may be bounded on one side only,
so its marginal is taken on a grid instead of from the curvature.
"""

import math
from collections.abc import Generator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.belief.constants import COMMON, FLOOR, MU_C, MU_C_SPREAD, OPEN, PAIRS, SECTORS, WHITES, WIDER
from pushfric_core.belief.fit import (
    Fit,
    Problem,
    cost,
    damped,
    errors_at,
    fitting,
    limit_of,
    of_stretches,
    problem_of,
    root_of,
    row_weights,
    solved,
    spread_cost,
    student,
)
from pushfric_core.belief.linearisation import motion_sizes, with_bounds
from pushfric_core.belief.stretches import stretches
from pushfric_core.geometry.planar import Array, as_array
from pushfric_core.mechanics.prediction import SHARE, FrictionModel, Kind
from pushfric_core.steps import finished
from pushfric_core.trajectories.observation import Observation

STARTS, FIRST_STEPS = (-1.0, 0.0, 1.0), 3
"""Each way in which pushes stick and slide may have a mode of its own. So the search tries some steps from these mu_c, in
standard deviations of its logarithm, and goes on from the best."""

WIDE = np.linspace(-3.0, 3.0, 13)
"""Logarithms of mu_c at which its marginal is taken, in standard deviations of what was believed before, ..."""

NEAR = np.linspace(-4.0, 4.0, 9)
"""... and more about the mode, in its own."""

LEAST_FREEDOM = 0.05
"""A sector that draws the mode to its own errors wholly shows none; they are enlarged as if this share of them were left."""

SEED = 7
"""Seed of the samples: the same pushes always give the same."""


def believe(points: npt.ArrayLike, observations: Sequence[Observation]) -> FrictionModel | None:
    """The belief about an object's friction after some pushes: equally weighted samples of w and mu_c.

    It is a function of the observations alone, whatever their order.

    Args:
        points: (n, 2) support points, object frame [m].
        observations: m.
    Returns:
        None if in no observation anything moves into the object.

    Example:
        >>> from pushfric_core import Observation, Twist, believe
        >>> one = Observation((0.01, -0.03), (0.0, -1.0), Twist(0.0, 0.02, 0.1))
        >>> believe([(-0.05, -0.02), (0.05, -0.02), (0.0, 0.02)], [one]).w.shape
        (32, 3)
    """
    return finished(believing(points, observations))


def believing(points: npt.ArrayLike, observations: Sequence[Observation]) -> Generator[None, None, FrictionModel | None]:
    """As `believe`, but pauses after each step, for a program that has other things to do meanwhile."""
    supports = as_array(points)
    size = max(float(np.ptp(supports, axis=0).max()), 1e-9)
    data = stretches(observations, size)
    if data is None:
        return None
    area, feet = (problem_of(supports, data, white) for white in WHITES)
    best: Fit | None = None
    for start in STARTS:
        begun = yield from fitting(area, np.append(np.zeros(len(supports)), start), FIRST_STEPS)
        best = begun if best is None or begun.evidence > best.evidence else best
    assert best is not None
    of_area = yield from fitting(area, best.parameters)
    if data.sticks.any():
        data = with_bounds(area.place, data, area.w(of_area.parameters))
        area, feet = area._replace(data=data), feet._replace(data=data)
        of_area = yield from fitting(area, of_area.parameters)
    alike = np.append(solved(feet.root, area.root @ of_area.parameters[:-1]), of_area.parameters[-1])
    of_feet = yield from fitting(feet, alike)
    fits = [_Judged(problem, found, *_left_out(problem, found)) for problem, found in ((area, of_area), (feet, of_feet))]
    yield
    return _drawn(min(fits, key=lambda one: one.cost), size, len(observations))


class _Judged(NamedTuple):
    """A mode, and how it rests on each of g sectors of the contacts."""

    problem: Problem
    fit: Fit
    changes: Array  # (g, n + 1) that each sector's own errors make to the parameters; their squares add up to a variance
    cost: float  # negative log likelihood of each sector by the fit to the others


def _left_out(problem: Problem, found: Fit) -> tuple[Array, float]:
    """The last two parts of `_Judged`; of fewer than three pushes, no changes, and the evidence for the mode."""
    data = problem.data
    pushes, of_stretch = np.unique(data.push, return_inverse=True)
    if len(pushes) < 3:
        return np.zeros((0, len(found.parameters))), -found.evidence
    arms = data.contacts[data.begins] - problem.place.middle
    first = np.unique(of_stretch, return_index=True)[1]
    order = np.argsort(np.arctan2(arms[first, 1], arms[first, 0]), kind="stable")
    groups = np.array_split(order, min(SECTORS, len(pushes)))
    forced = np.isfinite(data.ratios)
    scaled, off = found.rows, np.sqrt(found.weights) * found.off
    changes, left = [], found.off.copy()
    for group in groups:
        inside = np.isin(of_stretch, group)
        rows = np.concatenate((np.repeat(inside, 3), inside[forced]))
        own = scaled[rows]
        left[rows] += found.slopes[rows] @ damped(scaled[~rows], own.T @ off[rows])
        # how much the group itself has drawn the mode to its own errors
        sizes, axes = np.linalg.eigh(np.eye(len(own)) - own @ damped(scaled, own.T))
        freed = axes @ ((axes.T @ off[rows]) / np.sqrt(np.maximum(sizes, LEAST_FREEDOM)))
        changes.append(damped(scaled, own.T @ freed))
    return math.sqrt(WIDER) * np.array(changes), student(problem, left) + spread_cost(problem, found.roots)


def _few(groups: int) -> float:
    """How much wider a region is because the scatter rests on few groups: Hotelling's T^2 over the normal distribution's."""
    freedom = groups - 2
    if freedom <= 0:
        return 1.0
    quantile: float = freedom / 2 * ((1 - SHARE) ** (-2 / freedom) - 1)  # of F(2, freedom)
    return (groups - 1) / freedom * quantile / -math.log(1 - SHARE)


class _Profile(NamedTuple):
    """The best parameters at each of g values of mu_c, by the slopes at a mode."""

    grid: Array  # (g,) of the last parameter
    shifts: Array  # (g, n + 1) from the mode
    likelihood: Array  # (g,) its logarithm, with what was believed of w before


def _profile(problem: Problem, found: Fit, grid: Array) -> _Profile:
    slopes, w = found.slopes[:, :-1], problem.w(found.parameters)
    shifts, likelihood = [], []
    for value in grid.tolist():
        at = np.append(found.parameters[:-1], value)
        off = errors_at(problem, found.roots, at, w)
        weights = row_weights(problem, off)
        shift = -damped(np.sqrt(weights)[:, None] * slopes, slopes.T @ (weights * off) + at[:-1])
        shifts.append(np.append(shift, value - found.parameters[-1]))
        likelihood.append(-cost(problem, off + slopes @ shift, np.append(at[:-1] + shift, 0.0)))
    return _Profile(grid, np.array(shifts), np.array(likelihood))


def _chances(profile: _Profile, variance: float) -> Array:
    """How probable each value of mu_c is, if the likelihood is widened by a variance (g,)."""
    step, grid = np.gradient(profile.grid), profile.grid
    likelihood = np.exp(profile.likelihood - profile.likelihood.max())
    if variance > 0:
        kernel = np.exp(-((grid[:, None] - grid) ** 2) / (2 * variance)) * step
        likelihood = kernel @ likelihood / kernel.sum(axis=1)
    posterior = likelihood * np.exp(-(grid**2) / 2) * step
    return np.asarray(posterior / posterior.sum())


def _drawn(judged: _Judged, size: float, count: int) -> FrictionModel:
    """The samples, in pairs on either side of the mode, so that their mean is the mode's w."""
    problem, found, changes = judged.problem, judged.fit, judged.changes
    points, w = problem.place.points, problem.w(found.parameters)
    to_center = ((points - w @ points) * w[:, None]).T @ problem.root  # from the parameters to p_CF
    covariance = _covariance(judged, size, to_center)
    variance = _few(len(changes)) * float(np.sum(np.minimum(np.abs(changes[:, -1]), 1.0) ** 2))
    mu_c = np.zeros(len(points) + 1)
    mu_c[-1] = 1.0
    deviation = math.sqrt(float(damped(found.rows, mu_c)[-1]) + variance)
    profile = _profile(problem, found, np.sort(np.concatenate((WIDE, found.parameters[-1] + deviation * NEAR))))
    rng = np.random.default_rng(SEED)
    noise = _noise(judged, size, to_center, rng)
    noise += _corrected(noise @ to_center.T, covariance, to_center)
    levels = (rng.permutation(PAIRS) + 0.5) / (2 * PAIRS)
    chances = _chances(profile, variance)
    places = np.cumsum(chances) - chances / 2
    values = [np.interp(of_pair, places, profile.grid) for of_pair in (levels, 1 - levels)]
    low, high = (np.column_stack([np.interp(one, profile.grid, s) for s in profile.shifts[:, :-1].T]) for one in values)
    change = (noise + (low - high) / 2) @ problem.root.T
    change -= (change @ w)[:, None]
    change /= np.maximum(np.abs(change).max(axis=1, keepdims=True), 1.0)  # no weight below zero
    samples = np.concatenate((w * (1 + change), w * (1 - change)))
    samples /= samples.sum(axis=1, keepdims=True)
    is_open = profile.likelihood[-1] > profile.likelihood.max() - OPEN
    kind = Kind.FORCE if problem.data.slid.any() else Kind.BOUND if is_open else Kind.SLIP
    logs = math.log(MU_C) + MU_C_SPREAD * np.concatenate(values)
    share = np.full(2 * PAIRS, 1 / (2 * PAIRS))
    return FrictionModel(points, samples, np.exp(logs), share, _misfit(problem, found), covariance, kind, count)


def _covariance(judged: _Judged, size: float, to_center: Array) -> Array:
    """The covariance (2, 2) of p_CF about the truth [m^2]."""
    problem, found, changes = judged.problem, judged.fit, judged.changes
    points, floor = problem.place.points, (FLOOR * size) ** 2
    sectors = to_center @ changes[:, :-1].T
    common = COMMON * found.scale / float(np.median(problem.data.lengths)) * problem.place.arm
    after = to_center @ damped(found.rows[:, :-1], to_center.T) + _few(len(changes)) * sectors @ sectors.T
    before = ((points - points.mean(axis=0)) / len(points)).T @ problem.root
    return _together(after + (floor + common**2) * np.eye(2), before @ before.T + floor * np.eye(2))


def _noise(judged: _Judged, size: float, to_center: Array, rng: np.random.Generator) -> Array:
    """By how much PAIRS samples of the whitened log pressures are off the mode (PAIRS, n)."""
    problem, changes, rows = judged.problem, judged.changes, judged.fit.rows[:, :-1]
    limited = np.array([limit_of(problem, change) * change for change in changes]).reshape(changes.shape)
    draws, of_rows, of_sectors = (rng.standard_normal((PAIRS, length)) for length in (rows.shape[1], len(rows), len(changes)))
    noise = damped(rows, (draws + of_rows @ rows).T).T + of_sectors @ limited[:, :-1]
    # what neither the pushes nor p_CF show stays as it is
    shown = np.concatenate((rows, to_center / (FLOOR * size)))
    return damped(np.concatenate((rows, shown)), shown.T @ (shown @ noise.T)).T


def _together(one: Array, other: Array) -> Array:
    """The covariance (2, 2) of an error that is known in two ways."""
    both = np.linalg.inv(np.linalg.inv(one) + np.linalg.inv(other))
    return np.asarray(both + both.T) / 2


def _corrected(places: Array, wanted: Array, to_center: Array) -> Array:
    """Corrections of samples of the parameters, so that their p_CF (s, 2) scatter as is wanted (2, 2)."""
    have = places.T @ places / len(places) + 1e-9 * wanted
    change = places @ solved(root_of(have).T, root_of(wanted).T) - places
    square = to_center @ to_center.T
    return np.asarray(change @ solved(square + 1e-9 * np.trace(square) * np.eye(2) + 1e-30 * np.eye(2), to_center))


def _misfit(problem: Problem, found: Fit) -> float:
    """The angle that 90 % of new motions stay below, by those of the pushes that were fitted [rad]."""
    off = of_stretches(problem, found.off)
    sizes = np.linalg.norm((found.roots @ off[..., None])[..., 0], axis=1)
    angles = np.sort(np.arctan2(sizes, motion_sizes(problem.place, problem.data)))
    rank = min(math.ceil(SHARE * (len(angles) + 1) - 1e-9), len(angles))
    rows = found.rows
    fitted = float(np.sum(rows * damped(rows, rows.T).T))
    return min(float(angles[rank - 1]) * math.sqrt(problem.left(0.0) / problem.left(fitted)), math.pi)
