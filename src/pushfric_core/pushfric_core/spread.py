"""How far the estimate can be trusted: what the data leave open, as a set of w, and how p_CF scatters in it.

The set {w: F(w) <= F* + k b} holds what fits the data about as well as the optimum. b = F* / (M - d) is the scale of the
errors; M is the number of data points, and d the number of weights above zero, less one. For errors of a Laplace
distribution, F / b is half a likelihood ratio. The set's extreme points along eight directions of p_CF are an ensemble, and
their mean is its middle.

Real errors are not independent Laplace errors. So the extent along a direction is turned into a standard deviation by the
sandwich rule: with s_i the slope of data point i's cost along it, and Delta the rise of F to the boundary,
sigma^2 = extent^2 * sum_i s_i^2 / (2 Delta)^2. Errors that the data points of one push share, or that cancel within a push,
enter as the design effect rho = sum_pushes (sum_i r_i)^2 / sum_i r_i^2 (Kish, "Survey Sampling", 1965) of the errors r_i.
docs/estimation.md has the evidence.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pushfric_core.constraint_rows import ConstraintRows
from pushfric_core.planar import Array, Indices
from pushfric_core.records import comparable
from pushfric_core.solvers.program import finite
from pushfric_core.support import center_of_friction
from pushfric_core.wording import counted

SHARE = 0.9
"""The truth lies within the ellipse this often."""

ELLIPSE = -2 * math.log(1 - SHARE)
"""x' C^-1 x at the edge of the ellipse of a normal distribution in the plane that holds SHARE of it."""

LEVEL = 4.6
"""k: how many b above the least F the set reaches; ELLIPSE, rounded."""

DIRECTIONS = np.column_stack([trig(np.arange(8) * math.pi / 4) for trig in (np.cos, np.sin)])
"""(8, 2) along which the set is measured; each of the last four is opposite to one of the first."""

CALIBRATION = 1.2
"""Factor on the standard deviation, chosen on simulated and real pushes together; docs/estimation.md has the shares."""

LEAST_EFFECT = 0.15
"""Least design effect: that of few data points may come out near zero by chance."""

COMMON = 1e-3
"""Standard deviation of what all pushes have in common, as a share of the support's size: outline, camera, support points."""

TURNS = 8
"""The extents of all w_j are found over this many measurements of the set, a few in each."""

FEWEST_PUSHES = 4
"""For fewer pushes there is no spread: how far p_CF scatters would rest on two differences between pushes, or fewer."""

SEPARATE = 0.12
"""Contacts at least this far apart are at different places, as a share of the support's size."""

FEWEST_PLACES = 3
"""Pushes at fewer places all carry the same information."""

ONE_SIDE = math.cos(math.radians(30))
"""Contacts whose normals lie within this angle of one another are on the same side."""

SELDOM = 50
"""The set is measured again after one more data point for each this many: up to 50 after each, then after every second, ..."""

REFRESHED = 200
"""The effects are computed again after one more data point for each this many, so that their cost does not grow."""


TO_ELLIPSE = np.linalg.pinv(
    np.column_stack((DIRECTIONS[:4, 0] ** 2, 2 * DIRECTIONS[:4, 0] * DIRECTIONS[:4, 1], DIRECTIONS[:4, 1] ** 2))
)
"""(3, 4) from the variances along the first four directions to xx, xy, yy of the covariance that has about these."""


@comparable
@dataclass(frozen=True)
class Spread:
    """What the data leave open.

    Attributes:
        extremes: (8, n) the w of the set that lie farthest along DIRECTIONS.
        middle: (n,) the mean of the extreme w: the middle of the set.
        samples: (8, n) equally probable w; their p_CF scatter by about the covariance: the extreme w, drawn towards the middle.
        covariance: (2, 2) of p_CF about the truth [m^2]; the ellipse x' C^-1 x <= 4.605 contains the truth in 90 % of cases.
        intervals: (n, 2) low and high: each w_j lies between them in 90 % of cases; 0 and 1 where that is not measured yet.
    """

    extremes: Array
    middle: Array
    samples: Array
    covariance: Array
    intervals: Array

    @property
    def radius(self) -> float:
        """Radius of the smallest circle about p_CF that contains the 90 % ellipse [m]."""
        return math.sqrt(ELLIPSE * float(np.linalg.eigvalsh(self.covariance)[-1]))


class Effects(NamedTuple):
    """What turns half extents (4,) into variances."""

    factors: Array  # (4,) variance along a direction over the half extent squared
    data_points: int  # how many they were computed from


def rise(objective: float, data_points: int, w: Array) -> float:
    """k b: how far above the least F the set reaches.

    Args:
        objective: F*.
        data_points: M.
        w: (n,) the optimum.
    """
    return LEVEL * objective / max(data_points - int(np.count_nonzero(w > 1e-9)) + 1, 1)


