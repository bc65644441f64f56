"""The contact friction coefficient mu_c: a lower bound from every data point, and their percentiles (section 5.1.3)."""

import math
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from pushfric_core.contact import tangent
from pushfric_core.observation import Observation
from pushfric_core.planar import Array, velocity_at
from pushfric_core.records import comparable
from pushfric_core.support import SupportForces

SLIP_TOLERANCE = 0.05
"""A tip counts as sliding only if its velocity along the edge, relative to the object, exceeds this share of its speed ..."""

MISMATCHES = 2.0
"""... and this many times its median apparent velocity across the edge: the tip cannot move there, so that is an error."""

FEWEST_SLIPS = 3
"""Unless this many pushes slip, mu_c is only bounded."""

LEAST_NORMAL = 0.05
"""Below this normal force, in units of the support friction, the pusher hardly presses: the data point says nothing of mu_c."""

CONFIDENT = 1.645
"""Standard deviations on either side that hold 90 % of a normal distribution."""

TINY = 1e-300
"""Keeps the division by a force of zero defined; its quotient is not used."""


@comparable
class ContactForces(NamedTuple):
    """Forces of n supports of unit weight along the normals and tangents of m contacts."""

    normal: Array  # (m, n)
    along: Array  # (m, n)
    free: Array  # (m, n) 1 if a support may push any way with a force of at most its weight, else 0


def contact_forces(observation: Observation, forces: SupportForces) -> ContactForces:
    """The forces of one data point's supports, m = 1."""
    x, y = observation.contact_normal
    normal, along = np.array((x, y)), np.array((-y, x))
    return ContactForces((forces.directions @ normal)[None], (forces.directions @ along)[None], forces.free[None])


def lower_bounds(forces: ContactForces, weights: Array) -> Array:
    """tan(eta) = |f . t| / (f . n) of each data point (m,), infinite if f . n <= 0 (eq. 12).

    Supports whose force is unknown turn f towards the normal as far as they can, so that the result is still a lower bound.

    Args:
        forces: at m contacts.
        weights: (n,) estimate of w.
    """
    normal, along, free = forces.normal @ weights, np.abs(forces.along @ weights), forces.free @ weights
    with np.errstate(divide="ignore", invalid="ignore"):
        bounds = np.where(normal > 0, along / normal, math.inf)
    if free.any():
        known = np.hypot(along, normal)
        turn = np.where(free < known, np.arcsin(np.minimum(free, known) / np.maximum(known, TINY)), math.pi)
        eta = np.maximum(np.arctan2(along, normal) - turn, 0.0)
        bounds = np.where(free > 0, np.where(eta < math.pi / 2, np.tan(eta), math.inf), bounds)
    return np.asarray(bounds)


def percentile(bounds: Array, share: float) -> float:
    """The value at or below which `share` of the lower bounds (m,) lie: order statistic ceil(share * m).

    Raises:
        ValueError: no bounds, or a share outside (0, 1].
    """
    if not len(bounds):
        raise ValueError("a percentile needs at least one lower bound")
    if not 0 < share <= 1:
        raise ValueError(f"share must lie in (0, 1], got {share}")
    # the subtraction forgives 0.9 * 10 being a little above 9
    rank = math.ceil(share * len(bounds) - 1e-9)
    return float(np.partition(bounds, rank - 1)[rank - 1])


class Kind(StrEnum):
    """What mu_c rests on."""

    BOUND = "bound"  # lower bounds alone
    SLIP = "slip"  # pushes that were seen to slide
    FORCE = "force"  # forces measured while the tip slid


class Slip(StrEnum):
    """How the tip moves along the edge."""

    UNKNOWN = "unknown"
    STICKING = "sticking"
    LEFT = "sliding left"  # along t
    RIGHT = "sliding right"


