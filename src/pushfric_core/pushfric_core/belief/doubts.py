"""Pushes that the others contradict, and a change of the object: both by how probable the pushes are, with and without.

A push is bad if it would be more probable among pushes that may have moved the object any way; it is compared with what all
others foretell. The object has changed if a shift of p_CF before one of the last pushes makes them more probable than none; the
same object may seem to shift, too, by the misfit that pushes have in common.
"""

import math
from collections.abc import Generator, Sequence
from typing import Annotated, NamedTuple

import numpy as np

from pushfric_core.belief.constants import (
    BAD_PUSH,
    BROAD,
    CHANGED,
    FEWEST_AFTER,
    FEWEST_BEFORE,
    FEWEST_COMPARED,
    LATEST,
    MANY_BAD,
    NU,
    SHIFT,
)
from pushfric_core.belief.fit import Fit, Problem, damped, smaller, solved
from pushfric_core.belief.mode import PosteriorMode, common_misfit
from pushfric_core.geometry.planar import Array
from pushfric_core.records import FieldPlace
from pushfric_core.wording import Reason

ROUNDS = 4
"""Rounds in which the parameters and the weights of the stretches are found in turns."""

TELLS = 0.03
"""Slopes below this say next to nothing: errors are of unit variance, and so are the parameters."""

LEAST_SPREAD = 0.05
"""Errors are not taken for less than this share of those of the mode, however well a change explains them."""


class Rejected(NamedTuple):
    """A push that is left out."""

    push_id: Annotated[int, FieldPlace(key="push")]
    reason: Reason


class Change(NamedTuple):
    """A change of the object."""

    since_push: int  # push_id of the first push after it
    shift: tuple[float, float]  # of p_CF [m]


def bad_pushes(mode: PosteriorMode) -> Generator[None, None, Sequence[Rejected]]:
    """The pushes that the others contradict; none if they are too few to tell, or too many to be exceptions; pauses."""
    pushes = np.unique(mode.problem.data.push).tolist()
    if len(pushes) < FEWEST_COMPARED:
        return ()
    fit, bad = informative(mode.fit), list[Rejected]()
    for push in pushes:
        if (one := _contradicted(mode.problem, fit, push)) is not None:
            bad.append(one)
        yield
    return bad if len(bad) <= MANY_BAD * len(pushes) else ()


def _contradicted(problem: Problem, fit: Fit, push: int) -> Rejected | None:
    data = problem.data
    inside = data.push == push
    moved = np.concatenate((np.repeat(inside, 3), np.zeros(len(fit.off) - 3 * len(inside), dtype=bool)))
    of_push = np.concatenate((np.repeat(inside, 3), inside[np.isfinite(data.ratios)]))
    scaled, slopes = fit.rows, fit.slopes[moved]
    own, others = scaled[of_push], scaled[~of_push]
    square = smaller(others)
    left = fit.off[moved] + slopes @ damped(others, own.T @ (np.sqrt(fit.weights) * fit.off)[of_push], square)
    covariance = np.eye(len(left)) + slopes @ damped(others, slopes.T, square)
    freedom, roots = problem.freedom[inside], fit.roots[inside]
    total = int(freedom.sum())
    known = _log_student(float(left @ solved(covariance, left)), total, NU) - float(np.linalg.slogdet(covariance)[1]) / 2
    broad = BROAD * data.lengths[inside] / np.sqrt(np.sum(roots**2, axis=(1, 2)) / 3)
    any_way = _log_student(float(np.sum((left / np.repeat(broad, 3)) ** 2)), total, 1.0) - float(freedom @ np.log(broad))
    if math.log(BAD_PUSH / (1 - BAD_PUSH)) + any_way < known:
        return None
    x, y, turn = (roots @ left.reshape(-1, 3, 1))[..., 0].sum(axis=0).tolist()
    text = (
        f"it moved the object by {1e3 * math.hypot(x, y):.1f} mm and {math.degrees(abs(turn) / problem.place.arm):.0f} degrees "
        "otherwise than the other pushes foretell: contact was lost, tracking jumped, or something else touched the object"
    )
    return Rejected(push, Reason("push_contradicts", text))


