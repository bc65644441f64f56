"""The contact friction coefficient mu_c: a lower bound from every data point, and their percentiles (section 5.1.3)."""

import math
from typing import NamedTuple

import numpy as np

from pushfric_core.contact import tangent
from pushfric_core.observation import Observation
from pushfric_core.planar import Array
from pushfric_core.records import comparable
from pushfric_core.support import SupportForces

TINY = 1e-300
"""Keeps the division by a force of zero defined; its quotient is not used."""


@comparable
class ContactForces(NamedTuple):
    """Forces of supports of unit weight along the normals and tangents of m contacts."""

    normal: Array  # (m, n)
    along: Array  # (m, n)
    free: Array  # (m, n) 1 where a support may push any way with a force of at most its weight, else 0


def contact_forces(observation: Observation, forces: SupportForces) -> ContactForces:
    """The forces of one data point's supports, m = 1."""
    normal = np.asarray(observation.contact_normal)
    return ContactForces((forces.directions @ normal)[None], (forces.directions @ tangent(normal))[None], forces.free[None])


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