@comparable
class Tip(NamedTuple):
    """What was seen and measured of the tip at m contacts; NaN if nothing was."""

    slip: Array  # (m,) its velocity along t relative to the object, over its speed
    mismatch: Array  # (m,) the same along n, where it cannot move: an error
    sensed: Array  # (m,) |F . t| / |F . n| of the measured force
    push: Array  # (m,) push_id

    @property
    def tolerance(self) -> float:
        """The slip beyond which a tip counts as sliding."""
        seen = np.abs(self.mismatch[np.isfinite(self.mismatch)])
        return max(SLIP_TOLERANCE, MISMATCHES * float(np.median(seen))) if len(seen) else SLIP_TOLERANCE

    @property
    def directions(self) -> Array:
        """(m,) of sliding along t: +1 and -1; 0: sticking; NaN: unknown."""
        with np.errstate(invalid="ignore"):
            sliding = np.abs(self.slip) > self.tolerance
        return np.where(np.isnan(self.slip), np.nan, np.where(sliding, np.sign(self.slip), 0.0))

    @property
    def slips(self) -> list[Slip]:
        """How the tip moves in each of the m data points."""
        states = {0.0: Slip.STICKING, 1.0: Slip.LEFT, -1.0: Slip.RIGHT}
        return [states.get(direction, Slip.UNKNOWN) for direction in self.directions.tolist()]


class MuC(NamedTuple):
    """The contact friction coefficient."""

    value: float | None  # None if there is only a bound
    low: float  # mu_c lies in [low, high] with a probability of 90 %
    high: float  # infinite if there is only a bound
    kind: Kind


def tip_at(observation: Observation) -> tuple[float, float, float, float]:
    """One data point's row of `Tip`."""
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
        sensed = abs(float(np.asarray(observation.force) @ along)) / pressed
    return slip, mismatch, sensed, float(observation.push_id)


def coefficient(forces: ContactForces, tip: Tip, weights: Array) -> MuC | None:
    """mu_c, from the sharpest evidence there is.

    A sliding contact is at the edge of its friction cone: |f . t| = mu_c f . n, with the sign of the slip. The mu_c that is
    returned minimises the sum of these errors: it is a median weighted with f . n, for which no support is freed. If forces
    were measured while the tip slid, it is the median of their ratios. The interval is that of a median from this many
    pushes, and holds the values under all w.

    Args:
        forces: at m contacts.
        tip: at the same contacts.
        weights: (k, n) the w to consider, the likeliest first.
    Returns:
        None if the pusher presses in no data point.
    """
    directions = tip.directions
    with np.errstate(invalid="ignore"):
        slid = np.abs(directions) > 0
    measured = slid & np.isfinite(tip.sensed)
    if len(np.unique(tip.push[measured])) >= FEWEST_SLIPS:
        value, low, high = _median(tip.sensed[measured], np.ones(int(measured.sum())), tip.push[measured])
        return MuC(value, low, high, Kind.FORCE)
    if len(np.unique(tip.push[slid])) >= FEWEST_SLIPS:
        known = np.maximum(1 - forces.free[slid], TINY)
        across = (forces.normal[slid] / known) @ weights.T
        along = -directions[slid][:, None] * ((forces.along[slid] / known) @ weights.T)
        found = []
        for normal, tangential in zip(across.T, along.T, strict=True):
            pressed = normal > LEAST_NORMAL
            if len(np.unique(tip.push[slid][pressed])) >= FEWEST_SLIPS:
                found.append(_median(tangential[pressed] / normal[pressed], normal[pressed], tip.push[slid][pressed]))
        if found:
            values = [max(value, 0.0) for value, _, _ in found]
            low, high = min(*values, found[0][1]), max(*values, found[0][2])
            return MuC(values[0], max(low, 0.0), max(high, 0.0), Kind.SLIP)
    low = min(percentile(lower_bounds(forces, w), 0.9) for w in weights)
    return MuC(None, low, math.inf, Kind.BOUND)


def _median(values: Array, weights: Array, pushes: Array) -> tuple[float, float, float]:
    """A weighted median, and the interval that holds the population's median with a probability of 90 %."""
    order = np.argsort(values)
    shares = np.cumsum(weights[order])
    reach = CONFIDENT / 2 / math.sqrt(len(np.unique(pushes)))
    wanted = np.array((0.5, max(0.5 - reach, 0.0), min(0.5 + reach, 1.0))) * shares[-1]
    places = np.minimum(np.searchsorted(shares, wanted), len(values) - 1)
    value, low, high = values[order][places].tolist()
    return value, low, high