def _log_student(square: float, freedom: int, nu: float) -> float:
    """The logarithm of the Student density of errors of unit scale with this sum of squares."""
    constant = math.lgamma((nu + freedom) / 2) - math.lgamma(nu / 2) - freedom / 2 * math.log(nu * math.pi)
    return constant - (nu + freedom) / 2 * math.log1p(square / nu)


def changed(mode: PosteriorMode) -> tuple[Change, float] | None:
    """The likeliest change of the object before one of the last pushes, and the logarithm of how much more probable it is.

    None if no change is more probable.
    """
    data, fit = mode.problem.data, informative(mode.fit)
    pushes = np.unique(data.push)
    lasts = range(max(len(pushes) - LATEST, FEWEST_BEFORE), len(pushes) - FEWEST_AFTER + 1)
    if not lasts:
        return None
    by_shift = mode.fit.slopes[:, :-1] @ solved(mode.problem.root, mode.tilt)
    found = []
    for first in lasts:
        after = data.push >= pushes[first]
        shifted = by_shift[: 3 * len(after)] * np.repeat(after, 3)[:, None]
        gain, shift = displaced(mode.problem, fit, shifted, mode.size, SHIFT * mode.size)
        found.append((gain, int(pushes[first]), shift))
    odds = float(np.logaddexp.reduce([one for one, _, _ in found])) + math.log(CHANGED / (1 - CHANGED) / len(found))
    if odds < 0:
        return None
    _, since, (x, y) = max(found, key=lambda one: one[0])
    return Change(since, (float(x), float(y))), odds


def informative(fit: Fit) -> Fit:
    """The same with those combinations of the parameters alone of which the pushes tell anything; they are whitened, too."""
    _, sizes, axes = np.linalg.svd(fit.slopes, full_matrices=False)
    axes = axes[sizes > TELLS]
    return fit._replace(parameters=axes @ fit.parameters, slopes=fit.slopes @ axes.T)


def displaced(problem: Problem, fit: Fit, by_shift: Array, size: float, unusual: float) -> tuple[float, Array]:
    """How much more probable the motions are with a shift of unusual size than with one that a right model shows, too.

    Args:
        problem: of k stretches.
        fit: the mode without a shift.
        by_shift: (3k, s) slopes of the errors by each coordinate of the shift [1/m].
        size: of the support [m].
        unusual: standard deviation of each coordinate of the shift [m] if something is wrong.
    Returns:
        The logarithm of the ratio, and the shift (s,) [m] if it is unusual.
    """
    motions, count = len(by_shift), by_shift.shape[1]
    slopes = fit.slopes[:motions]
    off = fit.off[:motions] - slopes @ fit.parameters
    both = (common_misfit(problem, fit, size), unusual)
    (plain, _), (wrong, x) = (_evidence(problem, off, np.column_stack((slopes, by_shift * one))) for one in both)
    return wrong - plain, x[-count:] * unusual


def _evidence(problem: Problem, off: Array, slopes: Array) -> tuple[float, Array]:
    """The logarithm of how probable errors (3k,) are, and the best parameters (p,), which are normal of unit variance.

    The errors may be smaller or larger together than those of the mode.
    """
    freedom, x, spread = problem.freedom, np.zeros(slopes.shape[1]), 1.0
    total = float(freedom.sum())
    for _ in range(ROUNDS):
        size = np.sum((off + slopes @ x).reshape(-1, 3) ** 2, axis=1)
        for _ in range(2):
            spread = math.sqrt(float((NU + freedom) / (NU + size / spread**2) @ size) / total)
            spread = max(spread, LEAST_SPREAD)
        weights = np.repeat((NU + freedom) / (NU * spread**2 + size), 3)
        square = (slopes.T * weights) @ slopes + np.eye(len(x))
        x = -solved(square, slopes.T @ (weights * off))
    size = np.sum((off + slopes @ x).reshape(-1, 3) ** 2, axis=1) / spread**2
    told = float((NU + freedom) @ np.log1p(size / NU)) / 2 + total * math.log(spread)
    return -told - float(x @ x) / 2 - float(np.linalg.slogdet(square)[1]) / 2, x
