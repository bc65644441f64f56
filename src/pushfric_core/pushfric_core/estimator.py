"""The estimator: add(observation) -> estimate of w, p_CF and mu_c, as in section 3.3."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy.typing as npt

from pushfric_core import contact_friction
from pushfric_core.constraints import (
    ConstraintRows,
    cone_rows,
    frictionless_rows,
    moment_rows,
    normal_force_rows,
    stack,
)
from pushfric_core.linear_program import Status
from pushfric_core.observation import Observation
from pushfric_core.planar import Array
from pushfric_core.settings import check_ranges, setting
from pushfric_core.simplex import Optimum, Simplex
from pushfric_core.support import center_of_friction, check_points

TERMS = ("moment", "frictionless", "cone")


@dataclass(frozen=True)
class EstimatorConfig:
    """Which constraints make up the program; the defaults are the paper's (section 5)."""

    terms: tuple[str, ...] = setting(("moment",), f"what the fit error is made of, any of: {', '.join(TERMS)}")
    half_width: float = setting(0.0, "half the contact interval of data points that bring none [m] (eqs 5 and 6)", 0.0, 1.0)
    cor_radius: float = setting(
        0.0, "supports this near the centre of rotation may push any way [m]; 0: none, as in the paper", 0.0, 1.0
    )
    nonnegative_force: bool = setting(True, "the pusher cannot pull: f.n >= 0, hard (eq. 7)")
    mu_bound: float = setting(1.0, "known upper bound on mu_c, for the term cone (eqs 9 and 10)", 0.0, 100.0)
    force_weight: float = setting(0.05, "cost of a unit of force beside a metre of moment [m]", 0.0, 100.0)

    def __post_init__(self) -> None:
        check_ranges(self)
        unknown = [term for term in self.terms if term not in TERMS]
        if unknown or not self.terms:
            raise ValueError(f"terms must name at least one of {', '.join(TERMS)}, got {', '.join(unknown) or 'none'}")


@dataclass(frozen=True)
class Estimate:
    """What is known after the last data point; None of it changes later.

    Attributes:
        support_points: (n, 2) [m], object frame.
        observations: the data points it rests on, in order of arrival.
        solution: w with its objective [m, unit force] and certificate.
        conflicts: data points whose hard constraints contradict each other; none unless the status is INFEASIBLE.
    """

    support_points: Array
    observations: tuple[Observation, ...]
    solution: Optimum
    conflicts: tuple[Observation, ...] = ()

    @property
    def w(self) -> Array:
        """Support friction distribution (n,), >= 0, sum 1."""
        return self.solution.w

    @property
    def status(self) -> Status:
        return self.solution.status

    @property
    def pushes(self) -> int:
        """Pushes the data points came from."""
        return len({observation.push_id for observation in self.observations})

    @property
    def contradiction(self) -> str | None:
        """Which pushes contradict each other, for people; None where none do."""
        if self.status is not Status.INFEASIBLE:
            return None
        pushes = sorted({observation.push_id for observation in self.conflicts})
        return f"no w lets the pusher push (f.n >= 0) in all of the pushes {', '.join(map(str, pushes))}"

    @cached_property
    def center_of_friction(self) -> Array:
        """p_CF (2,) [m], object frame (eq. 3)."""
        return center_of_friction(self.support_points, self.w)

    @cached_property
    def contact_friction(self) -> Array:
        """Lower bounds (m,) on mu_c, one per data point (eq. 12)."""
        return contact_friction.lower_bounds(self.observations, self.support_points, self.w)

    @property
    def mu_c_p90(self) -> float:
        """Value at or below which 90 % of the lower bounds lie."""
        return contact_friction.percentile(self.contact_friction, 0.9)

    @property
    def mu_c_max(self) -> float:
        """The largest of the lower bounds."""
        return contact_friction.percentile(self.contact_friction, 1.0)


class Estimator:
    """Fits w over hypothesised support points to the data points seen so far.

    Args:
        support_points: (n, 2) hypothesised supports in the object frame [m].
        config: the constraints; the paper's by default.
    Raises:
        ValueError: support_points is not (n, 2) with n >= 1, or not finite.
    """

    def __init__(self, support_points: npt.ArrayLike, config: EstimatorConfig | None = None) -> None:
        self.support_points = check_points(support_points)
        self.config = config or EstimatorConfig()
        self._program = Simplex(len(self.support_points))
        self._observations: list[Observation] = []

    def add(self, observation: Observation) -> Estimate:
        """Take a data point and estimate anew, from the last optimum on.

        Where data points contradict the nonnegative force, the status is INFEASIBLE, w violates it least, and `conflicts` names
        them.

        Raises:
            UninformativePush: the data point rotates exactly about a support point; the estimator is as before.
        """
        rows = self._rows_of(observation)
        self._program.add(rows)
        self._observations.append(observation)
        return self.estimate()

    def estimate(self) -> Estimate:
        """The estimate from the data points so far; without any, all of w is equally good."""
        solution = self._program.solve()
        conflicts = tuple(self._observations[group] for group in self._program.conflicts())
        return Estimate(self.support_points, tuple(self._observations), solution, conflicts)

    def _rows_of(self, observation: Observation) -> ConstraintRows:
        points, config = self.support_points, self.config
        if observation.half_width == 0:
            observation = replace(observation, half_width=config.half_width)
        parts = []
        if "moment" in config.terms:
            parts.append(moment_rows(observation, points, config.cor_radius))
        if "frictionless" in config.terms:
            parts.append(frictionless_rows(observation, points, config.force_weight, config.cor_radius))
        if "cone" in config.terms:
            parts.append(cone_rows(observation, points, config.mu_bound, config.force_weight, config.cor_radius))
        if config.nonnegative_force:
            parts.append(normal_force_rows(observation, points, config.cor_radius))
        return stack(parts, len(points))
