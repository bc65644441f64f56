"""The estimator: add(observation) -> estimate of w, p_CF and mu_c, as in section 3.3."""

from __future__ import annotations

import copy
import math
from collections import deque
from collections.abc import Callable, Collection, Generator, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from pushfric_core import plugins
from pushfric_core.belief.doubts import Rejected
from pushfric_core.belief.judge import Judgement, judging
from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.estimation.estimate import Estimate
from pushfric_core.estimation.excitation import Excitation
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array
from pushfric_core.geometry.support import COR_SHARE, FreeRadii, SupportForces, check_points, rms_arm, support_forces
from pushfric_core.plugins import installed, plugin
from pushfric_core.program.constraints import (
    Cone,
    Constraint,
    Frictionless,
    Moment,
    NormalForce,
    SensedDirection,
    SensedForce,
    center_of_friction_rows,
    stack,
)
from pushfric_core.program.contact_friction import ContactForces, Tip, contact_forces, tip_at
from pushfric_core.settings import check_ranges, setting
from pushfric_core.solvers import empty_program
from pushfric_core.solvers.program import Loss, Optimum, Solver
from pushfric_core.steps import finished
from pushfric_core.trajectories.observation import Observation
from pushfric_core.trajectories.observations import Observations
from pushfric_core.wording import counted, data_of

TERMS: dict[str, Callable[[EstimatorConfig], Constraint]] = {
    "moment": lambda config: Moment(config.half_width),
    "frictionless": lambda config: Frictionless(config.force_weight),
    "cone": lambda config: Cone(config.mu_bound, config.force_weight),
    "force": lambda config: SensedForce(config.force_weight),
    "force_angle": lambda config: SensedDirection(config.force_half_angle, config.force_weight),
}
"""The built-in terms, in the order of their rows."""

FORCE_TERMS = ("force", "force_angle")
"""The terms that need a measured force; an observation without one adds no row for them."""

ABLE = "auto: with the solver simplex and the loss l1, which it needs"
"""When a setting that is None is on, as its description says it."""


@dataclass(frozen=True)
class EstimatorConfig:
    """Which constraints make up the program; except for cor_radius, the defaults are the paper's (section 5).

    `terms` takes the names of the built-in constraints and of entry points of the group pushfric.terms, and objects of your own
    subclasses of `Constraint`. A solver and a loss may be given by name, too.

    Example:
        >>> from pushfric_core import Estimator, EstimatorConfig
        >>> config = EstimatorConfig(terms=("moment", "cone"), mu_bound=0.5)
        >>> Estimator([(-0.05, 0.0), (0.05, 0.0)], config).estimate().w.tolist()
        [0.5, 0.5]
    """

    terms: tuple[str | Constraint, ...] = setting(
        ("moment",), f"terms of the fit error, any of: {', '.join(TERMS)}; or those of other packages"
    )
    half_width: float = setting(0.0, "half the contact interval of observations without their own [m] (eqs 5 and 6)", 0.0, 1.0)
    cor_radius: float | None = setting(
        None,
        "supports within this radius of the centre of rotation have a free friction direction [m]; 0: none, as in the paper; "
        f"auto: by degrees, within {COR_SHARE:g} of the rms distance of the support points from their middle",
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
        Solver.SIMPLEX, "simplex: exact; osqp: approximate, for comparison; the loss l2 is always solved by osqp"
    )
    tie_break: bool | None = setting(
        None, f"if several w are equally good, take the w nearest to equal weights; {ABLE}, and without the term force"
    )
    screening: bool | None = setting(None, f"outlier rejection: leave out pushes that the others contradict; {ABLE}")

    useful_radius: float = setting(
        0.1, "an estimate may be used if p_CF is known to within this share of the support's size, with 90 %", 0.0, math.inf
    )

    def __post_init__(self) -> None:
        check_ranges(self)
        unknown = [term for term in self._own if not isinstance(term, Constraint)]
        if unknown and (unknown := [term for term in unknown if term not in list(installed(plugins.TERMS))]):
            known = ", ".join((*TERMS, *installed(plugins.TERMS)))
            raise ValueError(f"terms must be of {known}, got the unknown {', '.join(map(repr, unknown))}")
        if not self.terms:
            raise ValueError(f"terms must name at least one of {', '.join(TERMS)}, got none")
        if "cone" in self.terms and self.mu_bound == math.inf:
            raise ValueError("the term cone needs a mu_bound, the known upper bound on mu_c, got none")
        if self.with_scale and not self.exact:
            raise ValueError(f"the term force needs the loss l1 and the solver simplex, got {self.loss} and {self.solver}")
        for name in ("tie_break", "screening"):
            if getattr(self, name) and not self.exact:
                raise ValueError(
                    f"{name} needs the loss l1 and the solver simplex, got {self.loss} and {self.solver}; leave it to auto"
                )
        if self.tie_break and self.with_scale:
            raise ValueError("tie_break cannot act with the term force, whose scale leaves no ties; leave it to auto")

    @property
    def _own(self) -> list[str | Constraint]:
        return [term for term in self.terms if isinstance(term, Constraint) or term not in list(TERMS)]

    @cached_property
    def constraints(self) -> tuple[Constraint, ...]:
        """The constraints that make the rows of an observation: built-in terms, your own ones, and eq. 7.

        Raises:
            ValueError: a term from outside cannot be loaded, or is no constraint.
        """
        built_in = tuple(make(self) for name, make in TERMS.items() if name in self.terms)
        own = tuple(term if isinstance(term, Constraint) else _from_outside(term) for term in self._own)
        return built_in + own + (NormalForce(self.pull_penalty),) * self.nonnegative_force

    @property
    def exact(self) -> bool:
        """Whether the solver finds the exact optimum and all that is as good: for tie-break and outlier rejection."""
        return (self.loss, self.solver) == (Loss.L1, Solver.SIMPLEX)

    @property
    def with_scale(self) -> bool:
        """Whether a term compares magnitudes of measured forces, which needs their scale."""
        return any(constraint.with_scale for constraint in self.constraints)

    @property
    def needs_force(self) -> bool:
        """Whether a term needs measured forces."""
        return any(constraint.needs_force for constraint in self.constraints)


