"""From the mode of a run to samples of w and mu_c.

mu_c may be bounded on one side only, so its marginal is taken on a grid instead of from the curvature.
"""

import math
from collections.abc import Generator, Sequence

import numpy as np
import numpy.typing as npt

from pushfric_core.belief.constants import FLOOR, MU_C, MU_C_SPREAD, OPEN, PAIRS
from pushfric_core.belief.fit import Fit, Problem, cost, damped, errors_at, limit_of, root_of, sizes_off, solved, student
from pushfric_core.belief.linearisation import errors_per_way, predicted
from pushfric_core.belief.mode import PosteriorMode, common_misfit, finding
from pushfric_core.belief.stretches import size_of, steps_of
from pushfric_core.geometry.planar import Array
from pushfric_core.geometry.support import check_points
from pushfric_core.mechanics.prediction import SHARE, FrictionModel, Kind
from pushfric_core.mechanics.quasi_static import SLIDING
from pushfric_core.steps import finished
from pushfric_core.trajectories.observation import Observation

WIDE = np.linspace(-3.0, 3.0, 13)
"""Logarithms of mu_c at which its marginal is taken, in standard deviations of what was believed before, ..."""

NEAR = np.linspace(-4.0, 4.0, 9)
"""... and more about the mode, in its own."""

ROUNDS = 4
"""Rounds in which samples get the scatter of p_CF that is wanted, and lose weights below zero."""

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
    Raises:
        ValueError: the points are not such support points.

    Example:
        >>> from pushfric_core import Observation, Twist, believe
        >>> one = Observation((0.01, -0.03), (0.0, -1.0), Twist(0.0, 0.02, 0.1))
        >>> believe([(-0.05, -0.02), (0.05, -0.02), (0.0, 0.02)], [one]).w.shape
        (32, 3)
    """
    supports = check_points(points)
    size = size_of(supports)
    mode = finished(finding(supports, steps_of(observations, size), size))
    return None if mode is None else finished(drawing(mode, len(observations)))


def _few(groups: int) -> float:
    """How much wider a region is because the scatter rests on few groups: Hotelling's T^2 over the normal distribution's."""
    freedom = groups - 2
    if freedom <= 0:
        return 1.0
    quantile: float = freedom / 2 * ((1 - SHARE) ** (-2 / freedom) - 1)  # of F(2, freedom)
    return (groups - 1) / freedom * quantile / -math.log(1 - SHARE)


def _profile(problem: Problem, found: Fit, grid: Array) -> Generator[None, None, tuple[Array, Array]]:
    """The best w at each of g values of mu_c, by the slopes at a mode; pauses after each.

    Returns:
        Shifts (g, n) of the parameters of w, and logarithms (g,) of the likelihood with what was believed of w before.
    """
    slopes, w = found.slopes[:, :-1], problem.w(found.parameters)
    shifts, likelihood = [], []
    for value in grid.tolist():
        at = np.append(found.parameters[:-1], value)
        off = errors_at(problem, found.roots, at, w)
        _, weights = student(problem, off)
        shifts.append(-damped(np.sqrt(weights)[:, None] * slopes, slopes.T @ (weights * off) + at[:-1]))
        likelihood.append(-cost(problem, off + slopes @ shifts[-1], np.append(at[:-1] + shifts[-1], 0.0)))
        yield
    return np.array(shifts), np.array(likelihood)


def _chances(grid: Array, logs: Array, variance: float) -> Array:
    """How probable each value of mu_c is, if the likelihood, of these logarithms, is widened by a variance (g,)."""
    step, likelihood = np.gradient(grid), np.exp(logs - logs.max())
    if variance > 0:
        kernel = np.exp(-((grid[:, None] - grid) ** 2) / (2 * variance)) * step
        likelihood = kernel @ likelihood / kernel.sum(axis=1)
    posterior = likelihood * np.exp(-(grid**2) / 2) * step
    return np.asarray(posterior / posterior.sum())


def drawing(mode: PosteriorMode, count: int) -> Generator[None, None, FrictionModel]:
    """The samples about a mode of so many observations, in pairs on either side, so that their mean is the mode's w; pauses."""
    problem, found, changes, points, w = mode.problem, mode.fit, mode.changes, mode.problem.place.points, mode.w
    arms, tilt = points - w @ points, mode.tilt
    to_center = (arms * w[:, None]).T @ problem.root  # from the parameters to p_CF
    covariance = _covariance(mode, to_center)
    variance = _few(len(changes)) * float(np.sum(np.minimum(np.abs(changes[:, -1]), 1.0) ** 2))
    mu_c = np.append(np.zeros(len(points)), 1.0)
    deviation = math.sqrt(float(damped(found.rows, mu_c)[-1]) + variance)
    grid = np.sort(np.concatenate((WIDE, found.parameters[-1] + deviation * NEAR)))
    shifts, likelihood = yield from _profile(problem, found, grid)
    rng = np.random.default_rng(SEED)
    noise = _noise(mode, to_center, rng)
    levels = (rng.permutation(PAIRS) + 0.5) / (2 * PAIRS)
    chances = _chances(grid, likelihood, variance)
    places = np.cumsum(chances) - chances / 2
    values = [np.interp(of_pair, places, grid) for of_pair in (levels, 1 - levels)]
    low, high = (np.column_stack([np.interp(one, grid, s) for s in shifts.T]) for one in values)
    change = (noise + (low - high) / 2) @ problem.root.T
    change -= (change @ w)[:, None]
    for _ in range(ROUNDS):
        places = (w * change) @ arms
        have = places.T @ places / PAIRS + 1e-9 * covariance
        change += (places @ solved(root_of(have).T, root_of(covariance).T) - places) @ tilt.T
        change /= np.maximum(np.abs(change).max(axis=1, keepdims=True), 1.0)  # no weight below zero
    samples = np.concatenate((w * (1 + change), w * (1 - change)))
    samples /= samples.sum(axis=1, keepdims=True)
    is_open = likelihood[-1] > likelihood.max() - OPEN
    kind = Kind.FORCE if problem.data.slid.any() else Kind.BOUND if is_open else Kind.SLIP
    mu_cs = np.exp(math.log(MU_C) + MU_C_SPREAD * np.concatenate(values))
    misfits = _misfits(mode, float(np.median(mu_cs)))
    return FrictionModel(points, samples, mu_cs, np.full(2 * PAIRS, 1 / (2 * PAIRS)), *misfits, covariance, kind, count)


