"""The uncertainty of an estimate: the set of w that fit the data about as well, and how p_CF scatters in it.

The set {w: F(w) <= F* + k b} holds what fits the data about as well as the optimum. b = F* / (M - d) is the scale of the
errors; M is the number of observations, and d the number of weights above zero, less one. For errors of a Laplace
distribution, F / b is half a likelihood ratio. The set's extreme points along eight directions of p_CF are an ensemble, and
their mean is its middle.

Real errors are not independent Laplace errors. So the extent along a direction is turned into a standard deviation by the
sandwich rule: with s_i the slope of observation i's cost along it, and Delta the rise of F to the boundary,
sigma^2 = extent^2 * sum_i s_i^2 / (2 Delta)^2. Errors that the observations of one push share, or that cancel within a push,
enter as the design effect rho = sum_pushes (sum_i r_i)^2 / sum_i r_i^2 (Kish, "Survey Sampling", 1965) of the errors r_i.
Friction is not quite Coulomb's, which all pushes share, so that more of them do not help: this adds a share of the pushes' own
errors. docs/estimation.md has the evidence.
"""

import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pushfric_core.geometry.planar import Array, Indices
from pushfric_core.geometry.support import center_of_friction
from pushfric_core.program.constraint_rows import ConstraintRows
from pushfric_core.records import comparable
from pushfric_core.solvers.program import finite
from pushfric_core.uncertainty.reasons import Reason, ReasonCode
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
"""Least design effect: that of few observations may come out near zero by chance."""

SHARED = 0.5
"""Standard deviation of what the errors of all pushes have in common, as a share of the median size of a push's mean error: so
the ellipse of all pushes of a set holds the label in 15 of 16 sets of real pushes."""

FITTED = 0.5
"""Degrees of freedom between the pushes that a weight above zero takes: some weights fit what is within a push. Chosen, as
CALIBRATION, on simulated and real pushes together."""

COMMON = 1e-3
"""Standard deviation of what all pushes have in common, as a share of the support's size: outline, camera, support points."""

FEWEST_PUSHES = 4
"""For fewer pushes there is no spread: how far p_CF scatters would rest on two differences between pushes, or fewer."""

SEPARATE = 0.12
"""Contacts at least this far apart are at different places, as a share of the support's size."""

FEWEST_PLACES = 3
"""Pushes at fewer places all carry the same information."""

FINENESS = 20
"""Places are distinguished to this fraction of the distance that separates them, so that only a limited number are kept."""

ONE_SIDE = 30
"""Contacts whose normals lie within this angle of one another are on the same side [degrees]."""

NOISELESS = 1e-8
"""An F below this share of the F of the worst w is rounding: the data fit exactly, and the set is that of the optima."""

EXACT = 1000
"""Up to this many observations, each is followed by all that rests on all of them; then every second, third, ..., so that the
mean cost does not grow. A figure always says how many observations it holds, and at rest it holds all of them."""


TO_ELLIPSE = np.linalg.pinv(
    np.column_stack((DIRECTIONS[:4, 0] ** 2, 2 * DIRECTIONS[:4, 0] * DIRECTIONS[:4, 1], DIRECTIONS[:4, 1] ** 2))
)
"""(3, 4) from the variances along the first four directions to xx, xy, yy of the covariance that has about these."""


def ellipse_radius(covariance: Array) -> float:
    """Radius of the smallest circle that contains the ellipse of a covariance (2, 2), about the same middle."""
    return math.sqrt(ELLIPSE * float(np.linalg.eigvalsh(covariance)[-1]))


