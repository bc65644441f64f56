"""The most probable pressure and mu_c, by Gauss-Newton.

The logarithm of the pressure at the support points is normal before any push, smooth over the support but for an own part of
each point (`constants`); w is its softmax. log mu_c is normal, too. The parameters are both, whitened: before any push they are
independent and of unit variance. The errors of a stretch are of a Student distribution, whose scale is fitted as well.
"""

import math
from collections.abc import Generator
from typing import NamedTuple

import numpy as np

from pushfric_core.belief import inner_loops
from pushfric_core.belief.constants import (
    FORCE_SPREAD,
    LEAST_SCALE,
    MU_C,
    MU_C_SPREAD,
    NU,
    ORDER,
    SMOOTH,
    VARIES,
)
from pushfric_core.belief.linearisation import Linearised, Place, anywhere, errors, linearised, motion_sizes, predicted
from pushfric_core.belief.stretches import Stretches
from pushfric_core.geometry.planar import Array, Indices
from pushfric_core.geometry.support import rms_arm
from pushfric_core.mechanics.quasi_static import Motions

STEPS = 10
"""At most so many steps of Gauss-Newton; five are usual."""

CONVERGED = 0.02
"""A step below this is the last, in standard deviations of what was believed before."""

LONGEST_STEP = 1.5
"""No logarithm of a pressure or of mu_c changes by more in one step."""

HALVINGS = 5
"""A step is halved at most so often, and given up then."""

STEP = 0.05
"""Step of log mu_c for the slope along it: long enough to see a push begin to slide."""

ROUNDS = 3
"""Rounds in which the scale and the weights of the stretches are found in turns."""


class Problem(NamedTuple):
    """The pushes, and how they are compared with a friction."""

    place: Place
    data: Stretches
    root: Array  # (n, n) a root of the covariance of the log pressure before any push
    share: Array  # (k,) variance of each stretch's errors as a share of the squared scale
    freedom: Indices  # (k,) dimensions of its errors: without a tip, only the turn about the contact is one
    length: float  # of a stretch, in the median [m]

    def left(self, fitted: float) -> float:
        """Degrees of freedom that so many fitted parameters leave."""
        freedom = float(self.freedom.sum())
        return max(freedom - fitted, freedom / 4)

    def w(self, parameters: Array) -> Array:
        """The support friction distribution (n,) of parameters (n + 1,)."""
        return softmax(self.root @ parameters[:-1])


class Fit(NamedTuple):
    """A mode, with the errors of k stretches and f measured forces about it."""

    parameters: Array  # (n + 1,)
    scale: float  # [m]
    roots: Array  # (k, 3, 3) of the errors' covariances
    off: Array  # (3k + f,) errors, of unit variance
    slopes: Array  # (3k + f, n + 1) of these
    weights: Array  # (3k + f,): small for outliers
    fitted: float  # how many parameters the pushes determine
    evidence: float

    @property
    def rows(self) -> Array:
        """(3k + f, n + 1) the slopes, weighted: their squares add up to what the pushes say of the parameters."""
        return np.asarray(np.sqrt(self.weights)[:, None] * self.slopes)


def log_mu_c(parameters: Array) -> float:
    """That of parameters (n + 1,)."""
    return math.log(MU_C) + MU_C_SPREAD * float(parameters[-1])


def problem_of(points: Array, data: Stretches, white: float) -> Problem:
    """The problem of finding w over points (n, 2), each with an own log pressure of this standard deviation."""
    modes = SMOOTH * cosines(points)
    root = root_of(modes @ modes.T + white**2 * np.eye(len(points)))
    length = float(np.median(data.lengths))
    share = (1 + (data.lengths / length) ** 2) / 2
    place = Place(points, points.mean(axis=0), rms_arm(points) or 1.0)
    return Problem(place, data, root, share, np.where(data.stuck, 1, 3), length)