def _from_outside(name: str) -> Constraint:
    found = plugin(plugins.TERMS, name)
    made = found() if callable(found) else found
    if not isinstance(made, Constraint):
        raise ValueError(f"term {name!r} must be a Constraint, got {type(made).__name__}")
    return made


AT_ONCE = 100
"""So many observations are taken again without a pause."""


class Estimator:
    """Fits w over hypothesised support points to observations.

    What `estimate` says is a function of the observations and the settings alone, not of their order: pushes that the others
    contradict are left out then. What `add` says of a single observation leaves out those that were found before.

    Args:
        support_points: (n, 2) hypothesised supports in the object frame [m].
        config: the constraints; EstimatorConfig() by default.
        center_of_friction: p_CF (2,) [m] if it is known or hypothesised; it becomes a hard constraint (eq. 13). Then there is
            no screening.
        free: how near the centre of rotation supports may push any way; by default as the config says.
        outline: of the object, which pictures of the estimates show; None: it is not known.
    Attributes:
        newest: the observation with the latest stamp, even if its push is rejected; None without any.
        judgement: the last one: of all observations if `settled`.
    Raises:
        ValueError: support_points is not (n, 2) with n >= 1, center_of_friction not (2,), or a value is not finite; or p_CF is
            given and screening is asked for.

    Example:
        >>> from pushfric_core import Estimator, Observation, Outline, Twist
        >>> outline = Outline.rectangle(0.12, 0.06)
        >>> estimator = Estimator(outline.grid(5, 3), outline=outline)
        >>> estimate = estimator.add(Observation((0.01, -0.03), (0.0, -1.0), Twist(0.0, 0.02, 0.1), push_id=0))
        >>> estimate = estimator.add(Observation((0.06, 0.01), (1.0, 0.0), Twist(-0.02, 0.0, 0.1), push_id=1))
        >>> len(estimator.observations), estimate.status.value
        (2, 'optimal')
    """

    def __init__(
        self,
        support_points: npt.ArrayLike,
        config: EstimatorConfig | None = None,
        center_of_friction: npt.ArrayLike | None = None,
        free: FreeRadii | None = None,
        outline: Outline | None = None,
    ) -> None:
        self.support_points = check_points(support_points)
        self.outline = outline
        self.config = config = config or EstimatorConfig()
        if free is None:
            own = config.cor_radius
            free = FreeRadii(0.0, COR_SHARE * rms_arm(self.support_points)) if own is None else FreeRadii(own, own)
        self._free = free
        self._columns = len(self.support_points) + config.with_scale
        self._center: Array | None = None
        if center_of_friction is not None:
            self._center = np.array(center_of_friction, dtype=float)
            if self._center.shape != (2,) or not np.isfinite(self._center).all():
                raise ValueError(f"center_of_friction must be two finite numbers, got {center_of_friction!r}")
            if config.screening:
                raise ValueError("screening asks where p_CF is, but it is given; leave it to auto")
        self._rejects = config.exact and self._center is None and config.screening is not False
        self._size = float(np.ptp(self.support_points, axis=0).max())
        self._kept: set[int] = set()  # pushes that stay in, whatever shows
        self._begin()

    def _begin(self) -> None:
        """Without any observation."""
        self.newest: Observation | None = None
        self._seen: list[Observation] = []  # all observations, also those of rejected pushes, in order of arrival
        self._rejected: dict[int, Rejected] = {}  # pushes that are not in the program
        self.judgement, self._judged = Judgement(), 0  # the last one, and the number of all observations it was made of
        self._begin_program()

    def _begin_program(self) -> None:
        """Without any observation in the program."""
        self._program = empty_program(len(self.support_points), self.config.loss, self.config.solver, self.config.with_scale)
        self._given = 0  # rows that are of no observation
        self._listed: list[Observation] = []  # in the program; estimates hold on to it, so observations are only ever appended
        self._pushes: set[int] = set()
        self._contacts = _Contacts(len(self.support_points))
        self._excitation = Excitation(self._size)
        if self._center is not None:
            self._program.add(stack([center_of_friction_rows(self._center, self.support_points)], self._columns))
            self._given = 1

    @property
    def observations(self) -> Observations:
        """The observations in the program, in order of arrival."""
        return Observations(self._listed, len(self._listed))

    @property
    def rejected(self) -> tuple[Rejected, ...]:
        """The pushes that are left out because they are unlike the others, each with the reason."""
        return tuple(self._rejected[push_id] for push_id in sorted(self._rejected))

    def __repr__(self) -> str:
        count = data_of(len(self.observations), len({one.push_id for one in self.observations}))
        return f"<Estimator: {count}, {counted(len(self.support_points), 'support point')}>"

    def add(self, observations: Observation | Iterable[Observation]) -> Estimate:
        """Take an observation, or some, and estimate again, starting from the last optimum.

        Several are judged, as `estimate` does. If observations contradict the nonnegative force, the status is INFEASIBLE, w
        violates it least, and `conflicts` names them.

        Raises:
            UninformativePush: one rotates exactly about a support point; the estimator stays as it was.
        """
        if isinstance(observations, Observation):
            self._take(observations, self._forces(observations))
            return self._estimate()
        added = tuple(observations)
        for observation in added:
            self.check(observation)
        for observation in added:
            self._take(observation, self._forces(observation))
        return self.estimate()

    def _take(self, observation: Observation, forces: SupportForces) -> None:
        self._seen.append(observation)
        if self.newest is None or observation.stamp >= self.newest.stamp:
            self.newest = observation
        if observation.push_id not in self._rejected:
            self._append(observation, forces)

    def keep(self, *push_ids: int) -> Estimate:
        """Keep pushes in, or take them back, even if something shows that they are bad. All observations are taken again."""
        self._kept |= set(push_ids)
        return self._take_again(self._seen)

    def exclude(self, push_id: int) -> Estimate:
        """Take all observations of a push out (section 5.1.3). All others are taken again, as if it had never been there.

        Raises:
            ValueError: there is no observation of that push.
        """
        check_push(push_id, {observation.push_id for observation in self._seen})
        return self._take_again([observation for observation in self._seen if observation.push_id != push_id])

    def _take_again(self, observations: list[Observation]) -> Estimate:
        self._begin()
        for observation in observations:
            self._take(observation, self._forces(observation))
        return self.estimate()

    def _append(self, observation: Observation, forces: SupportForces) -> None:
        self._program.add(
            stack([constraint.rows(observation, forces) for constraint in self.config.constraints], self._columns)
        )
        self._contacts.append(contact_forces(observation, forces), tip_at(observation))
        self._excitation.add(observation.push_id, observation.contact_point, observation.contact_normal)
        self._listed.append(observation)
        self._pushes.add(observation.push_id)
        self._program.solve()  # from one optimum to the next, however many observations come at once

    def check(self, observation: Observation) -> None:
        """Check that `add` would take an observation.

        Raises:
            UninformativePush: it would not.
            TypeError: it is none.
        """
        if not isinstance(observation, Observation):
            raise TypeError(f"expected an Observation, got {type(observation).__name__}; load(PATH) reads bags and CSVs")
        self._forces(observation)

    def _forces(self, observation: Observation) -> SupportForces:
        return support_forces(self.support_points, observation.twist, self._free)

    def estimate(self) -> Estimate:
        """The estimate from all present observations, judged; without any, every w is equally good.

        With the setting `screening`, pushes that the others contradict are left out, until they no longer do.
        """
        return finished(self.settling())

    def settling(self) -> Generator[None, None, Estimate]:
        """As `estimate`, but pauses after each step, for a program that has other things to do meanwhile.

        An observation that is added in a pause makes the rest useless: begin again.
        """
        seen = tuple(self._seen)
        if not self.settled:
            judgement = yield from judging(self.support_points, seen, self._never_rejected)
            bad = {one.push_id: one for one in judgement.doubts.rejected}
            if bad.keys() != self._rejected.keys():
                # the program takes all others again, so that no bit of what it says depends on when somebody asked
                again = copy.copy(self)
                again._begin_program()
                for number, observation in enumerate(seen):
                    if observation.push_id not in bad:
                        again._append(observation, self._forces(observation))
                    if number % AT_ONCE == 0:
                        yield
                vars(self).update(vars(again))
            self._rejected, self.judgement, self._judged = bad, judgement, len(seen)
        return self._estimate()

    @property
    def settled(self) -> bool:
        """Whether all observations have been judged."""
        return self._judged == len(self._seen)

    @property
    def _never_rejected(self) -> tuple[int, ...] | None:
        return tuple(sorted(self._kept)) if self._rejects else None

    def _estimate(self) -> Estimate:
        solution = self._solve()
        conflicts = tuple(self._listed[group - self._given] for group in self._program.conflicts() if group >= self._given)
        data_points, pushes = len(self._listed), len(self._pushes)
        return Estimate(
            self.support_points,
            solution,
            data_points,
            pushes,
            self.newest.stamp if self.newest is not None else 0,
            self._contacts.forces,
            conflicts,
            self._center is not None,
            self._excitation.lack(pushes),
            self._contacts.tip,
            Observations(self._listed, data_points),
            self.rejected,
            self.outline,
            self._never_rejected,
            self.config.useful_radius * self._size,
            self.judgement if self.settled else None,
        )

    def _solve(self) -> Optimum:
        return self._program.solve() if self.config.tie_break is False else self._program.nearest_uniform()