@comparable
@dataclass(frozen=True)
class Spread:
    """The uncertainty of an estimate.

    Attributes:
        extremes: (8, n) the w of the set that lie farthest along DIRECTIONS.
        middle: (n,) the mean of the extreme w: the middle of the set.
        samples: (8, n) equally probable w; their p_CF scatter by about the covariance: the extreme w, drawn towards the middle.
        covariance: (2, 2) of p_CF about the truth [m^2]; the ellipse x' C^-1 x <= 4.605 contains the truth in 90 % of cases.
        intervals: (n, 2) low and high: each w_j lies between them in 90 % of cases.
        data_points: the number of observations that all of this rests on: the first ones of the estimate, if it has more.
    """

    extremes: Array
    middle: Array
    samples: Array
    covariance: Array
    intervals: Array
    data_points: int

    @property
    def radius(self) -> float:
        """Radius of the smallest circle about p_CF that contains the 90 % ellipse [m]."""
        return ellipse_radius(self.covariance)


def is_due(count: int, held: int) -> bool:
    """Whether what rests on the first `held` of `count` observations must be computed again (see EXACT)."""
    return not 0 <= count - held <= count // EXACT


def rise(objective: float, worst: float, data_points: int, w: Array) -> float:
    """k b: how far above the least F the set reaches.

    Args:
        objective: F*.
        worst: a bound on the F of any w.
        data_points: M.
        w: (n,) the optimum.
    """
    return LEVEL * max(objective, NOISELESS * worst) / max(data_points - int(np.count_nonzero(w > 1e-9)) + 1, 1)


class Scatter(NamedTuple):
    """How the errors of the observations scatter."""

    factors: Array  # (4,) the variance along each of the four axes over the half extent squared
    misfit: float = 0.0  # median size of a push's mean error [m]


def scatter(rows: ConstraintRows, groups: Indices, pushes: Indices, extremes: Array, scale: float, delta: float) -> Scatter:
    """How the errors scatter about the middle of the set.

    Args:
        rows: of the program, m of them.
        groups: (m,) the observation that each row belongs to.
        pushes: (observations,) the push of each.
        extremes: (8, n) of the set.
        scale: s of the optimum.
        delta: how far above the least F the set reaches.
    """
    n = extremes.shape[1]
    count = len(pushes)
    residuals = rows.a[:, :n] @ extremes.mean(axis=0) + rows.a[:, n:].sum(axis=1) * scale
    slopes = np.where(residuals > 0, finite(rows.above), -finite(rows.below))
    along = (rows.a[:, :n] @ (extremes[:4] - extremes[4:]).T) * (slopes / 2)[:, None]  # per half extent
    scores = np.stack([np.bincount(groups, weights=column, minlength=count) for column in along.T])
    errors = np.bincount(groups, weights=np.abs(slopes) * residuals, minlength=count)
    _, push, sizes = np.unique(pushes, return_inverse=True, return_counts=True)
    total = float(errors @ errors)
    clustered = np.bincount(push, weights=errors)
    design = max(LEAST_EFFECT, float(clustered @ clustered) / total) if total > 0 else 1.0
    factors = np.asarray(np.sum(scores**2, axis=1) * design / (2 * delta) ** 2)
    return Scatter(factors, float(np.median(np.abs(clustered) / sizes)))


def spread(points: Array, w: Array, extremes: Array, reach: Array, errors: Scatter, pushes: int, data_points: int) -> Spread:
    """The spread from the extreme w of the set.

    Args:
        points: (n, 2) support points [m].
        w: (n,) of the estimate, about whose p_CF the ellipse lies.
        extremes: (8, n) w of the set, farthest along DIRECTIONS.
        reach: (n, 2) the least and the largest w_j of the set.
        errors: see `scatter`.
        pushes: the number of pushes.
        data_points: the number of observations.
    """
    center = center_of_friction(points, w)
    farthest = np.einsum("ij,ij->i", extremes @ points, DIRECTIONS)
    half = (farthest[:4] + farthest[4:]) / 2
    # degrees of freedom that b, or the scatter between the pushes, rests on
    fitted = int(np.count_nonzero(w > 1e-9)) - 1
    freedom = max(1.0, min(data_points - fitted, pushes - 1 - FITTED * fitted))
    # the quantile of F(2, freedom) over that of the normal distribution: a spread from few data is itself uncertain
    few = freedom / 2 * ((1 - SHARE) ** (-2 / freedom) - 1) / -math.log(1 - SHARE)
    variances = half**2 * errors.factors * few * CALIBRATION**2
    size = float(np.ptp(points, axis=0).max())
    covariance = _ellipse(variances) + ((SHARED * errors.misfit) ** 2 + (COMMON * size) ** 2) * np.eye(2)
    middle = extremes.mean(axis=0)
    offset = middle @ points - center
    covariance = covariance + np.outer(offset, offset) / ELLIPSE
    extent = float(np.mean(np.sum((extremes @ points - middle @ points) ** 2, axis=1)))
    drawn = min(1.0, math.sqrt(np.trace(covariance) / extent)) if extent > 0 else 1.0
    samples = middle + drawn * (extremes - middle)
    intervals = np.empty((len(w), 2))
    intervals[:, 0] = w + CALIBRATION * np.minimum(reach[:, 0] - w, 0.0)
    intervals[:, 1] = w + CALIBRATION * np.maximum(reach[:, 1] - w, 0.0)
    np.minimum(np.maximum(intervals, 0.0, out=intervals), 1.0, out=intervals)
    extremes = extremes.copy()
    for array in (extremes, middle, samples, covariance, intervals):
        array.setflags(write=False)
    return Spread(extremes, middle, samples, covariance, intervals, data_points)


