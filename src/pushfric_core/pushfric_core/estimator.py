"""The estimator: add(observation) -> estimate of w, p_CF and mu_c, as in section 3.3."""

import math
from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from pushfric_core import contact_friction
from pushfric_core.confidence import Halves
from pushfric_core.constraints import (
    ConstraintRows,
    center_of_friction_rows,
    cone_rows,
    frictionless_rows,
    moment_rows,
    normal_force_rows,
    sensed_direction_rows,
    sensed_force_rows,
    stack,
)
from pushfric_core.contact_friction import ContactForces, contact_forces
from pushfric_core.observation import Observation
from pushfric_core.planar import Array
from pushfric_core.settings import check_ranges, setting
from pushfric_core.solvers.program import Status
from pushfric_core.solvers.quadratic import LeastSquares, OsqpLinearProgram, nearest_uniform
from pushfric_core.solvers.simplex import Optimum, Simplex
from pushfric_core.support import FreeRadii, center_of_friction, check_points, support_forces

TERMS = ("moment", "frictionless", "cone", "force", "force_angle")

COR_SHARE = 0.55
"""How far the centre of rotation wanders in a step, as a share of the support's size: docs/estimation.md has the evidence."""

FORCE_TERMS = ("force", "force_angle")
"""Those that need a measured force; data points without one bring no row of theirs."""


TIE_BREAK_LIMIT = 300
"""Data points up to which ties are broken: more hardly ever leave any, and the cost of one must not grow with their number."""

LOSSES, SOLVERS = ("l1", "l2"), ("simplex", "osqp")


@dataclass(frozen=True)
class EstimatorConfig:
    """Which constraints make up the program; but for cor_radius, the defaults are the paper's (section 5)."""

    terms: tuple[str, ...] = setting(("moment",), f"what the fit error is made of, any of: {', '.join(TERMS)}")
    half_width: float = setting(0.0, "half the contact interval of data points that bring none [m] (eqs 5 and 6)", 0.0, 1.0)
    cor_radius: float | None = setting(
        None,
        "supports this near the centre of rotation may push any way [m]; 0: none, as in the paper; auto: the freer the nearer, "
        f"within {COR_SHARE:g} of the rms distance of the support points from their middle",
        0.0,
        1.0,
    )
    nonnegative_force: bool = setting(True, "the pusher cannot pull: f.n >= 0 (eq. 7)")
    pull_penalty: float = setting(
        math.inf, "cost of a unit of force that pulls, beside a metre of moment [m]; inf: eq. 7 is hard", 0.0, math.inf
    )
    mu_bound: float = setting(
        math.inf, "known upper bound on mu_c, which the term cone needs (eqs 9 and 10); inf: none is known", 0.0, math.inf
    )
    force_weight: float = setting(0.035, "cost of a unit of force beside a metre of moment [m]", 0.0, 100.0)
    force_half_angle: float = setting(
        0.0, "half the cone about a measured force that holds the true one, for the term force_angle [rad]", 0.0, 1.5
    )
    loss: str = setting("l1", "l1: the sum of errors, robust; l2: the sum of their squares, for Gaussian ones (section 6.1)")
    solver: str = setting("simplex", "simplex: exact; osqp: approximate, for comparison; l2 has its own")
    tie_break: bool = setting(
        True, "of equally good w, take the one nearest to equal weights; with simplex, l1, and not the term force"
    )
    confidence: bool = setting(True, "tell how far p_CF can be trusted; not with osqp, nor where p_CF is given")

    def __post_init__(self) -> None:
        check_ranges(self)
        unknown = [term for term in self.terms if term not in TERMS]
        if unknown:
            raise ValueError(f"terms must be of {', '.join(TERMS)}, got the unknown {', '.join(map(repr, unknown))}")
        if not self.terms:
            raise ValueError(f"terms must name at least one of {', '.join(TERMS)}, got none")
        if "cone" in self.terms and self.mu_bound == math.inf:
            raise ValueError("the term cone needs a mu_bound, the known upper bound on mu_c, got none")
        for name, known in (("loss", LOSSES), ("solver", SOLVERS)):
            if getattr(self, name) not in known:
                raise ValueError(f"{name} must be one of {', '.join(known)}, got {getattr(self, name)!r}")
        if "force" in self.terms and (self.loss, self.solver) != (LOSSES[0], SOLVERS[0]):
            raise ValueError(f"the term force needs the loss l1 and the solver simplex, got {self.loss} and {self.solver}")


