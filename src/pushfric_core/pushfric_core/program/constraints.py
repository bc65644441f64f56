"""Observation -> rows of the fit error, as every solver takes them: section 3, and measured forces, all in one shape.

Every constraint bounds a linear functional of the support friction, sum_j c_j . f_j. If the direction of f_j is known, its
term is a number times w_j. Near the centre of rotation the direction is not known, and the support may apply any additional
force of at most free_j w_j. This moves the functional by at most |c_j| free_j w_j to either side. Each side of the constraint
then becomes a row of its own, still linear.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.contact import contact_interval, tangent
from pushfric_core.geometry.planar import Array, as_array, left_of
from pushfric_core.geometry.support import SupportForces
from pushfric_core.records import comparable
from pushfric_core.trajectories.observation import Observation


@comparable
class ConstraintRows(NamedTuple):
    """Rows a of the fit error phi(a . w) = above * max(a . w, 0) + below * max(-a . w, 0); an infinite cost is a hard side.

    Rows have a column for each support point. Those of a measured force have one more, for the scale s: one over the total
    support friction of the translating object [1/N], which turns newtons into the unit of w.

    Example:
        >>> import numpy as np
        >>> from pushfric_core import ConstraintRows
        >>> rows = ConstraintRows(a=np.array([[0.01, -0.02]]), above=np.array([1.0]), below=np.array([1.0]))
        >>> (rows.a @ (0.5, 0.5)).tolist()
        [-0.005]
    """

    a: Array  # (m, n), or (m, n + 1) with the column of the scale
    above: Array  # (m,) cost per unit of a . w > 0
    below: Array  # (m,) cost per unit of a . w < 0


def stack(parts: Sequence[ConstraintRows], n: int) -> ConstraintRows:
    """The rows of several constraints as one record with n columns; rows without the column of the scale get zeros there."""
    if parts and all(part.a.shape[1] == n for part in parts):
        return ConstraintRows(*map(np.concatenate, zip(*parts, strict=True)))
    m = sum(len(part.above) for part in parts)
    a, costs = np.zeros((m, n)), np.empty((2, m))
    first = 0
    for part in parts:
        last = first + len(part.above)
        a[first:last, : part.a.shape[1]] = part.a
        costs[0, first:last], costs[1, first:last] = part.above, part.below
        first = last
    return ConstraintRows(a, costs[0], costs[1])


class Constraint(ABC):
    """A constraint of an observation on w, as rows of the fit error.

    `EstimatorConfig.terms` takes objects of any subclass next to the names of the built-in ones. A subclass defines `rows`,
    for which `functional_rows` does most of the work.

    Example:
        >>> from pushfric_core import Constraint, EstimatorConfig, functional_rows
        >>> class NoForceAlongX(Constraint):
        ...     def rows(self, observation, forces):
        ...         return functional_rows((1.0, 0.0), forces, above=0.035, below=0.035)
        ...
        >>> config = EstimatorConfig(terms=("moment", NoForceAlongX()))
        >>> len(config.constraints)
        3
    """

    with_scale: ClassVar[bool] = False
    """Whether the rows have one more column than there are supports, that of the scale (see ConstraintRows)."""

    needs_force: ClassVar[bool] = False
    """Whether observations without a measured force add no rows."""

    @abstractmethod
    def rows(self, observation: Observation, forces: SupportForces) -> ConstraintRows:
        """The rows of an observation, possibly none.

        Args:
            observation: the observation, object frame.
            forces: the friction forces of the supports, as far as the motion determines them.
        Returns:
            Rows with n columns, or n + 1 with a scale. Their costs are in metres of moment.
        """


@dataclass(frozen=True)
class Moment(Constraint):
    """The friction force passes through the contact (eq. 4), or through its interval (eqs 5 and 6) if it has a width.

    The rows are moments about the contact [m, unit force].

    Args:
        half_width: half the contact interval of observations without their own [m].
    """

    half_width: float = 0.0

    def rows(self, observation: Observation, forces: SupportForces) -> ConstraintRows:
        half_width = observation.half_width or self.half_width
        if half_width == 0:
            return functional_rows(left_of(forces.points - observation.contact_point), forces, 1.0, 1.0)
        low, high = contact_interval(observation.contact_point, observation.contact_normal, half_width)
        # -m(c-) >= 0 and m(c+) >= 0
        sides = [
            functional_rows(left_of(forces.points - low), forces, 1.0, 0.0),
            functional_rows(left_of(forces.points - high), forces, 0.0, 1.0),
        ]
        return stack(sides, len(forces.points))


@dataclass(frozen=True)
class NormalForce(Constraint):
    """The pusher cannot pull: f . n >= 0 (eq. 7).

    Args:
        weight: cost of a unit of force that pulls [m]; hard if infinite. If the weight exceeds the multiplier of the hard
            constraint, the optimum is the same.
    """

    weight: float = math.inf

    def rows(self, observation: Observation, forces: SupportForces) -> ConstraintRows:
        return functional_rows(np.asarray(observation.contact_normal), forces, 0.0, self.weight)


@dataclass(frozen=True)
class Frictionless(Constraint):
    """A contact without friction: f . t = 0 (eq. 8).

    Args:
        weight: cost of a unit of force along the edge [m].
    """

    weight: float = 1.0

    def rows(self, observation: Observation, forces: SupportForces) -> ConstraintRows:
        return functional_rows(tangent(observation.contact_normal), forces, self.weight, self.weight)


@dataclass(frozen=True)
class Cone(Constraint):
    """The force lies in the friction cone of a known bound on mu_c: mu f . n -+ f . t >= 0 (eqs 9 and 10).

    Args:
        mu_bound: upper bound on mu_c.
        weight: cost of a unit of violation [m].
    """

    mu_bound: float
    weight: float = 1.0

    def rows(self, observation: Observation, forces: SupportForces) -> ConstraintRows:
        return _within_cone(np.asarray(observation.contact_normal), self.mu_bound, forces, self.weight)


@dataclass(frozen=True)
class SensedForce(Constraint):
    """The friction force is opposite to the measured one, up to the scale s: f + s F = 0 in x and in y (section 3.2).

    Args:
        weight: cost of a unit of difference [m].
    """

    with_scale: ClassVar[bool] = True
    needs_force: ClassVar[bool] = True

    weight: float = 1.0

    def rows(self, observation: Observation, forces: SupportForces) -> ConstraintRows:
        parts = []
        for axis, measured in zip(np.eye(2), observation.force or (), strict=False):
            a, above, below = functional_rows(axis, forces, self.weight, self.weight)
            parts.append(ConstraintRows(np.column_stack((a, np.full(len(a), measured))), above, below))
        return stack(parts, len(forces.points) + 1)


@dataclass(frozen=True)
class SensedDirection(Constraint):
    """The friction force lies within a cone about the opposite of the measured force, whose magnitude is not used.

    A measured force of zero has no direction and adds no rows.

    Args:
        half_angle: of the cone [rad], in [0, pi/2).
        weight: cost of a unit of violation [m].
    Raises:
        ValueError: half_angle is not in [0, pi/2).
    """

    needs_force: ClassVar[bool] = True

    half_angle: float
    weight: float = 1.0

    def __post_init__(self) -> None:
        if not 0 <= self.half_angle < math.pi / 2:
            raise ValueError(f"half_angle must lie in [0, pi/2), got {self.half_angle:g}")

    def rows(self, observation: Observation, forces: SupportForces) -> ConstraintRows:
        if observation.force is None or not any(observation.force):
            return stack([], len(forces.points))
        force = np.asarray(observation.force)
        return _within_cone(-force / math.hypot(*force), math.tan(self.half_angle), forces, self.weight)


def center_of_friction_rows(center: npt.ArrayLike, support_points: npt.ArrayLike) -> ConstraintRows:
    """p_CF is known, hard: sum_j w_j (p_j - p_CF) = 0 in x and in y (eq. 13).

    Args:
        center: p_CF (2,) [m], object frame.
        support_points: (n, 2) [m], object frame.
    Returns:
        Two rows of n columns.
    """
    hard = np.full(2, np.inf)
    return ConstraintRows((as_array(support_points) - as_array(center)).T, hard, hard)


def functional_rows(functional: npt.ArrayLike, forces: SupportForces, above: float, below: float) -> ConstraintRows:
    """The cost of a linear functional of the support friction, r = sum_j c_j . f_j.

    Args:
        functional: c, (2,) for all supports or (n, 2) for each.
        forces: those of the n supports, f_j = w_j (directions_j + any force of at most free_j).
        above: cost of a unit of r > 0 [m]; infinite: r <= 0 is a hard constraint.
        below: the same for r < 0.
    Returns:
        One row; if supports are free, one row for each side with a cost, lowered as far as the free forces can lower it.

    Example:
        >>> from pushfric_core import SupportForces, functional_rows
        >>> forces = SupportForces(points=[(-0.05, 0.0), (0.05, 0.0)], directions=[(0.0, -1.0), (0.6, -0.8)], free=[0.0, 0.0])
        >>> functional_rows((0.0, 1.0), forces, above=1.0, below=1.0).a.tolist()
        [[-1.0, -0.8]]
    """
    functional, directions, free = as_array(functional), as_array(forces.directions), as_array(forces.free)
    products = functional * directions
    a = products[:, 0] + products[:, 1]
    if above == below == 0 or not np.count_nonzero(free):
        return ConstraintRows(a[None], np.array((above,)), np.array((below,)))
    reach = np.hypot(functional[..., 0], functional[..., 1]) * free
    # by how much the free supports can lower a cost above, and one below
    if below == 0:
        return ConstraintRows((a - reach)[None], np.array((above,)), np.zeros(1))
    if above == 0:
        return ConstraintRows((a + reach)[None], np.zeros(1), np.array((below,)))
    return ConstraintRows(np.array((a - reach, a + reach)), np.array((above, 0.0)), np.array((0.0, below)))


def _within_cone(axis: Array, slope: float, forces: SupportForces, weight: float) -> ConstraintRows:
    """slope * f . axis -+ f . (axis turned left) >= 0, each at its cost."""
    sides = [functional_rows(slope * axis + side * left_of(axis), forces, 0.0, weight) for side in (-1, 1)]
    return stack(sides, len(forces.points))
