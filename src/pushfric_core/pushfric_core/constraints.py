"""Observation -> rows of the fit error: the constraints of section 3, all in one shape.

Every constraint bounds a linear functional of the support friction, sum_j c_j . f_j. Where the direction of f_j is known, that
is a number times w_j. A support so near the centre of rotation that it is not known may apply any force of at most w_j, which
moves the functional by at most |c_j| w_j to either side: each side of the constraint becomes a row of its own, still linear.
"""

from typing import NamedTuple

import numpy as np

from pushfric_core.contact import interval, tangent
from pushfric_core.observation import Observation
from pushfric_core.planar import Array, left_of
from pushfric_core.support import SupportForces, support_forces


class ConstraintRows(NamedTuple):
    """Rows a of the fit error phi(a . w) = above * max(a . w, 0) + below * max(-a . w, 0); an infinite cost is a hard side."""

    a: Array  # (m, n)
    above: Array  # (m,) cost per unit of a . w > 0
    below: Array  # (m,) cost per unit of a . w < 0


def moment_rows(observation: Observation, support_points: Array, free_radius: float = 0.0) -> ConstraintRows:
    """The friction force passes through the contact (eq. 4), or through its interval (eqs 5 and 6) where it has a width.

    Args:
        observation: contact [m] and twist, object frame.
        support_points: (n, 2) [m].
        free_radius: supports this near the centre of rotation [m] may push any way.
    Returns:
        Rows of the moment about the contact [m, unit force].
    Raises:
        UninformativePush: see support_forces.
    """
    forces = support_forces(support_points, observation.twist, free_radius)
    if observation.half_width == 0:
        return _rows(left_of(support_points - observation.contact_point), forces, 1.0, 1.0)
    low, high = interval(observation.contact_point, observation.contact_normal, observation.half_width)
    # -m(c-) >= 0 and m(c+) >= 0
    sides = [_rows(left_of(support_points - low), forces, 1.0, 0.0), _rows(left_of(support_points - high), forces, 0.0, 1.0)]
    return stack(sides, len(support_points))


def normal_force_rows(observation: Observation, support_points: Array, free_radius: float = 0.0) -> ConstraintRows:
    """The pusher cannot pull: f . n >= 0 (eq. 7), hard. Arguments and errors as for `moment_rows`."""
    forces = support_forces(support_points, observation.twist, free_radius)
    return _rows(np.asarray(observation.contact_normal), forces, 0.0, np.inf)


def frictionless_rows(
    observation: Observation, support_points: Array, weight: float = 1.0, free_radius: float = 0.0
) -> ConstraintRows:
    """A contact without friction: f . t = 0 (eq. 8), each unit of force costing `weight` [m]. The rest as for `moment_rows`."""
    forces = support_forces(support_points, observation.twist, free_radius)
    return _rows(tangent(observation.contact_normal), forces, weight, weight)


def cone_rows(
    observation: Observation, support_points: Array, mu_bound: float, weight: float = 1.0, free_radius: float = 0.0
) -> ConstraintRows:
    """The force lies in the friction cone of a known bound on mu_c: mu f . n -+ f . t >= 0 (eqs 9 and 10).

    Each unit of violation costs `weight` [m]. The rest as for `moment_rows`.
    """
    forces = support_forces(support_points, observation.twist, free_radius)
    normal, along = mu_bound * np.asarray(observation.contact_normal), tangent(observation.contact_normal)
    sides = [_rows(normal - along, forces, 0.0, weight), _rows(normal + along, forces, 0.0, weight)]
    return stack(sides, len(support_points))


def stack(parts: list[ConstraintRows], n: int) -> ConstraintRows:
    """The rows of several constraints over n support points as one."""
    if not parts:
        return ConstraintRows(np.zeros((0, n)), np.zeros(0), np.zeros(0))
    a, above, below = zip(*parts, strict=True)
    return ConstraintRows(np.concatenate(a), np.concatenate(above), np.concatenate(below))


def _rows(functional: Array, forces: SupportForces, above: float, below: float) -> ConstraintRows:
    """The cost of sum_j c_j . f_j, with c = functional, (2,) or (n, 2), after the free supports did their best to lower it."""
    a = np.sum(functional * forces.directions, axis=1)
    if not forces.free.any():
        return ConstraintRows(a[None], np.full(1, above), np.full(1, below))
    reach = np.hypot(functional[..., 0], functional[..., 1]) * forces.free
    # what the free supports can take away from a cost above, and from one below
    sides = [(a - reach, above, 0.0)] * (above > 0) + [(a + reach, 0.0, below)] * (below > 0)
    rows, costs_above, costs_below = zip(*sides, strict=True)
    return ConstraintRows(np.array(rows), np.array(costs_above), np.array(costs_below))
