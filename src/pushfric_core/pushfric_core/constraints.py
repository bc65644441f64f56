"""Observation -> rows of the fit error: the constraints of section 3 and those of sensed forces, all in one shape.

Every constraint bounds a linear functional of the support friction, sum_j c_j . f_j. Where the direction of f_j is known, that
is a number times w_j. A support so near the centre of rotation that it is not known may apply any force of at most free_j w_j
besides, which moves the functional by at most |c_j| free_j w_j to either side: each side of the constraint becomes a row of its
own, still linear.

Rows have a column for each support point. Those of a sensed force have one more, for the scale s: one over the total support
friction of the translating object [1/N], which turns Newtons into the unit of w. Where any row has it, the program has it.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.contact import interval, tangent
from pushfric_core.observation import Observation, Vector
from pushfric_core.planar import Array, left_of
from pushfric_core.support import NOT_FREE, FreeRadii, SupportForces, support_forces


class ConstraintRows(NamedTuple):
    """Rows a of the fit error phi(a . w) = above * max(a . w, 0) + below * max(-a . w, 0); an infinite cost is a hard side."""

    a: Array  # (m, n), or (m, n + 1) with the column of the scale
    above: Array  # (m,) cost per unit of a . w > 0
    below: Array  # (m,) cost per unit of a . w < 0


def moment_rows(observation: Observation, support_points: Array, free: FreeRadii = NOT_FREE) -> ConstraintRows:
    """The friction force passes through the contact (eq. 4), or through its interval (eqs 5 and 6) where it has a width.

    Args:
        observation: contact [m] and twist, object frame.
        support_points: (n, 2) [m].
        free: where supports may push any way.
    Returns:
        Rows of the moment about the contact [m, unit force].
    Raises:
        UninformativePush: see support_forces.
    """
    forces = support_forces(support_points, observation.twist, free)
    if observation.half_width == 0:
        return _rows(left_of(support_points - observation.contact_point), forces, 1.0, 1.0)
    low, high = interval(observation.contact_point, observation.contact_normal, observation.half_width)
    # -m(c-) >= 0 and m(c+) >= 0
    sides = [_rows(left_of(support_points - low), forces, 1.0, 0.0), _rows(left_of(support_points - high), forces, 0.0, 1.0)]
    return stack(sides, len(support_points))


def normal_force_rows(
    observation: Observation, support_points: Array, weight: float = math.inf, free: FreeRadii = NOT_FREE
) -> ConstraintRows:
    """The pusher cannot pull: f . n >= 0 (eq. 7), hard unless a unit of violation costs a finite `weight` [m].

    With a weight above the multiplier of the hard constraint the optimum is the same. The rest as for `moment_rows`.
    """
    forces = support_forces(support_points, observation.twist, free)
    return _rows(np.asarray(observation.contact_normal), forces, 0.0, weight)


def frictionless_rows(
    observation: Observation, support_points: Array, weight: float = 1.0, free: FreeRadii = NOT_FREE
) -> ConstraintRows:
    """A contact without friction: f . t = 0 (eq. 8), each unit of force costing `weight` [m]. The rest as for `moment_rows`."""
    forces = support_forces(support_points, observation.twist, free)
    return _rows(tangent(observation.contact_normal), forces, weight, weight)


def cone_rows(
    observation: Observation, support_points: Array, mu_bound: float, weight: float = 1.0, free: FreeRadii = NOT_FREE
) -> ConstraintRows:
    """The force lies in the friction cone of a known bound on mu_c: mu f . n -+ f . t >= 0 (eqs 9 and 10).

    Each unit of violation costs `weight` [m]. The rest as for `moment_rows`.
    """
    forces = support_forces(support_points, observation.twist, free)
    return _within_cone(np.asarray(observation.contact_normal), mu_bound, forces, weight)


def sensed_force_rows(
    observation: Observation, support_points: Array, weight: float = 1.0, free: FreeRadii = NOT_FREE
) -> ConstraintRows:
    """The friction force is opposite to the measured one, and to scale: f + s F = 0, component by component (section 3.2).

    Each unit of difference costs `weight` [m]. The rows have the column of the scale. The rest as for `moment_rows`.

    Raises:
        ValueError: no force was measured.
        UninformativePush: see support_forces.
    """
    forces = support_forces(support_points, observation.twist, free)
    parts = []
    for axis, measured in zip(np.eye(2), _sensed(observation), strict=True):
        a, above, below = _rows(axis, forces, weight, weight)
        parts.append(ConstraintRows(np.column_stack((a, np.full(len(a), measured))), above, below))
    return stack(parts, len(support_points) + 1)


def sensed_direction_rows(
    observation: Observation, support_points: Array, half_angle: float, weight: float = 1.0, free: FreeRadii = NOT_FREE
) -> ConstraintRows:
    """The friction force lies within `half_angle` [rad] of the opposite of the measured one, whose magnitude is not used.

    Each unit of violation costs `weight` [m]. The rest as for `moment_rows`.

    Raises:
        ValueError: no force was measured, or one of no length, or half_angle is not in [0, pi/2).
        UninformativePush: see support_forces.
    """
    if not 0 <= half_angle < math.pi / 2:
        raise ValueError(f"half_angle must lie in [0, pi/2), got {half_angle:g}")
    force = np.asarray(_sensed(observation))
    length = math.hypot(*force)
    if length == 0:
        raise ValueError("the direction of a measured force needs a length, got (0, 0) N")
    forces = support_forces(support_points, observation.twist, free)
    return _within_cone(-force / length, math.tan(half_angle), forces, weight)


def center_of_friction_rows(center: npt.ArrayLike, support_points: Array) -> ConstraintRows:
    """p_CF is known, hard: sum_j w_j (p_j - p_CF) = 0 in x and in y (eq. 13).

    Args:
        center: p_CF (2,) [m], object frame.
        support_points: (n, 2) [m].
    """
    hard = np.full(2, np.inf)
    return ConstraintRows((support_points - np.asarray(center, dtype=float)).T, hard, hard)


def stack(parts: Sequence[ConstraintRows], n: int) -> ConstraintRows:
    """The rows of several constraints as one, of n columns: those that lack the last, the scale, get zeros there."""
    a = [np.pad(part.a, ((0, 0), (0, n - part.a.shape[1]))) if part.a.shape[1] < n else part.a for part in parts]
    return ConstraintRows(
        np.concatenate([np.zeros((0, n)), *a]),
        np.concatenate([np.zeros(0), *(part.above for part in parts)]),
        np.concatenate([np.zeros(0), *(part.below for part in parts)]),
    )


def _sensed(observation: Observation) -> Vector:
    if observation.force is None:
        raise ValueError(f"a measured force is needed, the data point of push {observation.push_id} has none")
    return observation.force


def _within_cone(axis: Array, slope: float, forces: SupportForces, weight: float) -> ConstraintRows:
    """slope * f . axis -+ f . (axis turned left) >= 0, each at its cost."""
    sides = [_rows(slope * axis + side * left_of(axis), forces, 0.0, weight) for side in (-1, 1)]
    return stack(sides, len(forces.free))


def _rows(functional: Array, forces: SupportForces, above: float, below: float) -> ConstraintRows:
    """The cost of sum_j c_j . f_j, with c = functional, (2,) or (n, 2), after the free supports did their best to lower it."""
    a = np.sum(functional * forces.directions, axis=1)
    if not forces.free.any() or above == below == 0:
        return ConstraintRows(a[None], np.full(1, above), np.full(1, below))
    reach = np.hypot(functional[..., 0], functional[..., 1]) * forces.free
    # what the free supports can take away from a cost above, and from one below
    sides = [(a - reach, above, 0.0)] * (above > 0) + [(a + reach, 0.0, below)] * (below > 0)
    rows, costs_above, costs_below = zip(*sides, strict=True)
    return ConstraintRows(np.array(rows), np.array(costs_above), np.array(costs_below))
