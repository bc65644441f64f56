"""The estimator: add(observation) -> estimate of w, p_CF and mu_c, as in section 3.3."""

import math
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import numpy.typing as npt

from pushfric_core.constraint_rows import stack
from pushfric_core.constraints import (
    Cone,
    Constraint,
    Frictionless,
    Moment,
    NormalForce,
    SensedDirection,
    SensedForce,
    center_of_friction_rows,
)
from pushfric_core.contact_friction import ContactForces, Tip, contact_forces, tip_at
from pushfric_core.estimate import Estimate
from pushfric_core.observation import Observation
from pushfric_core.planar import Array
from pushfric_core.screening import REASONS, Rejected, Screening
from pushfric_core.settings import check_ranges, setting
from pushfric_core.solvers import empty_program
from pushfric_core.solvers.program import LevelSets, Loss, Optimum, Program, Solver, Status
from pushfric_core.spread import (
    DIRECTIONS,
    REFRESHED,
    SELDOM,
    TURNS,
    Effects,
    Spread,
    Variety,
    effects,
    rise,
    spread,
)
from pushfric_core.support import FreeRadii, check_points, support_forces
from pushfric_core.verdict import InputCheck, Verdict

TERMS: dict[str, Callable[["EstimatorConfig"], Constraint]] = {
    "moment": lambda config: Moment(config.half_width),
    "frictionless": lambda config: Frictionless(config.force_weight),
    "cone": lambda config: Cone(config.mu_bound, config.force_weight),
    "force": lambda config: SensedForce(config.force_weight),
    "force_angle": lambda config: SensedDirection(config.force_half_angle, config.force_weight),
}
"""The built-in terms, in the order of their rows."""

FORCE_TERMS = ("force", "force_angle")
"""The terms that need a measured force; a data point without one adds no row for them."""

COR_SHARE = 0.55
"""How far the centre of rotation moves in a step, as a fraction of the support's size; see docs/estimation.md."""

TIE_BREAK_LIMIT = 300
"""Number of data points up to which ties are broken; more leave hardly any, and their cost must not grow with the number."""


@dataclass(frozen=True)
class EstimatorConfig:
    """Which constraints make up the program; except for cor_radius, the defaults are the paper's (section 5).

    `terms` takes the names of the built-in constraints, and objects of your own subclasses of `Constraint`. A solver and a loss
    may be given by name, too.
    """

    terms: tuple[str | Constraint, ...] = setting(("moment",), f"what the fit error is made of, any of: {', '.join(TERMS)}")
    half_width: float = setting(0.0, "half the contact interval of data points without their own [m] (eqs 5 and 6)", 0.0, 1.0)
    cor_radius: float | None = setting(
        None,
        "supports this near the centre of rotation may push any way [m]; 0: none, as in the paper; auto: the nearer, the "
        f"freer, within {COR_SHARE:g} of the rms distance of the support points from their middle",
        0.0,
        1.0,
    )
    nonnegative_force: bool = setting(True, "the pusher cannot pull: f.n >= 0 (eq. 7)")
    pull_penalty: float = setting(
        math.inf, "cost of a unit of force that pulls, as the moment that costs the same [m]; inf: eq. 7 is hard", 0.0, math.inf
    )
    mu_bound: float = setting(
        math.inf, "known upper bound on mu_c, required by the term cone (eqs 9 and 10); inf: not known", 0.0, math.inf
    )
    force_weight: float = setting(0.035, "cost of a unit of force, as the moment that costs the same [m]", 0.0, 100.0)
    force_half_angle: float = setting(
        0.0,
        "half-angle of the cone about a measured force that contains the true one, for the term force_angle [rad]",
        0.0,
        1.5,
    )
    loss: Loss = setting(
        Loss.L1, "l1: the sum of errors, robust; l2: the sum of their squares, for Gaussian errors (section 6.1)"
    )
    solver: Solver = setting(
        Solver.SIMPLEX, "simplex: exact; osqp: approximate, for comparison; the loss l2 has its own solver"
    )
    tie_break: bool = setting(
        True, "of equally good w, take the one nearest to equal weights; only with simplex and l1, and without the term force"
    )
    confidence: bool = setting(True, "compute how far p_CF can be trusted; only with simplex and l1, and not if p_CF is given")
    screening: bool = setting(
        True,
        "leave pushes out that are unlike the others, and look for a change of the object; only with simplex and l1, and not "
        "if p_CF is given",
    )

    def __post_init__(self) -> None:
        check_ranges(self)
        for name, choices in (("loss", Loss), ("solver", Solver)):
            if getattr(self, name) not in list(choices):
                raise ValueError(f"{name} must be one of {', '.join(choices)}, got {getattr(self, name)!r}")
            object.__setattr__(self, name, choices(getattr(self, name)))
        object.__setattr__(self, "terms", tuple(self.terms))
        unknown = [term for term in self.terms if not isinstance(term, Constraint) and term not in list(TERMS)]
        if unknown:
            raise ValueError(f"terms must be of {', '.join(TERMS)}, got the unknown {', '.join(map(repr, unknown))}")
        if not self.terms:
            raise ValueError(f"terms must name at least one of {', '.join(TERMS)}, got none")
        if "cone" in self.terms and self.mu_bound == math.inf:
            raise ValueError("the term cone needs a mu_bound, the known upper bound on mu_c, got none")
        if self.with_scale and (self.loss, self.solver) != (Loss.L1, Solver.SIMPLEX):
            raise ValueError(f"the term force needs the loss l1 and the solver simplex, got {self.loss} and {self.solver}")

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """The constraints that make the rows of a data point: built-in terms, your own ones, and eq. 7."""
        built_in = tuple(make(self) for name, make in TERMS.items() if name in self.terms)
        own = tuple(term for term in self.terms if isinstance(term, Constraint))
        return built_in + own + (NormalForce(self.pull_penalty),) * self.nonnegative_force

    @property
    def with_scale(self) -> bool:
        """Whether a term compares magnitudes of measured forces, which needs their scale."""
        return any(constraint.with_scale for constraint in self.constraints)

    @property
    def needs_force(self) -> bool:
        """Whether a term needs measured forces."""
        return any(constraint.needs_force for constraint in self.constraints)


