"""The contact friction coefficient mu_c: a lower bound from every observation, and their percentiles (section 5.1.3)."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.contact import tangent
from pushfric_core.geometry.planar import LEAST_DIVISOR, Array, Indices, velocity_at
from pushfric_core.geometry.support import SupportForces
from pushfric_core.records import comparable
from pushfric_core.trajectories.observation import Observation
from pushfric_core.uncertainty.force_ratios import sliding
from pushfric_core.uncertainty.spread import LEVEL

SLIP_TOLERANCE = 0.05
"""A tip counts as sliding only if its velocity along the edge, relative to the object, exceeds this share of its speed ..."""

MISMATCHES = 2.0
"""... and this many times its median apparent velocity across the edge: the tip cannot move there, so that is an error."""

SURELY = 3.0
"""A push slips only if the tip slides this many times as far as tips usually seem to move across the edge within a push."""

FEWEST_SLIPS = 3
"""Unless this many pushes slip, mu_c is only bounded."""

LEAST_NORMAL = 0.05
"""Below this normal force, in units of the support friction, the pusher hardly presses: nothing is known of mu_c."""

LEAST_ERROR = 1e-3
"""No force is known better than this, in units of the support friction."""

TOGETHER = 10_000
"""Bounds are computed for several w at once up to this number of them; more take longer together, and more memory."""

BLOCK = 4096
"""Contacts whose bounds are computed together."""

CONFIDENT = 1.645
"""Standard deviations on either side that hold 90 % of a normal distribution."""


@comparable
class ContactForces(NamedTuple):
    """Forces of n supports of unit weight along the normals and tangents of m contacts."""

    normal: Array  # (m, n)
    along: Array  # (m, n)
    free: Array  # (m, n) 1 if a support may push any way with a force of at most its weight, else 0


def contact_forces(observation: Observation, forces: SupportForces) -> ContactForces:
    """The forces of one observation's supports, m = 1."""
    x, y = observation.contact_normal
    normal, along = np.array((x, y)), np.array((-y, x))
    return ContactForces((forces.directions @ normal)[None], (forces.directions @ along)[None], forces.free[None])


def lower_bounds(forces: ContactForces, weights: Array) -> Array:
    """tan(eta) = |f . t| / (f . n) of each observation (m,), infinite if f . n <= 0 (eq. 12).

    Supports whose force is unknown turn f towards the normal as far as they can, so that the result is still a lower bound.

    Args:
        forces: at m contacts.
        weights: (n,) estimate of w, or (k, n) several of them: then the result is (k, m).
    """
    normal, along, free = (_products(part, np.atleast_2d(weights)) for part in forces)
    along = np.abs(along)
    with np.errstate(divide="ignore", invalid="ignore"):
        bounds = np.where(normal > 0, along / normal, math.inf)
    if free.any():
        known = np.hypot(along, normal)
        turn = np.where(free < known, np.arcsin(np.minimum(free, known) / np.maximum(known, LEAST_DIVISOR)), math.pi)
        eta = np.maximum(np.arctan2(along, normal) - turn, 0.0)
        bounds = np.where(free > 0, np.where(eta < math.pi / 2, np.tan(eta), math.inf), bounds)
    return np.asarray(bounds if np.ndim(weights) > 1 else bounds[0])


def _products(part: Array, weights: Array) -> Array:
    """(k, m) of rows (m, n) with each of some w (k, n), some rows at a time, which stay in the cache.

    One product for each w: a product of matrices would have other last bits.
    """
    found = np.empty((len(weights), len(part)))
    for first in range(0, len(part), BLOCK):
        rows = slice(first, first + BLOCK)
        for w, products in zip(weights, found, strict=True):
            np.dot(part[rows], w, out=products[rows])
    return found


def percentile(bounds: Array, share: float) -> float:
    """The value at or below which `share` of the lower bounds (m,) lie: order statistic ceil(share * m).

    Of several rows of bounds (k, m), the least of these values.

    Raises:
        ValueError: no bounds, or a share outside (0, 1].
    """
    if not bounds.size:
        raise ValueError("a percentile needs at least one lower bound")
    if not 0 < share <= 1:
        raise ValueError(f"share must lie in (0, 1], got {share}")
    # the subtraction forgives 0.9 * 10 being a little above 9
    rank = math.ceil(share * bounds.shape[-1] - 1e-9)
    return float(np.partition(bounds, rank - 1)[..., rank - 1].min())


