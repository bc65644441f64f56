"""Observation -> rows of the fit error: the constraints of section 3, all in one shape."""

from typing import NamedTuple

import numpy as np

from pushfric_core.contact import interval, tangent
from pushfric_core.observation import Observation
from pushfric_core.planar import Array, cross
from pushfric_core.support import friction_directions


class ConstraintRows(NamedTuple):
    """Rows a of the fit error phi(a . w) = above * max(a . w, 0) + below * max(-a . w, 0); an infinite cost is a hard side."""

    a: Array  # (m, n)
    above: Array  # (m,) cost per unit of a . w > 0
    below: Array  # (m,) cost per unit of a . w < 0


def moment_rows(observation: Observation, support_points: Array) -> ConstraintRows:
    """The friction force passes through the contact (eq. 4), or through its interval (eqs 5 and 6) where it has a width.

    Args:
        observation: contact [m] and twist, object frame.
        support_points: (n, 2) [m].
    Returns:
        One row, the moment about the contact [m, unit force]; two rows, of one side each, for an interval.
    Raises:
        UninformativePush: a support point does not move.
    """
    directions = friction_directions(support_points, observation.twist)
    if observation.half_width == 0:
        moment = cross(support_points - observation.contact_point, directions)
        return ConstraintRows(moment[None], np.ones(1), np.ones(1))
    low, high = interval(observation.contact_point, observation.contact_normal, observation.half_width)
    a = np.stack((cross(support_points - low, directions), cross(support_points - high, directions)))
    # -m(c-) >= 0 and m(c+) >= 0
    return ConstraintRows(a, np.array((1.0, 0.0)), np.array((0.0, 1.0)))


def normal_force_rows(observation: Observation, support_points: Array) -> ConstraintRows:
    """The pusher cannot pull: f . n >= 0 (eq. 7), hard.

    Raises:
        UninformativePush: a support point does not move.
    """
    a = friction_directions(support_points, observation.twist) @ observation.contact_normal
    return ConstraintRows(a[None], np.zeros(1), np.full(1, np.inf))


def frictionless_rows(observation: Observation, support_points: Array, weight: float = 1.0) -> ConstraintRows:
    """A contact without friction: f . t = 0 (eq. 8), each unit of force costing `weight` [m].

    Raises:
        UninformativePush: a support point does not move.
    """
    a = friction_directions(support_points, observation.twist) @ tangent(observation.contact_normal)
    return ConstraintRows(a[None], np.full(1, weight), np.full(1, weight))


def cone_rows(observation: Observation, support_points: Array, mu_bound: float, weight: float = 1.0) -> ConstraintRows:
    """The force lies in the friction cone of a known bound on mu_c: mu f . n -+ f . t >= 0 (eqs 9 and 10).

    Each unit of violation costs `weight` [m].

    Raises:
        UninformativePush: a support point does not move.
    """
    directions = friction_directions(support_points, observation.twist)
    normal_force = mu_bound * (directions @ observation.contact_normal)
    tangential = directions @ tangent(observation.contact_normal)
    a = np.stack((normal_force - tangential, normal_force + tangential))
    return ConstraintRows(a, np.zeros(2), np.full(2, weight))


def stack(parts: list[ConstraintRows], n: int) -> ConstraintRows:
    """The rows of several constraints over n support points as one."""
    if not parts:
        return ConstraintRows(np.zeros((0, n)), np.zeros(0), np.zeros(0))
    a, above, below = zip(*parts, strict=True)
    return ConstraintRows(np.concatenate(a), np.concatenate(above), np.concatenate(below))