def free_radii(support_points: Array, config: EstimatorConfig) -> FreeRadii:
    """How near the centre of rotation supports (n, 2) [m] may push any way."""
    if config.cor_radius is not None:
        return FreeRadii(config.cor_radius, config.cor_radius)
    spread = support_points - support_points.mean(axis=0)
    return FreeRadii(0.0, COR_SHARE * math.sqrt(np.mean(np.sum(spread**2, axis=1))))


class Estimator:
    """Fits w over hypothesised support points to the data points seen so far.

    Args:
        support_points: (n, 2) hypothesised supports in the object frame [m].
        config: the constraints; EstimatorConfig() by default.
        center_of_friction: p_CF (2,) [m] if it is known or hypothesised; it becomes a hard constraint (eq. 13).
        free: how near the centre of rotation supports may push any way; by default as the config says.
    Raises:
        ValueError: support_points is not (n, 2) with n >= 1, center_of_friction not (2,), or a value is not finite.
    """

    def __init__(
        self,
        support_points: npt.ArrayLike,
        config: EstimatorConfig | None = None,
        center_of_friction: npt.ArrayLike | None = None,
        free: FreeRadii | None = None,
    ) -> None:
        self.support_points = check_points(support_points)
        self.config = config or EstimatorConfig()
        self._free = free or free_radii(self.support_points, self.config)
        self._constraints = self.config.constraints
        self._columns = len(self.support_points) + self.config.with_scale
        self._center_given = center_of_friction is not None
        self._size = float(np.ptp(self.support_points, axis=0).max())
        exact = (self.config.loss, self.config.solver) == (Loss.L1, Solver.SIMPLEX)
        self._open = self.config.confidence and exact and not self._center_given
        self._screens = self.config.screening and exact and not self._center_given
        config = self.config
        self._moments_alone = config.terms == ("moment",) and config.loss is Loss.L1 and math.isinf(config.pull_penalty)
        self._tilts = DIRECTIONS @ (self.support_points - self.support_points.mean(axis=0)).T
        self._kept: set[int] = set()  # pushes that stay in, whatever shows
        self._begin()
        if center_of_friction is not None:
            center = np.array(center_of_friction, dtype=float)
            if center.shape != (2,) or not np.isfinite(center).all():
                raise ValueError(f"center_of_friction must be two finite numbers, got {center_of_friction}")
            self._program.add(stack([center_of_friction_rows(center, self.support_points)], self._columns))
            self._next = 1

    def _begin(self) -> None:
        """Without any data point."""
        self._program = self._empty_program()
        self._observations: dict[int, Observation] = {}  # by the number of its rows in the program
        self._pushes: Counter[int] = Counter()
        self._contacts = _Contacts(len(self.support_points))
        self._next = 0
        self._seen: list[Observation] = []  # all data points, also those of rejected pushes, in order of arrival
        self._screening: Screening | None = None  # only `take` needs it
        self._rejected: dict[int, str] = {}  # what shows that these pushes are bad
        self._screened = 0  # number of data points at the last screening
        self._forget()

    @property
    def observations(self) -> tuple[Observation, ...]:
        """The data points in the program; in order of arrival, except that those of a push that came back are the last."""
        return tuple(self._observations.values())

    @property
    def newest(self) -> Observation | None:
        """The newest data point, even if its push is rejected; None without any."""
        return self._seen[-1] if self._seen else None

    @property
    def rejected(self) -> tuple[Rejected, ...]:
        """The pushes that are left out because they are unlike the others, each with the reason."""
        return tuple(Rejected(push_id, REASONS[what]) for push_id, what in sorted(self._rejected.items()))

    def add(self, observation: Observation) -> Estimate:
        """Take a data point, whatever the others are like, and estimate again, starting from the last optimum.

        If data points contradict the nonnegative force, the status is INFEASIBLE, w violates it least, and `conflicts` names
        these data points.

        Raises:
            UninformativePush: the data point rotates exactly about a support point; the estimator stays as it was.
        """
        self._append(observation)
        self._seen.append(observation)
        return self.estimate()

    def take(self, observation: Observation) -> Estimate:
        """As `add`; but with the setting `screening`, a push that turns out to be unlike the others is left out, until it no
        longer is. Only data points that were taken in this way are compared.

        Raises:
            UninformativePush: as `add`.
        """
        if not self._screens:
            return self.add(observation)
        self.check(observation)
        if self._screening is None:
            self._screening = Screening(self.support_points)
        self._screening.add(observation)
        self._seen.append(observation)
        if observation.push_id not in self._rejected:
            self._append(observation)
        count = len(self._seen)
        if count - self._screened > count // SELDOM:
            self._screened = count
            self._reject(self._screening)
        return self.estimate()

    def keep(self, push_id: int) -> Estimate:
        """Keep a push in, or take it back, even if something shows that it is bad. All data points are taken again."""
        self._kept.add(push_id)
        if self._screening is None:
            return self.estimate()
        return self._take_again(self._seen)

    def _take_again(self, observations: Iterable[Observation]) -> Estimate:
        """Start over with these data points, as if there had never been others: which push is unlike the others depends on all
        pushes before it."""
        self._begin()
        for observation in observations:
            self.take(observation)
        return self.estimate()

    def _reject(self, screening: Screening) -> None:
        """Leave the bad pushes out, and take those back that are so no longer."""
        bad = {push_id: what for push_id, what in screening.look().items() if push_id not in self._kept}
        for push_id in sorted(bad.keys() - self._rejected.keys()):
            self._take_out(push_id)
        back = self._rejected.keys() - bad.keys()
        for observation in self._seen:
            if observation.push_id in back:
                self._append(observation)
        self._rejected = bad

    def _append(self, observation: Observation) -> None:
        forces = support_forces(self.support_points, observation.twist, self._free)
        rows = stack([constraint.rows(observation, forces) for constraint in self._constraints], self._columns)
        self._program.add(rows)
        self._contacts.append(contact_forces(observation, forces), tip_at(observation))
        self._look_at(observation)
        self._observations[self._next] = observation
        self._pushes[observation.push_id] += 1
        self._next += 1

    def check(self, observation: Observation) -> None:
        """Check that `add` would take a data point.

        Raises:
            UninformativePush: it would not.
        """
        support_forces(self.support_points, observation.twist, self._free)

    def exclude(self, push_id: int) -> Estimate:
        """Take all data points of a push out, and estimate again (section 5.1.3).

        This starts from the last optimum; if data points were screened, all are taken again.

        Raises:
            ValueError: there is no data point of that push.
        """
        others = [observation for observation in self._seen if observation.push_id != push_id]
        if len(others) == len(self._seen):
            known = sorted({observation.push_id for observation in self._seen})
            raise ValueError(f"push_id must be one of {', '.join(map(str, known)) or 'none'}, got {push_id}")
        if self._screening is not None:
            return self._take_again(others)
        self._take_out(push_id)
        self._seen = others
        return self.estimate()

    def _take_out(self, push_id: int) -> None:
        groups = [group for group, observation in self._observations.items() if observation.push_id == push_id]
        kept = np.array([observation.push_id != push_id for observation in self._observations.values()])
        for group in groups:
            self._program.remove(group)
            del self._observations[group]
        del self._pushes[push_id]
        self._contacts.keep(kept)
        self._forget()
        for observation in self._observations.values():
            self._look_at(observation)

    def estimate(self) -> Estimate:
        """The estimate from the present data points; without any, every w is equally good."""
        solution = self._solve()
        groups = self._program.conflicts()
        conflicts = tuple(self._observations[group] for group in groups if group in self._observations)
        stamp = self.newest.stamp if self.newest is not None else 0
        data_points, pushes = len(self._observations), len(self._pushes)
        lack = self._variety.lack(pushes)
        told = self._open and lack is None and solution.status is Status.OPTIMAL
        return Estimate(
            self.support_points,
            solution,
            data_points,
            pushes,
            stamp,
            self._contacts.forces,
            conflicts,
            self._center_given,
            self._spread(solution) if told else None,
            lack,
            self._contacts.tip,
            solution.objective / data_points if self._moments_alone and data_points else None,
        )

    def verdict(self, estimate: Estimate) -> Verdict:
        """Whether the last estimate may be used."""
        for observation in self._unchecked:
            self._input.add(observation)
        self._unchecked.clear()
        change = None if self._screening is None else self._screening.change
        return replace(self._input.verdict(estimate, change), rejected=self.rejected)

    def _forget(self) -> None:
        """Begin to look at the data points from the first one on."""
        self._variety, self._input = Variety(self._size), InputCheck(self.support_points)
        self._unchecked: list[Observation] = []  # data points that the input check has not seen yet: only a verdict needs it
        self._effects: Effects | None = None
        self._extremes: Array | None = None
        self._reach = np.full((len(self.support_points), 2), np.nan)  # least and largest w_j in the set
        self._turn = 0  # the first of the w_j whose reach is found next
        self._measured = 0  # data points that the extremes rest on

    def _look_at(self, observation: Observation) -> None:
        self._variety.add(observation.push_id, observation.contact_point, observation.contact_normal)
        self._unchecked.append(observation)

    def _spread(self, solution: Optimum) -> Spread | None:
        """What the data leave open; None if the extremes of the set were not found."""
        count, pushes = len(self._observations), len(self._pushes)
        program = cast(LevelSets, self._program)
        delta = rise(solution.objective, count, solution.w)
        if count - self._measured > count // SELDOM:
            self._extremes = program.extremes(self._tilts, delta)
            self._reach_of_some(solution.w, delta)
            self._measured = count
        if self._extremes is None:
            return None
        if self._effects is None or count - self._effects.data_points > count // REFRESHED:
            group_pushes = np.zeros(self._next, dtype=np.int64)
            group_pushes[list(self._observations)] = [one.push_id for one in self._observations.values()]
            rows, groups = program.rows(), program.row_groups()
            self._effects = effects(rows, groups, group_pushes, self._extremes, solution.scale, delta)
        freedom = max(1, min(count - int(np.count_nonzero(solution.w > 1e-9)) + 1, pushes - 1))
        return spread(self.support_points, solution.w, self._extremes, self._reach, self._effects, freedom)

    def _reach_of_some(self, w: Array, delta: float) -> None:
        """Find the least and largest w_j of the set for the next few j only, so that the cost of a data point stays small."""
        program = cast(LevelSets, self._program)
        n = len(w)
        some = (self._turn + np.arange(-(-n // TURNS))) % n
        upward, bearing = np.eye(n)[some], some[w[some] > 0]  # the least of all others is the 0 that they have
        found = program.extremes(np.concatenate((upward, -np.eye(n)[bearing])), delta)
        if found is not None:
            self._reach[some, 0], self._reach[some, 1] = 0.0, found[np.arange(len(some)), some]
            self._reach[bearing, 0] = found[np.arange(len(some), len(found)), bearing]
        self._turn = int(some[-1] + 1) % n

    def _empty_program(self) -> Program:
        config = self.config
        return empty_program(len(self.support_points), config.loss, config.solver, config.with_scale)

    def _solve(self) -> Optimum:
        if self.config.tie_break and len(self._observations) <= TIE_BREAK_LIMIT:
            return self._program.nearest_uniform()
        return self._program.solve()


class _Contacts:
    """The contact forces of the present data points, in arrays with room to grow; arrays that were returned never change."""

    def __init__(self, n: int) -> None:
        self._count = 0
        self._hold(np.empty((3, 0, n)), np.empty((4, 0)), 64)

    @property
    def tip(self) -> Tip:
        return Tip(*self._shown_tips[:, : self._count])

    @property
    def forces(self) -> ContactForces:
        return ContactForces(*self._shown[:, : self._count])

    def append(self, forces: ContactForces, tip: tuple[float, float, float, float]) -> None:
        row = self._count
        if row == self._room.shape[1]:
            self._hold(self._room, self._tips, row)
        self._tips[:, row] = tip
        self._room[0, row], self._room[1, row], self._room[2, row] = forces.normal, forces.along, forces.free
        self._count += 1

    def keep(self, which: npt.NDArray[np.bool_]) -> None:
        kept, tips = self._room[:, : self._count][:, which], self._tips[:, : self._count][:, which]
        self._count = kept.shape[1]
        self._hold(kept, tips, 64)

    def _hold(self, forces: Array, tips: Array, more: int) -> None:
        """Hold these from now on, with room for some more."""
        self._room = np.concatenate((forces, np.empty((3, more, forces.shape[2]))), axis=1)
        self._tips = np.concatenate((tips, np.empty((4, more))), axis=1)
        self._shown, self._shown_tips = self._room.view(), self._tips.view()
        self._shown.setflags(write=False)
        self._shown_tips.setflags(write=False)
