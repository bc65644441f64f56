"""Support points and their weights: the friction forces of a sliding object and their centre."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.errors import UninformativePush
from pushfric_core.geometry.planar import Array, Twist, Wrench, cross, frozen, velocity_at
from pushfric_core.plausible import FARTHEST, LARGEST, check_within
from pushfric_core.records import comparable


@comparable
@dataclass(frozen=True)
class Support:
    """A support friction distribution: points p_j with weights w_j.

    Args:
        points: (n, 2) in the object frame [m].
        weights: (n,) >= 0, sum 1; unit: the support friction of the translating object.
    Raises:
        ValueError: shapes that do not fit, negative or not finite values, or a sum other than 1.

    Example:
        >>> from pushfric_core import Support
        >>> support = Support([(-0.05, 0.0), (0.05, 0.0)], [0.25, 0.75])
        >>> support.center_of_friction.round(6).tolist()
        [0.025, 0.0]
    """

    points: Array
    weights: Array

    def __post_init__(self) -> None:
        points, weights = check_points(self.points), frozen(self.weights)
        if weights.shape != (len(points),):
            raise ValueError(f"weights must have shape ({len(points)},), got {weights.shape}")
        if not (weights >= 0).all() or abs(weights.sum() - 1) > 1e-9:
            raise ValueError(f"weights must be nonnegative with sum 1, got a sum of {weights.sum():g}")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "weights", weights)

    @property
    def center_of_friction(self) -> Array:
        """p_CF (2,) [m], eq. 3."""
        return center_of_friction(self.points, self.weights)

    def friction_wrench(self, twist: Twist) -> Wrench:
        """Friction on the sliding object, about the object-frame origin (eqs 1 and 2).

        Raises:
            UninformativePush: the object does not move, or it rotates about a support that bears weight.
        """
        forces = friction_directions(self.points, twist) * self.weights[:, None]
        fx, fy = forces.sum(axis=0)
        return Wrench(float(fx), float(fy), float(cross(self.points, forces).sum()))


def check_points(support_points: npt.ArrayLike) -> Array:
    """Support points as a read-only (n, 2) array.

    Raises:
        ValueError: not (n, 2) with n >= 1, not finite, beyond FARTHEST, or farther apart than an object is long.
    """
    points = frozen(support_points)
    if points.ndim != 2 or points.shape[1] != 2 or not len(points):
        raise ValueError(f"support_points must have shape (n, 2) with n >= 1, got {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError("support_points must be finite")
    check_within("x and y of support_points", (points.min(), points.max()), FARTHEST, "m")
    check_within("the distances along x and y between support_points", (np.ptp(points, axis=0).max(),), LARGEST, "m")
    return points


def rms_arm(points: Array) -> float:
    """The rms distance of points (n, 2) from their middle [m]: the arm at which a turn counts; 0 if all are in one place."""
    return math.sqrt(float(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))


def friction_directions(support_points: Array, twist: Twist) -> Array:
    """Unit forces -v_j / |v_j| (n, 2) of the support friction on the moving object (eq. 1).

    Raises:
        UninformativePush: a support point does not move, so the direction of its friction is unknown (section 3).
    """
    velocities = velocity_at(twist, support_points)
    return _opposite(twist, velocities, _lengths(velocities), support_points)


class FreeRadii(NamedTuple):
    """Distances from the centre of rotation within which the friction of a support is unknown, wholly or in part [m]."""

    wholly: float  # within this it may push any way with a force of at most its weight
    partly: float  # beyond this its friction opposes its velocity


COR_SHARE = 0.55
"""How far the centre of rotation moves in a step, as a fraction of the support's size; see docs/estimation.md."""

NOT_FREE = FreeRadii(0.0, 0.0)
"""The radii of the paper, where a support exactly on the centre of rotation makes the observation useless."""


@comparable
class SupportForces(NamedTuple):
    """The friction forces of unit weights in a motion: f_j = directions_j + any force of at most free_j.

    Example:
        >>> from pushfric_core import SupportForces, functional_rows
        >>> forces = SupportForces(points=[(-0.05, 0.0), (0.05, 0.0)], directions=[(0.0, -1.0), (0.6, -0.8)], free=[0.0, 0.0])
        >>> functional_rows((1.0, 0.0), forces, above=1.0, below=1.0).a.tolist()
        [[0.0, 0.6]]
    """

    points: Array  # (n, 2) the supports, object frame [m]
    directions: Array  # (n, 2) -(1 - free_j) v_j / |v_j|
    free: Array  # (n,) in [0, 1]


def support_forces(support_points: Array, twist: Twist, radii: FreeRadii = NOT_FREE) -> SupportForces:
    """The friction forces of a motion, and how much of them is unknown near the centre of rotation.

    Args:
        support_points: (n, 2) [m].
        twist: of the object-frame origin.
        radii: where supports are free.
    Raises:
        UninformativePush: the object does not move, or it rotates exactly about a support and no support is free.
    """
    velocities = velocity_at(twist, support_points)
    speeds = _lengths(velocities)
    # |v_j| = |omega| * distance to the centre of rotation
    reach = abs(twist.omega) * radii.partly
    slowest = np.minimum.reduce(speeds)
    if radii.partly == 0 or not slowest <= reach:
        return SupportForces(
            support_points, _opposite(twist, velocities, speeds, support_points), np.zeros(len(support_points))
        )
    width = radii.partly - radii.wholly
    share = np.minimum((radii.partly - speeds / abs(twist.omega)) / width, 1.0) if width > 0 else 1.0
    free = np.where(speeds <= reach, share, 0.0)
    known = speeds if slowest > 0 else np.where(free < 1, speeds, 1.0)  # no division by zero if a support is wholly free
    return SupportForces(support_points, -((1 - free) / known)[:, None] * velocities, free)


def center_of_friction(support_points: Array, weights: Array) -> Array:
    """Centroid (2,) of the support friction distribution [m], eq. 3."""
    return np.asarray(weights @ support_points / weights.sum())


def _lengths(vectors: Array) -> Array:
    return np.hypot(vectors[:, 0], vectors[:, 1])


def _opposite(twist: Twist, velocities: Array, speeds: Array, support_points: Array) -> Array:
    """-v_j / |v_j| of moving supports."""
    if not np.minimum.reduce(speeds) > 0:
        if not any(twist):
            raise UninformativePush("the object did not move")
        still = support_points[int(np.argmin(speeds))]
        raise UninformativePush(f"the object rotated exactly about its support point ({still[0]:g}, {still[1]:g})")
    return np.asarray(-velocities / speeds[:, None])