def cosines(points: Array) -> Array:
    """(n, b) cosines over the support points, the smoother ones larger."""
    low, size = points.min(axis=0), np.maximum(np.ptp(points, axis=0), 1e-9)
    x, y = ((points - low) / size).T * math.pi
    found = [np.zeros(len(points))]  # of points on a line or in one place there may be none
    for total in range(1, ORDER + 1):
        for order in range(total + 1):
            mode = np.cos(order * x) * np.cos((total - order) * y)
            mode -= mode.mean()
            if (size_of := math.sqrt(float(np.mean(mode**2)))) > 1e-9:
                found.append(mode / (size_of * total))
    return np.column_stack(found)


def softmax(u: Array) -> Array:
    """Weights with sum 1 whose logarithms differ as u (n,) does."""
    weights = np.exp(u - u.max())
    return np.asarray(weights / weights.sum())


def root_of(matrices: Array) -> Array:
    """The lower triangular roots of positive definite matrices (..., n, n)."""
    return np.asarray(np.linalg.cholesky(matrices), dtype=float)


def solved(matrix: Array, values: Array) -> Array:
    """x of matrix x = values, a vector (n,) or columns (n, c)."""
    return np.asarray(np.linalg.solve(matrix, values))


def smaller(rows: Array) -> Array:
    """The smaller of rows' rows + 1 and rows rows' + 1, with r rows (r, n)."""
    r, n = rows.shape
    square = rows @ rows.T if r < n else rows.T @ rows
    square[np.diag_indices(len(square))] += 1
    return np.asarray(square)


def damped(rows: Array, values: Array, square: Array | None = None) -> Array:
    """x (n, ...) of (rows' rows + 1) x = values, with r rows (r, n), by `smaller`, which may be known already."""
    square = smaller(rows) if square is None else square
    if len(square) == rows.shape[1]:
        return solved(square, values)
    return values - rows.T @ solved(square, rows @ values)


def limit_of(problem: Problem, step: Array) -> float:
    """The part of a step of the parameters (n + 1,) that slopes may be relied on for."""
    change = max(float(np.abs(problem.root @ step[:-1]).max()), MU_C_SPREAD * abs(float(step[-1])))
    return min(1.0, LONGEST_STEP / max(change, 1e-9))


def fitting(problem: Problem, at: Array, steps: int = STEPS) -> Generator[None, None, Fit]:
    """Find the mode that is reached from some parameters (n + 1,), in at most so many steps; pauses after each."""
    scale, fitted, foretold = math.nan, 0.0, _foretold(problem, at)
    for left in range(steps, -1, -1):
        w, log = problem.w(at), log_mu_c(at)
        found = linearised(problem.place, problem.data, w, foretold)
        more = predicted(problem.place, problem.data, w, math.exp(log + STEP))
        by_mu_c = (errors(problem.place, problem.data, more) - found.errors) / STEP
        own = found.pivots + VARIES**2 * by_mu_c[:, :, None] * by_mu_c[:, None, :]
        own = own + anywhere(problem.place, problem.data, w, math.exp(log), found.errors)
        scale = _scale(problem, found.errors, own, scale, fitted)
        roots = root_of(own + (scale**2 * problem.share)[:, None, None] * np.eye(3))
        off, slopes = _whitened(problem, found, by_mu_c, roots, log)
        _, weights = student(problem, off)
        rows = np.sqrt(weights)[:, None] * slopes
        square = smaller(rows)
        fitted = len(square) - float(np.trace(np.linalg.inv(square)))
        if not left:
            break
        step = -damped(rows, slopes.T @ (weights * off) + at, square)
        step *= limit_of(problem, step)
        length, before = 1.0, cost(problem, off, at)
        while length > 0.5**HALVINGS:
            there = at + length * step
            foretold = _foretold(problem, there)
            if cost(problem, _whitened_errors(problem, roots, there, foretold), there) < before:
                break
            length /= 2
        if length <= 0.5**HALVINGS or length * float(np.abs(step).max()) < CONVERGED:
            break
        at = there
        yield
    evidence = -cost(problem, off, at) - spread_cost(problem, roots, scale) - float(np.linalg.slogdet(square)[1]) / 2
    return Fit(at, scale, roots, off, slopes, weights, fitted, evidence)