class Kind(StrEnum):
    """The evidence for mu_c."""

    BOUND = "bound"  # lower bounds alone
    SLIP = "slip"  # pushes that were seen to slide
    FORCE = "force"  # forces measured while the tip slid, as was seen or as their ratios show


class Slip(StrEnum):
    """How the tip moves along the edge."""

    UNKNOWN = "unknown"
    STICKING = "sticking"
    LEFT = "sliding left"  # along t
    RIGHT = "sliding right"


@comparable
@dataclass(frozen=True)
class Tip:
    """Motion and force of the tip at m contacts; NaN if unknown."""

    slip: Array  # (m,) its velocity along t relative to the object, over its speed
    mismatch: Array  # (m,) the same along n, where it cannot move: an error
    sensed: Array  # (m,) F . t / |F . n| of the measured force
    push: Array  # (m,) push_id

    @cached_property
    def tolerance(self) -> float:
        """The slip beyond which a tip counts as sliding."""
        seen = np.abs(self.mismatch[np.isfinite(self.mismatch)])
        return max(SLIP_TOLERANCE, MISMATCHES * float(np.median(seen))) if len(seen) else SLIP_TOLERANCE

    @cached_property
    def directions(self) -> Array:
        """(m,) of sliding along t: +1 and -1; 0: sticking; NaN: unknown.

        Errors of the poses cancel over consecutive observations of a push, as one ends where the next begins; a slide adds up.
        So a push is judged as a whole. It slides in the consecutive observations whose slip exceeds the tolerance most in sum,
        if the tip moves SURELY farther in them than tips usually seem to move across the edge. What is left of a push sticks if
        the tip stays where it is, and is unknown otherwise.
        """
        directions = np.full(len(self.slip), np.nan)
        seen = np.flatnonzero(np.isfinite(self.slip))
        seen = seen[np.argsort(self.push[seen], kind="stable")]
        if not len(seen):
            return directions
        slip, tolerance = self.slip[seen], self.tolerance
        begins = _begins(self.push[seen])
        usual = float(np.median(_farthest(self.mismatch[seen], begins)))
        found = np.zeros(len(seen))
        best = np.zeros(len(begins))  # of each push
        for direction in (1.0, -1.0):
            excess, inside = _longest_rise(direction * slip - tolerance, begins)
            travelled = np.add.reduceat(np.where(inside, direction * slip, 0.0), begins)
            better = (excess > best) & (travelled > SURELY * usual)
            best[better] = excess[better]
            of_push = np.repeat(better, _sizes(begins, len(seen)))
            found[of_push] = np.where(inside, direction, 0.0)[of_push]
        begins = _begins(self.push[seen], found)
        count = _sizes(begins, len(seen))
        still = _farthest(slip, begins) <= np.maximum(MISMATCHES * usual, SLIP_TOLERANCE * count)
        directions[seen] = np.where(found != 0, found, np.where(np.repeat(still, count), 0.0, np.nan))
        return directions

    @cached_property
    def by_ratio(self) -> tuple[float, float, float] | None:
        """mu_c and its interval from forces alone, at contacts not seen to slide or stick; None if they do not determine it."""
        rows = np.flatnonzero(np.isnan(self.directions) & np.isfinite(self.sensed))
        found = sliding(self.sensed[rows]) if len(np.unique(self.push[rows])) >= FEWEST_SLIPS else None
        return None if found is None else _median(found.sizes, found.probability, self.push[rows[found.probability > 0.5]])

    def bounds(self, forces: ContactForces, weights: Array) -> Array:
        """The lower bounds on mu_c (m,) or (k, m): the ratio of the measured force, or without one `lower_bounds`."""
        return np.where(np.isfinite(self.sensed), np.abs(self.sensed), lower_bounds(forces, weights))

    @property
    def slips(self) -> npt.NDArray[np.intp]:
        """How the tip moves in each of the m observations, as an index of `Slip`."""
        return np.nan_to_num(self.directions % 3 + 1).astype(int)  # NaN, 0, 1 and -1 in the order of Slip


class MuC(NamedTuple):
    """The contact friction coefficient."""

    value: float | None  # None if there is only a bound
    low: float  # mu_c lies in [low, high] with a probability of 90 %
    high: float  # infinite if there is only a bound
    kind: Kind


