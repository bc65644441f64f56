"""The contact friction coefficient mu_c: a lower bound from every observation, and their percentiles (section 5.1.3)."""

import math
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.errors import warn_unless_compiled
from pushfric_core.geometry.contact import tangent
from pushfric_core.geometry.planar import LEAST_DIVISOR, Array, velocity_at
from pushfric_core.geometry.support import SupportForces
from pushfric_core.program import sliding
from pushfric_core.records import comparable
from pushfric_core.trajectories.observation import Observation

warn_unless_compiled(sliding, "slips are")

ROUNDING = 1e-12
"""A part of a force that is smaller than this share of the other is 0: its sign, and what is divided by it, is chance."""

BLOCK = 4096
"""Contacts whose bounds are computed together."""


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


def lower_bounds(forces: ContactForces, w: Array) -> Array:
    """tan(eta) = |f . t| / (f . n) of each observation (m,), infinite if f . n <= 0, up to rounding (eq. 12).

    Supports whose force is unknown turn f towards the normal as far as they can, so that the result is still a lower bound.

    Args:
        forces: at m contacts.
        w: (n,) support friction distribution.
    """
    normal, along, free = (_products(part, w) for part in forces)
    along = np.abs(along)
    with np.errstate(divide="ignore", invalid="ignore"):
        bounds = np.where(normal > ROUNDING * along, along / normal, math.inf)
    if free.any():
        known = np.hypot(along, normal)
        turn = np.where(free < known, np.arcsin(np.minimum(free, known) / np.maximum(known, LEAST_DIVISOR)), math.pi)
        eta = np.maximum(np.arctan2(along, normal) - turn, 0.0)
        bounds = np.where(free > 0, np.where(eta < math.pi / 2, np.tan(eta), math.inf), bounds)
    return np.asarray(bounds)


def _products(part: Array, w: Array) -> Array:
    """(m,) of rows (m, n) with w (n,), some rows at a time, which stay in the cache."""
    found = np.empty(len(part))
    for first in range(0, len(part), BLOCK):
        rows = slice(first, first + BLOCK)
        np.dot(part[rows], w, out=found[rows])
    return found


def percentile(bounds: Array, share: float) -> float:
    """The value at or below which `share` of the lower bounds (m,) lie: order statistic ceil(share * m).

    Raises:
        ValueError: no bounds, or a share outside (0, 1].
    """
    if not bounds.size:
        raise ValueError("a percentile needs at least one lower bound")
    if not 0 < share <= 1:
        raise ValueError(f"share must lie in (0, 1], got {share}")
    # the subtraction forgives 0.9 * 10 being a little above 9
    rank = math.ceil(share * len(bounds) - 1e-9)
    return float(np.partition(bounds, rank - 1)[rank - 1])


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
        usual = float(np.median(seen)) if len(seen) else 0.0
        return max(sliding.SLIP_TOLERANCE, sliding.MISMATCHES * usual)

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
        if len(seen):
            ends = np.append(np.flatnonzero(np.diff(self.push[seen])) + 1, len(seen))
            directions[seen] = sliding.directions_of(self.slip[seen], self.mismatch[seen], ends, self.tolerance)
        return directions

    def bounds(self, forces: ContactForces, w: Array) -> Array:
        """The lower bounds on mu_c (m,): the ratio of the measured force, or without one `lower_bounds`."""
        return np.where(np.isfinite(self.sensed), np.abs(self.sensed), lower_bounds(forces, w))

    @property
    def slips(self) -> npt.NDArray[np.intp]:
        """How the tip moves in each of the m observations, as an index of `Slip`."""
        return np.nan_to_num(self.directions % 3 + 1).astype(int)  # NaN, 0, 1 and -1 in the order of Slip


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