def cost(problem: Problem, off: Array, parameters: Array) -> float:
    """The negative log posterior of parameters (n + 1,) with errors (3k + f,), but for what depends on the scale alone."""
    return student(problem, off)[0] + float(parameters @ parameters) / 2


def student(problem: Problem, off: Array) -> tuple[float, Array]:
    """The negative log likelihood of errors (3k + f,) of unit variance, but for a constant, and their weights."""
    weights = np.empty_like(off)
    return inner_loops.student(off, problem.freedom, NU, weights), weights


def errors_at(problem: Problem, roots: Array, parameters: Array, w: Array | None = None) -> Array:
    """The errors (3k + f,) of unit variance at parameters (n + 1,); with another w, if one is given."""
    return _whitened_errors(problem, roots, parameters, _foretold(problem, parameters, w))


def _foretold(problem: Problem, parameters: Array, w: Array | None = None) -> Motions:
    w = problem.w(parameters) if w is None else w
    return predicted(problem.place, problem.data, w, math.exp(log_mu_c(parameters)))


def _whitened_errors(problem: Problem, roots: Array, parameters: Array, foretold: Motions) -> Array:
    off = errors(problem.place, problem.data, foretold)
    inner_loops.whiten_each(roots, off[..., None])
    return np.concatenate((off.reshape(-1), _forced(problem.data, log_mu_c(parameters))))


def _forced(data: Stretches, log: float) -> Array:
    """By how many standard deviations measured forces are off (f,): of a tip that is not seen to slide, only too large ones."""
    measured = np.isfinite(data.ratios)
    off = (log - np.log(data.ratios[measured])) / FORCE_SPREAD
    return np.where(data.slid[measured], off, np.minimum(off, 0.0))


def sizes_off(problem: Problem, fit: Fit) -> Array:
    """By how much the motions of the stretches are off (k,) [m]."""
    of_stretches = fit.off[: 3 * len(problem.freedom)].reshape(-1, 3, 1)
    return np.asarray(np.linalg.norm((fit.roots @ of_stretches)[..., 0], axis=1))


def misfits(problem: Problem, fit: Fit) -> Array:
    """The angles (k,) by which the motions of the stretches are off [rad]."""
    return np.asarray(np.arctan2(sizes_off(problem, fit), motion_sizes(problem.place, problem.data)))


def spread_cost(problem: Problem, roots: Array, scale: float) -> float:
    """The part of the negative log likelihood that the errors' covariances make up.

    Without a tip, errors have one dimension, and the covariances are those of the scale in the others.
    """
    logs = np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
    return float(np.sum(logs - (3 - problem.freedom) * np.log(scale * np.sqrt(problem.share))))


def _scale(problem: Problem, errors_seen: Array, own: Array, scale: float, fitted: float) -> float:
    """The likeliest scale [m] of errors (k, 3) that have own covariances (k, 3, 3) besides, after fitting some parameters."""
    least = LEAST_SCALE * problem.length
    if math.isnan(scale):
        scale = max(math.sqrt(float(np.median(np.sum(errors_seen**2, axis=1) / problem.share)) / 2.4), least)
    share, freedom, left = problem.share, problem.freedom, problem.left(fitted)
    for _ in range(ROUNDS):
        scale = max(inner_loops.rescaled(errors_seen, own, share, freedom, NU, left, scale), least)
    return scale


def _whitened(problem: Problem, found: Linearised, by_mu_c: Array, roots: Array, log: float) -> tuple[Array, Array]:
    """Errors (3k + f,) of unit variance, and their slopes (3k + f, n + 1)."""
    whitened = np.concatenate((found.slopes @ problem.root, MU_C_SPREAD * by_mu_c[..., None], found.errors[..., None]), axis=2)
    inner_loops.whiten_each(roots, whitened)
    slopes, off = whitened[..., :-1].reshape(-1, whitened.shape[2] - 1), whitened[..., -1].reshape(-1)
    forced = _forced(problem.data, log)
    of_forces = np.zeros((len(forced), slopes.shape[1]))
    of_forces[:, -1] = MU_C_SPREAD / FORCE_SPREAD
    return np.concatenate((off, forced)), np.concatenate((slopes, of_forces))