def tip_at(observation: Observation) -> tuple[float, float, float, float]:
    """The row of `Tip` of an observation."""
    slip = mismatch = sensed = math.nan
    if observation.tip_velocity is None and observation.force is None:
        return slip, mismatch, sensed, float(observation.push_id)
    normal = np.asarray(observation.contact_normal)
    along = tangent(normal)
    if observation.tip_velocity is not None and any(observation.tip_velocity):
        tip = np.asarray(observation.tip_velocity)
        relative = (tip - velocity_at(observation.twist, np.asarray(observation.contact_point))) / math.hypot(*tip)
        slip, mismatch = float(relative @ along), float(relative @ normal)
    if observation.force is not None and (pressed := abs(float(np.asarray(observation.force) @ normal))) > 0:
        sensed = float(np.asarray(observation.force) @ along) / pressed
    return slip, mismatch, sensed, float(observation.push_id)


def coefficient(forces: ContactForces, tip: Tip, weights: Array) -> MuC | None:
    """mu_c, from the sharpest evidence there is.

    A sliding contact is at the edge of its friction cone: |f . t| = mu_c f . n, with the sign of the slip. A sticking one is
    within it: |f . t| <= mu_c f . n. The mu_c that is returned minimises the sum of the errors of both. Consecutive
    observations of a push that slide, or stick, are taken together, because their errors cancel. A force counts the less, the
    more of it is unknown near the centre of rotation, and a sticking contact only as far as it contradicts by more than its
    error. The interval holds all mu_c whose sum of errors exceeds the least by at most LEVEL times the scale of the errors,
    under all w.

    If forces were measured while the tip slid, mu_c is the median of their ratios, with the interval of a median from this many
    pushes. If the tip was not seen, the ratios themselves may show which contacts slid (`force_ratios`).

    Args:
        forces: at m contacts.
        tip: at the same contacts.
        weights: (k, n) the w to consider, the likeliest first.
    Returns:
        None if the pusher presses in no observation.
    """
    directions = tip.directions
    with np.errstate(invalid="ignore"):
        slid = np.abs(directions) > 0
    measured = slid & np.isfinite(tip.sensed)
    if len(np.unique(tip.push[measured])) >= FEWEST_SLIPS:
        return MuC(*_median(np.abs(tip.sensed[measured]), np.ones(int(measured.sum())), tip.push[measured]), Kind.FORCE)
    if len(np.unique(tip.push[slid])) >= FEWEST_SLIPS:
        found = [_least_error(*rows) for rows in _cone_rows(forces, tip, directions, weights) if rows[2].sum() >= FEWEST_SLIPS]
        if found:
            return MuC(found[0][0], min(low for _, low, _ in found), max(high for _, _, high in found), Kind.SLIP)
    if tip.by_ratio is not None:
        return MuC(*tip.by_ratio, Kind.FORCE)
    together = max(1, TOGETHER // max(1, len(forces.normal)))
    parts = (weights[first : first + together] for first in range(0, len(weights), together))
    low = min(percentile(tip.bounds(forces, part), 0.9) for part in parts)
    return MuC(None, low, math.inf, Kind.BOUND)


def _cone_rows(
    forces: ContactForces, tip: Tip, directions: Array, weights: Array
) -> Iterator[tuple[Array, Array, npt.NDArray[np.bool_]]]:
    """The evidence on mu_c of observations that slide or stick, under each w: shear (r,), normal force (r,), and which slide.

    Each row is the sum over consecutive observations of a push; at most one row of each push slides. The error of a force is
    the tolerance, in units of the support friction: a velocity that errs by a share of the tip's turns the force by as much.
    """
    known = np.flatnonzero(np.isfinite(directions))
    known = known[np.argsort(tip.push[known], kind="stable")]
    determined = np.maximum(1 - forces.free[known], LEAST_DIVISOR)
    normal, along = (forces.normal[known] / determined) @ weights.T, (forces.along[known] / determined) @ weights.T
    tolerance, direction = tip.tolerance, directions[known]
    share = np.where(normal > LEAST_NORMAL, 1 / (1 + ((forces.free[known] @ weights.T) / tolerance) ** 2), 0.0)
    begins = _begins(tip.push[known], direction)
    error = tolerance * np.add.reduceat(share, begins) / _sizes(begins, len(known))[:, None]
    direction = direction[begins]
    sums = (np.add.reduceat(share * values, begins) for values in (normal, along))
    for across, tangential, uncertain in zip(*(one.T for one in sums), error.T, strict=True):
        sliding = -direction * tangential
        shear = np.where(direction != 0, sliding, np.maximum(np.abs(tangential) - uncertain, 0.0))
        presses = across > 0
        yield shear[presses], across[presses], direction[presses] != 0


def _least_error(shear: Array, normal: Array, slides: npt.NDArray[np.bool_]) -> tuple[float, float, float]:
    """The mu >= 0 with the least sum of |shear - mu normal| where the tip slides and of max(shear - mu normal, 0) elsewhere.

    Args:
        shear: (r,) in the direction in which the tip slides.
        normal: (r,) > 0.
        slides: (r,), at least two of them.
    Returns:
        mu, and the least and greatest one whose sum exceeds that by at most LEVEL times the scale of the errors.
    """
    ratios = np.maximum(shear / normal, 0.0)
    order = np.argsort(ratios, kind="stable")
    mu = ratios[order]
    below = np.cumsum((normal * slides)[order])  # slope of the rows that mu has passed
    above = (normal.sum() - np.cumsum(normal[order]))[:-1]
    slope = below[:-1] - above
    start = float(np.sum(np.where(slides, np.abs(shear - mu[0] * normal), np.maximum(shear - mu[0] * normal, 0.0))))
    sums = start + np.concatenate(([0.0], np.cumsum(slope * np.diff(mu))))
    best = int(np.argmin(sums))
    count = int(slides.sum())
    limit = float(sums[best]) + LEVEL * max(float(sums[best]) / (count - 1), LEAST_ERROR)
    # beyond the outermost ratios, the sum goes on in a straight line
    low = _reached(limit, -mu[best::-1], sums[best::-1], float(normal.sum()))
    high = _reached(limit, mu[best:], sums[best:], float(below[-1]))
    return float(mu[best]), max(-low, 0.0), high


def _reached(limit: float, places: Array, sums: Array, slope: float) -> float:
    """Where rising sums (r,) at growing places (r,) reach a limit; beyond the last one they rise with the slope."""
    beyond = int(np.searchsorted(sums, limit, side="right"))
    if beyond == len(sums):
        return float(places[-1]) + (limit - float(sums[-1])) / slope
    part = (limit - float(sums[beyond - 1])) / float(sums[beyond] - sums[beyond - 1])
    return float(places[beyond - 1]) + part * float(places[beyond] - places[beyond - 1])


def _begins(*keys: Array) -> Indices:
    """The index of the first row of each run of rows with equal keys (m,)."""
    changes = np.any([key[1:] != key[:-1] for key in keys], axis=0)
    return np.concatenate(([0], np.flatnonzero(changes) + 1))


def _sizes(begins: Indices, total: int) -> Indices:
    """The number of rows in each group, of a total number of rows."""
    return np.diff(np.append(begins, total))


def _summed(values: Array, begins: Indices) -> tuple[Array, Indices]:
    """Sums of the first 0, 1, ... values of each group (m + groups,), and where each group begins in them."""
    starts = begins + np.arange(len(begins))
    steps = np.insert(values, begins, 0.0)
    sums = np.cumsum(steps)
    return sums - np.repeat(sums[starts], _sizes(starts, len(steps))), starts


def _farthest(values: Array, begins: Indices) -> Array:
    """The largest absolute sum of consecutive values in each group."""
    sums, starts = _summed(values, begins)
    return np.asarray(np.maximum.reduceat(sums, starts) - np.minimum.reduceat(sums, starts))


def _longest_rise(values: Array, begins: Indices) -> tuple[Array, npt.NDArray[np.bool_]]:
    """The largest sum of consecutive values in each group, and which values (m,) belong to it."""
    sums, starts = _summed(values, begins)
    group = np.repeat(np.arange(len(starts)), _sizes(starts, len(sums)))
    # each group lies below all before it, so that the least sum so far is one of its own
    lowered = sums - group * (1.0 + float(np.ptp(sums)))
    least = np.minimum.accumulate(lowered)
    place = np.arange(len(sums))
    rise = lowered - least
    highest = np.maximum.reduceat(rise, starts)
    top = np.minimum.reduceat(np.where(rise == highest[group], place, len(sums)), starts)
    bottom = np.maximum.accumulate(np.where(lowered == least, place, 0))[top]
    inside = (place > bottom[group]) & (place <= top[group])
    return np.asarray(highest), np.delete(inside, starts)


def _median(values: Array, weights: Array, pushes: Array) -> tuple[float, float, float]:
    """A weighted median, and the interval that holds the population's median with a probability of 90 %."""
    order = np.argsort(values)
    shares = np.cumsum(weights[order])
    reach = CONFIDENT / 2 / math.sqrt(len(np.unique(pushes)))
    wanted = np.array((0.5, max(0.5 - reach, 0.0), min(0.5 + reach, 1.0))) * shares[-1]
    places = np.minimum(np.searchsorted(shares, wanted), len(values) - 1)
    value, low, high = values[order][places].tolist()
    return value, low, high