@dataclass(frozen=True)
class Estimate:
    """What is known after the last data point; None of it changes later.

    Attributes:
        support_points: (n, 2) [m], object frame.
        solution: w with its objective and certificate: the fit error [m, unit force]; with the loss l2 [m^2, unit force^2].
        data_points: how many it rests on.
        pushes: how many they came from.
        stamp: of the newest of them [ns]; 0 where unknown.
        contact_forces: at each contact, of supports of unit weight, in order of arrival.
        conflicts: data points whose hard constraints contradict each other; none unless the status is INFEASIBLE.
        center_given: the centre of friction is one of the hard constraints (eq. 13).
        confidence: radius about p_CF that holds the truth with 90 % [m]; None where it is not computed, or of few pushes.
    """

    support_points: Array
    solution: Optimum
    data_points: int
    pushes: int
    stamp: int
    contact_forces: ContactForces
    conflicts: tuple[Observation, ...] = ()
    center_given: bool = False
    confidence: float | None = None

    @property
    def w(self) -> Array:
        """Support friction distribution (n,), >= 0, sum 1."""
        return self.solution.w

    @property
    def status(self) -> Status:
        return self.solution.status

    @property
    def total_friction(self) -> float | None:
        """Support friction of the translating object [N]: times w, absolute magnitudes. None without measured forces."""
        return 1 / self.solution.scale if self.solution.scale > 0 else None

    @property
    def contradiction(self) -> str | None:
        """Which pushes contradict each other, for people; None where none do."""
        if self.status is not Status.INFEASIBLE:
            return None
        pushes = sorted({observation.push_id for observation in self.conflicts})
        if not pushes:
            return "no w over the support points has the centre of friction that is asked for"
        given = " with the centre of friction that is asked for" if self.center_given else ""
        return f"no w{given} lets the pusher push (f.n >= 0) in all of the pushes {', '.join(map(str, pushes))}"

    @cached_property
    def center_of_friction(self) -> Array:
        """p_CF (2,) [m], object frame (eq. 3)."""
        return center_of_friction(self.support_points, self.w)

    @cached_property
    def contact_friction(self) -> Array:
        """Lower bounds (m,) on mu_c, one per data point (eq. 12)."""
        return contact_friction.lower_bounds(self.contact_forces, self.w)

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
        config: the constraints; EstimatorConfig() by default.
        center_of_friction: p_CF (2,) [m] where it is known or hypothesised: a hard constraint (eq. 13).
    Raises:
        ValueError: support_points is not (n, 2) with n >= 1, center_of_friction not (2,), or a value is not finite.
    """

    def __init__(
        self,
        support_points: npt.ArrayLike,
        config: EstimatorConfig | None = None,
        center_of_friction: npt.ArrayLike | None = None,
    ) -> None:
        self.support_points = check_points(support_points)
        self.config = config or EstimatorConfig()
        if self.config.cor_radius is None:
            spread = self.support_points - self.support_points.mean(axis=0)
            self._free = FreeRadii(0.0, COR_SHARE * math.sqrt(np.mean(np.sum(spread**2, axis=1))))
        else:
            self._free = FreeRadii(self.config.cor_radius, self.config.cor_radius)
        self._columns = len(self.support_points) + ("force" in self.config.terms)
        self._program = self._empty_program()
        self._observations: dict[int, Observation] = {}  # by the number of their rows in the program
        self._pushes: Counter[int] = Counter()
        self._contacts = _Contacts(len(self.support_points))
        self._next = 0
        self._center_given = center_of_friction is not None
        computed = self.config.confidence and self.config.solver == SOLVERS[0] and not self._center_given
        self._halves = Halves(self.support_points, self._empty_program) if computed else None
        if center_of_friction is not None:
            center = np.array(center_of_friction, dtype=float)
            if center.shape != (2,) or not np.isfinite(center).all():
                raise ValueError(f"center_of_friction must be two finite numbers, got {center_of_friction}")
            self._program.add(stack([center_of_friction_rows(center, self.support_points)], self._columns))
            self._next = 1

    @property
    def observations(self) -> tuple[Observation, ...]:
        """The data points in the program, in order of arrival."""
        return tuple(self._observations.values())

    def add(self, observation: Observation) -> Estimate:
        """Take a data point and estimate anew, from the last optimum on.

        Where data points contradict the nonnegative force, the status is INFEASIBLE, w violates it least, and `conflicts` names
        them.

        Raises:
            UninformativePush: the data point rotates exactly about a support point; the estimator is as before.
        """
        rows = self._rows_of(observation)
        forces = support_forces(self.support_points, observation.twist, self._free)
        self._program.add(rows)
        if self._halves is not None:
            self._halves.add(self._next, observation.push_id, rows)
        self._contacts.append(contact_forces(observation, forces))
        self._observations[self._next] = observation
        self._pushes[observation.push_id] += 1
        self._next += 1
        return self.estimate()

    def check(self, observation: Observation) -> None:
        """Whether `add` would take a data point.

        Raises:
            UninformativePush: it would not.
        """
        support_forces(self.support_points, observation.twist, self._free)

    def exclude(self, push_id: int) -> Estimate:
        """Take all data points of a push out again, and estimate anew, from the last optimum on (section 5.1.3).

        Raises:
            ValueError: there is no data point of that push.
        """
        groups = [group for group, observation in self._observations.items() if observation.push_id == push_id]
        if not groups:
            raise ValueError(f"push_id must be one of {', '.join(map(str, sorted(self._pushes))) or 'none'}, got {push_id}")
        kept = np.array([observation.push_id != push_id for observation in self._observations.values()])
        for group in groups:
            self._program.remove(group)
            if self._halves is not None:
                self._halves.remove(group)
            del self._observations[group]
        del self._pushes[push_id]
        self._contacts.keep(kept)
        return self.estimate()

    def estimate(self) -> Estimate:
        """The estimate from the present data points; without any, all of w is equally good."""
        solution = self._solve()
        groups = self._program.conflicts()
        conflicts = tuple(self._observations[group] for group in groups if group in self._observations)
        stamp = self._observations[next(reversed(self._observations))].stamp if self._observations else 0
        data_points, pushes = len(self._observations), len(self._pushes)
        confidence = None
        if self._halves is not None and solution.status is not Status.INFEASIBLE:
            confidence = self._halves.radius(center_of_friction(self.support_points, solution.w))
        return Estimate(
            self.support_points,
            solution,
            data_points,
            pushes,
            stamp,
            self._contacts.forces,
            conflicts,
            self._center_given,
            confidence,
        )

    def _empty_program(self) -> Simplex | LeastSquares | OsqpLinearProgram:
        n = len(self.support_points)
        if self.config.loss == "l2":
            return LeastSquares(n)
        return OsqpLinearProgram(n) if self.config.solver == "osqp" else Simplex(n, with_scale="force" in self.config.terms)

    def _solve(self) -> Optimum:
        solution, program = self._program.solve(), self._program
        # with a scale, the vertex stands; with many data points as well: this looks at all of them
        tie_break = self.config.tie_break and self._columns == len(self.support_points)
        tie_break = tie_break and len(self._observations) <= TIE_BREAK_LIMIT
        if not tie_break or not isinstance(program, Simplex) or solution.status is not Status.OPTIMAL or program.unique():
            return solution
        certificate = program.certificate()
        if certificate.status is not Status.OPTIMAL:
            return solution
        w, scale, _, objective, lower_bound, gap, status = nearest_uniform(program.rows(), certificate)
        return Optimum(w, scale, objective, lower_bound, gap, status)

    def _rows_of(self, observation: Observation) -> ConstraintRows:
        points, config = self.support_points, self.config
        weight, free = config.force_weight, self._free
        if observation.half_width == 0 and config.half_width > 0:
            observation = replace(observation, half_width=config.half_width)
        parts = []
        if "moment" in config.terms:
            parts.append(moment_rows(observation, points, free))
        if "frictionless" in config.terms:
            parts.append(frictionless_rows(observation, points, weight, free))
        if "cone" in config.terms:
            parts.append(cone_rows(observation, points, config.mu_bound, weight, free))
        # a sensor that reads nothing at all gives no direction
        if "force" in config.terms and observation.force is not None:
            parts.append(sensed_force_rows(observation, points, weight, free))
        if "force_angle" in config.terms and observation.force is not None and any(observation.force):
            parts.append(sensed_direction_rows(observation, points, config.force_half_angle, weight, free))
        if config.nonnegative_force:
            parts.append(normal_force_rows(observation, points, config.pull_penalty, free))
        return stack(parts, self._columns)


class _Contacts:
    """The contact forces of the present data points, in arrays with room to grow; what was handed out never changes."""

    def __init__(self, n: int) -> None:
        self._room = np.empty((3, 64, n))
        self._count = 0

    @property
    def forces(self) -> ContactForces:
        view = self._room[:, : self._count]
        view.setflags(write=False)
        return ContactForces(*view)

    def append(self, forces: ContactForces) -> None:
        if self._count == self._room.shape[1]:
            self._room = np.concatenate((self._room, np.empty_like(self._room)), axis=1)
        self._room[:, self._count] = np.concatenate(forces)
        self._count += 1

    def keep(self, which: npt.NDArray[np.bool_]) -> None:
        kept = self._room[:, : self._count][:, which]
        self._room, self._count = np.concatenate((kept, np.empty((3, 64, kept.shape[2]))), axis=1), kept.shape[1]