def effects(rows: ConstraintRows, groups: Indices, pushes: Indices, extremes: Array, scale: float, delta: float) -> Effects:
    """How the errors scatter along the four axes.

    Args:
        rows: of the program, m of them.
        groups: (m,) the data point that each row belongs to.
        pushes: (data points ever added,) the push of each data point.
        extremes: (8, n) of the set.
        scale: s of the optimum.
        delta: how far above the least F the set reaches.
    """
    n = extremes.shape[1]
    present, data = np.unique(groups, return_inverse=True)
    count = len(present)
    if delta <= 0:  # the data fit exactly: the set is that of the optima
        return Effects(np.full(4, 1 / ELLIPSE), count)
    residuals = rows.a[:, :n] @ extremes.mean(axis=0) + rows.a[:, n:].sum(axis=1) * scale
    slopes = np.where(residuals > 0, finite(rows.above), -finite(rows.below))
    along = (rows.a[:, :n] @ (extremes[:4] - extremes[4:]).T) * (slopes / 2)[:, None]  # per half extent
    scores = np.stack([np.bincount(data, weights=column, minlength=count) for column in along.T])
    errors = np.bincount(data, weights=np.abs(slopes) * residuals, minlength=count)
    _, push = np.unique(pushes[present], return_inverse=True)
    total = float(errors @ errors)
    clustered = np.bincount(push, weights=errors)
    design = max(LEAST_EFFECT, float(clustered @ clustered) / total) if total > 0 else 1.0
    return Effects(np.sum(scores**2, axis=1) * design / (2 * delta) ** 2, count)


def spread(points: Array, w: Array, extremes: Array, reach: Array, effect: Effects, freedom: int) -> Spread:
    """The spread from the extreme w of the set.

    Args:
        points: (n, 2) support points [m].
        w: (n,) of the estimate, about whose p_CF the ellipse lies.
        extremes: (8, n) w of the set, farthest along DIRECTIONS.
        reach: (n, 2) the least and the largest w_j of the set, or of an earlier, wider one; NaN where they are not known yet.
        effect: see `effects`.
        freedom: degrees of freedom that b, or the scatter between the pushes, rests on.
    """
    center = center_of_friction(points, w)
    farthest = np.einsum("ij,ij->i", extremes @ points, DIRECTIONS)
    half = (farthest[:4] + farthest[4:]) / 2
    # the quantile of F(2, freedom) over that of the normal distribution: a spread from few data is itself uncertain
    few = freedom / 2 * ((1 - SHARE) ** (-2 / freedom) - 1) / -math.log(1 - SHARE)
    variances = half**2 * effect.factors * few * CALIBRATION**2
    size = float(np.ptp(points, axis=0).max())
    covariance = _ellipse(variances) + (COMMON * size) ** 2 * np.eye(2)
    middle = extremes.mean(axis=0)
    offset = middle @ points - center
    covariance = covariance + np.outer(offset, offset) / ELLIPSE
    scatter = float(np.mean(np.sum((extremes @ points - middle @ points) ** 2, axis=1)))
    drawn = min(1.0, math.sqrt(np.trace(covariance) / scatter)) if scatter > 0 else 1.0
    samples = middle + drawn * (extremes - middle)
    wider = w[:, None] + CALIBRATION * np.column_stack((np.minimum(reach[:, 0] - w, 0.0), np.maximum(reach[:, 1] - w, 0.0)))
    intervals = np.where(np.isnan(reach), (0.0, 1.0), np.clip(wider, 0.0, 1.0))
    extremes = extremes.copy()
    for array in (extremes, middle, samples, covariance, intervals):
        array.setflags(write=False)
    return Spread(extremes, middle, samples, covariance, intervals)


def _ellipse(variances: Array) -> Array:
    """The covariance (2, 2) that has about these variances along the first four directions."""
    xx, xy, yy = TO_ELLIPSE @ variances
    values, axes = np.linalg.eigh(np.array(((xx, xy), (xy, yy))))
    return np.asarray((axes * np.maximum(values, 0.01 * variances.max())) @ axes.T)


class Variety:
    """Whether the pushes come from enough places and sides to tell p_CF at all.

    Args:
        size: of the support [m].
    """

    def __init__(self, size: float) -> None:
        self._apart = SEPARATE * size
        self._places: list[Array] = []
        self._normals: list[Array] = []
        self._last: int | None = None
        self._sameness: str | None = self._same()

    def add(self, push_id: int, contact: tuple[float, float], normal: tuple[float, float]) -> None:
        """Take a data point; the first one of each push says where it is."""
        if push_id == self._last:
            return
        self._last = push_id
        if all(math.dist(contact, place) > self._apart for place in self._places):
            self._places.append(np.asarray(contact))
            self._normals.append(np.asarray(normal))
            self._sameness = self._same()

    def lack(self, pushes: int) -> str | None:
        """What this number of pushes lacks to tell how far p_CF is off, in words; None if it lacks nothing."""
        if pushes < FEWEST_PUSHES:
            return (
                f"p_CF rests on {counted(pushes, 'push', 'pushes')}, and fewer than {FEWEST_PUSHES} cannot tell how far it is "
                f"off: push at least {FEWEST_PUSHES} times, at {FEWEST_PLACES} places or more, on more than one side"
            )
        return self._sameness

    def _same(self) -> str | None:
        """In what the pushes are all the same, in words; None if they vary enough."""
        if len(self._places) < FEWEST_PLACES:
            where = "one place" if len(self._places) == 1 else f"{len(self._places)} places"
            return f"all pushes are at {where} and say the same: push at least {FEWEST_PLACES} places, on more than one side"
        if all(float(normal @ self._normals[0]) >= ONE_SIDE for normal in self._normals):
            return "all pushes are against one side, which leaves p_CF open across it: push another side, too"
        return None