def _ellipse(variances: Array) -> Array:
    """The covariance (2, 2) that has about these variances along the first four directions."""
    xx, xy, yy = TO_ELLIPSE @ variances
    values, axes = np.linalg.eigh(np.array(((xx, xy), (xy, yy))))
    return np.asarray((axes * np.maximum(values, 0.01 * variances.max())) @ axes.T)


class Excitation:
    """Whether the pushes come from enough places and sides to determine p_CF; the order of the pushes does not matter.

    Args:
        size: of the support [m].
    """

    def __init__(self, size: float) -> None:
        self._step = SEPARATE * size / FINENESS or 1.0
        self._pushes: set[int] = set()
        self._places: set[tuple[int, int]] = set()  # in steps
        self._bearings: set[int] = set()  # of the normals, to a degree
        self._separate = 1  # so many places are separate, at most FEWEST_PLACES
        self._one_side = True

    def add(self, push_id: int, contact: tuple[float, float], normal: tuple[float, float]) -> None:
        """Take an observation; the first one of each push says where it is."""
        if push_id in self._pushes:
            return
        self._pushes.add(push_id)
        place = round(contact[0] / self._step), round(contact[1] / self._step)
        if self._separate < FEWEST_PLACES and place not in self._places:
            others = [other for other in self._places if math.dist(place, other) > FINENESS]
            if others:
                third = any(math.dist(*pair) > FINENESS for pair in itertools.combinations(others, 2))
                self._separate = FEWEST_PLACES if third else 2
            self._places.add(place)
        bearing = round(math.degrees(math.atan2(normal[1], normal[0])))
        if self._one_side and bearing not in self._bearings:
            self._one_side = all(abs((bearing - other + 180) % 360 - 180) <= ONE_SIDE for other in self._bearings)
            self._bearings.add(bearing)

    def lack(self, pushes: int) -> Reason | None:
        """The lack of this number of pushes that keeps it from showing how far p_CF is off; None if there is none."""
        if pushes < FEWEST_PUSHES:
            return Reason(
                ReasonCode.FEW_PUSHES,
                f"p_CF rests on {counted(pushes, 'push', 'pushes')}, and fewer than {FEWEST_PUSHES} cannot tell how far it is "
                f"off: push at least {FEWEST_PUSHES} times, at {FEWEST_PLACES} places or more, on more than one side",
            )
        if self._separate < FEWEST_PLACES:
            where = "one place" if self._separate == 1 else f"{self._separate} places"
            text = f"all pushes are at {where} and say the same: push at least {FEWEST_PLACES} places, on more than one side"
            return Reason(ReasonCode.FEW_PLACES, text)
        if self._one_side:
            text = "all pushes are against one side, which leaves p_CF open across it: push another side, too"
            return Reason(ReasonCode.ONE_SIDE, text)
        return None