class _Contacts:
    """The contact forces of the present observations, in arrays with room to grow; arrays that were returned never change."""

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

    def _hold(self, forces: Array, tips: Array, more: int) -> None:
        """Hold these from now on, with room for some more."""
        self._room = np.concatenate((forces, np.empty((3, more, forces.shape[2]))), axis=1)
        self._tips = np.concatenate((tips, np.empty((4, more))), axis=1)
        self._shown, self._shown_tips = self._room.view(), self._tips.view()
        self._shown.setflags(write=False)
        self._shown_tips.setflags(write=False)


Warn = Callable[[str], None]

Taken = TypeVar("Taken")


def check_push(push_id: int, known: Collection[int]) -> None:
    """Refuse a push that is none of those known. Raises ValueError."""
    if push_id not in known:
        raise ValueError(f"push_id must be one of {', '.join(map(str, sorted(known))) or 'none'}, got {push_id}")


def taken(take: Callable[[Observation], Taken], data: Iterable[Observation], warn: Warn) -> Iterator[Taken]:
    """The result of each observation, one by one, as in a live node; `warn` is called with a line for each that is refused."""
    for observation in data:
        try:
            yield take(observation)
        except PushfricError as error:
            warn(f"observation of push {observation.push_id} refused: {error}")


def last(results: Iterable[Taken]) -> Taken:
    """The result of the last observation.

    Raises:
        InvalidInput: all observations were refused.
    """
    newest = deque(results, maxlen=1)
    if not newest:
        raise InvalidInput("no observation could be used, expected at least one")
    return newest[0]


def usable_by(estimator: Estimator, data: Iterable[Observation], warn: Warn) -> list[Observation]:
    """The observations that an estimator takes; warns as `taken`."""

    def checked(observation: Observation) -> Observation:
        estimator.check(observation)
        return observation

    return list(taken(checked, data, warn))