def _covariance(mode: PosteriorMode, to_center: Array) -> Array:
    """The covariance (2, 2) of p_CF about the truth [m^2]."""
    points, floor = mode.problem.place.points, (FLOOR * mode.size) ** 2
    sectors = to_center @ mode.changes[:, :-1].T
    after = to_center @ damped(mode.fit.rows[:, :-1], to_center.T) + _few(len(mode.changes)) * sectors @ sectors.T
    before = ((points - points.mean(axis=0)) / len(points)).T @ mode.problem.root
    common = common_misfit(mode.problem, mode.fit, mode.size) ** 2
    # the covariance of an error that is known in two ways
    known = (np.linalg.inv(one) for one in (after + common * np.eye(2), before @ before.T + floor * np.eye(2)))
    both = np.linalg.inv(sum(known))
    return np.asarray(both + both.T) / 2


def _noise(mode: PosteriorMode, to_center: Array, rng: np.random.Generator) -> Array:
    """By how much PAIRS samples of the whitened log pressures are off the mode (PAIRS, n)."""
    problem, changes, rows = mode.problem, mode.changes, mode.fit.rows[:, :-1]
    limited = np.array([limit_of(problem, change) * change for change in changes]).reshape(changes.shape)
    draws, of_rows, of_sectors = (rng.standard_normal((PAIRS, length)) for length in (rows.shape[1], len(rows), len(changes)))
    noise = damped(rows, (draws + of_rows @ rows).T).T + of_sectors @ limited[:, :-1]
    # what neither the pushes nor p_CF show stays as it is
    shown = np.concatenate((rows, to_center / (FLOOR * mode.size)))
    return damped(np.concatenate((rows, shown)), shown.T @ (shown @ noise.T)).T


def _misfits(mode: PosteriorMode, mu_c: float) -> tuple[float, float, float]:
    """The misfits of a `FrictionModel`, in its order: by the steps, and the whole stretches, that were fitted.

    Where the tip slides, more is off, as mu_c may differ from push to push.
    """
    problem, found = mode.problem, mode.fit
    fitted, steps = found.fitted, float(problem.freedom[problem.data.stretch].sum())
    foretold = predicted(problem.place, problem.data, mode.w, mu_c)
    of_steps, slides = errors_per_way(problem.place, problem.data, foretold), foretold.modes == SLIDING
    enlarged = math.sqrt(steps / max(steps - fitted, steps / 4))
    sticking, sliding = (enlarged * _reached(of_steps[some] if some.any() else of_steps) for some in (~slides, slides))
    of_stretches = _reached(sizes_off(problem, found) / problem.data.lengths)
    few = _few(len(np.unique(problem.data.push)))
    of_strokes = of_stretches * math.sqrt(few * problem.left(0.0) / problem.left(fitted))
    return sticking, max(sticking, sliding), of_strokes


def _reached(values: Array) -> float:
    """A bound that 90 % of new values stay below; of fewer than nine, the largest."""
    rank = min(math.ceil(SHARE * (len(values) + 1) - 1e-9), len(values))
    return float(np.sort(values)[rank - 1])
