"""The likeliest mistake in the data of a run: each is undone, and how probable the pushes are is compared.

What was given is as probable as what it becomes once the mistake is undone, times the volume to which that stretches motions. A
tip that is known foretells the whole motion of its stretch. Without one, the turn is foretold, and the contact may move at any
speed in any direction into the object. A stretch in which nothing moves into the object may have moved any way at all.
"""

import math
from collections.abc import Callable, Generator, Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.belief.constants import (
    BAD_PUSH,
    CLEAR,
    GEOMETRY,
    MISTAKE,
    MOST_COMPARED,
    REACH_OFF,
    SMALL_SUPPORT,
    WHITES,
)
from pushfric_core.belief.doubts import displaced, informative
from pushfric_core.belief.fit import Fit, Problem, errors_at, fitting, misfits, problem_of
from pushfric_core.belief.stretches import Steps, into_object, stretches, thinned
from pushfric_core.geometry.planar import Array, left_of
from pushfric_core.geometry.support import rms_arm
from pushfric_core.wording import Reason

STEPS, MORE_STEPS = 4, 2
"""Steps of Gauss-Newton: from even pressure, and from the mode of a similar hypothesis."""

TURNS = 3
"""Number of times that a displacement and the mode are found in turns."""

HOPELESS = -7.0
"""A displacement whose first look leaves its odds below e to this is none. Chosen on simulated pushes; on others, 95 of 100
looks at pushes without a displacement end here, and 2 of 1 200 at pushes whose displacement would be found."""

STEP = 1e-4
"""Step of a numerical slope along a displacement [m]."""

DEGREE = math.pi / 180


class Mistake(NamedTuple):
    """A mistake that is more probable than none."""

    reason: Reason
    odds: float  # logarithm of how much more probable
    size: float = math.inf  # by how much contacts or the motion's frame are off [m]; infinite if that is no length


LINEAR: tuple[tuple[str, tuple[tuple[float, float, float], ...], str], ...] = (
    (
        "omega_negated",
        ((1, 0, 0), (0, 1, 0), (0, 0, -1)),
        "omega has the wrong sign: counter-clockwise, seen from above, is positive; negate omega",
    ),
    (
        "speeds_in_millimetres",
        ((1e-3, 0, 0), (0, 1e-3, 0), (0, 0, 1)),
        "vx and vy are in millimetres: give them in metres per unit of time",
    ),
    (
        "omega_in_degrees",
        ((1, 0, 0), (0, 1, 0), (0, 0, DEGREE)),
        "omega is in degrees: give it in radians per unit of time",
    ),
    ("speeds_swapped", ((0, 1, 0), (1, 0, 0), (0, 0, 1)), "vx and vy are swapped: swap their columns"),
    (
        "columns_mixed",
        ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
        "the columns of the motion are mixed up: they seem to hold omega, vx, vy; expected vx, vy, omega",
    ),
    (
        "columns_mixed",
        ((0, 0, 1), (1, 0, 0), (0, 1, 0)),
        "the columns of the motion are mixed up: they seem to hold vy, omega, vx; expected vx, vy, omega",
    ),
    (
        "mirrored",
        ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
        "the motion is mirrored, along y: the camera's image is, or an axis points the other way",
    ),
    (
        "mirrored",
        ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),
        "the motion is mirrored, along x: the camera's image is, or an axis points the other way",
    ),
    (
        "contacts_recede",
        ((-1, 0, 0), (0, -1, 0), (0, 0, -1)),
        "the motion is that of the table against the object, or in another frame: vx, vy, omega must be the velocity of the "
        "object-frame origin, in the object frame",
    ),
)
"""Mistakes that a linear map undoes: code, matrix from the motion that was given to the right one, and what to do."""


class Explained(NamedTuple):
    """The result of the comparison."""

    mistakes: tuple[Mistake, ...]  # that are more probable than none, likeliest first, one of each code
    misfit: float  # without a mistake, the median angle by which motions are off [rad]


def explaining(points: Array, steps: Steps, size: float) -> Generator[None, None, Explained]:
    """Compare what may be wrong with the steps of a run; pauses after each step.

    Args:
        points: (n, 2) support points [m].
        steps: r, of whose stretches MOST_COMPARED are compared at most.
        size: of the support [m].
    """
    steps = thinned(steps, MOST_COMPARED)
    # at random, as points of a grid that are taken evenly may lie on a line
    run = _Run(points[np.sort(np.random.default_rng(0).permutation(len(points))[:MOST_COMPARED])], steps, size)
    right = yield from run.judged(steps)
    misfit = math.pi if right.problem is None or right.fit is None else float(np.median(misfits(right.problem, right.fit)))
    found = []
    if steps.sticks.any() or misfit > CLEAR or not run.known(steps).all():
        for reason, wrong in run.mistaken():
            judged = yield from wrong
            found.append(Mistake(reason, judged.evidence - right.evidence + math.log(MISTAKE)))
    if right.fit is not None:
        for off in (_along, _aside, _elsewhere):
            mistake = yield from run.displacement(off, right)
            found.append(mistake)
    first: dict[str, Mistake] = {}
    for mistake in sorted(found, key=lambda one: -one.odds):
        if mistake.odds > 0:
            first.setdefault(mistake.reason.code, mistake)
    return Explained(tuple(first.values()), misfit)


class _Judged(NamedTuple):
    """How a hypothesis explains the steps."""

    evidence: float
    problem: Problem | None = None
    fit: Fit | None = None


class _Run(NamedTuple):
    points: Array
    steps: Steps
    size: float

    def judged(
        self, steps: Steps, stretched: float = 0.0, points: Array | None = None, start: Array | None = None
    ) -> Generator[None, None, _Judged]:
        """How probable the motions are that were given, if these steps are what they were.

        Args:
            steps: with a mistake undone.
            stretched: logarithm of the volume to which that stretches the motion of a step.
            points: (n, 2) other support points.
            start: parameters (n + 1,) of a mode near by.
        """
        known = self.known(steps)
        evidence = self._any_way(len(known))[~known].sum() + math.log(BAD_PUSH) * np.sum(~known)
        data = stretches(steps, self.size)
        if data is None:
            return _Judged(float(evidence))
        problem = problem_of(self.points if points is None else points, data, WHITES[0])
        begin = np.zeros(len(problem.place.points) + 1) if start is None else start
        fit = yield from fitting(problem, begin, STEPS if start is None else MORE_STEPS)
        evidence += fit.evidence + len(data.lengths) * (stretched + 3 * math.log(data.unit))
        evidence -= np.sum((2 * np.log(data.lengths) + math.log(math.pi))[problem.freedom == 1])
        return _Judged(float(evidence), problem, fit)

    def known(self, steps: Steps) -> npt.NDArray[np.bool_]:
        """Whether anything moves into the object in each stretch."""
        return np.isin(np.arange(int(steps.part.max()) + 1), steps.part[into_object(steps)])

    def _any_way(self, parts: int) -> Array:
        """The logarithm of how probable the given motion of each stretch is if it may be any, of any size."""
        motions = np.zeros((parts, 3))
        np.add.at(motions, self.steps.part, self.steps.motions)
        velocities = motions[:, :2] + motions[:, 2:] * left_of(self.points.mean(axis=0))
        sizes = np.sqrt(np.sum(velocities**2, axis=1) + (rms_arm(self.points) * motions[:, 2]) ** 2)
        return np.asarray(-3 * np.log(np.maximum(sizes, 1e-12)) - math.log(4 * math.pi))

    def mistaken(self) -> Iterator[tuple[Reason, Generator[None, None, _Judged]]]:
        """The mistakes that are no lengths, each with its judgement."""
        steps = self.steps
        for code, rows, text in LINEAR:
            matrix = np.array(rows)
            undone = steps.moved(steps.motions @ matrix.T)
            yield Reason(code, text), self.judged(undone, math.log(abs(float(np.linalg.det(matrix)))))
        text = (
            "vx and vy are the velocity of the contact, or of another point that moves over the object: give that of the "
            "object-frame origin"
        )
        yield Reason("twist_of_contact", text), self.judged(steps.moved(_of_point(steps.motions, -steps.contacts)))
        if (wider := _wider(self.points, steps.contacts)) is not None:
            text = (
                "the support points leave a part of the object out, on which it seems to rest: check their unit, or give some "
                "further out"
            )
            yield Reason("support_too_small", text), self.judged(steps, points=wider)

    def displacement(self, off: "_Off", right: _Judged) -> Generator[None, None, Mistake]:
        """That contacts, or the frame of the motion, are off: how far is found in turns with the mode."""
        assert right.fit is not None
        d, found = np.zeros(off.unknowns), right
        gain, reason = -math.inf, off.reason(np.zeros(off.unknowns))
        for turn in range(TURNS):
            if turn:
                found = yield from self.judged(off.undone(self.steps, d), start=right.fit.parameters)
            problem, fit = found.problem, found.fit
            if problem is None or fit is None:
                break
            slopes = []
            for unit in np.eye(off.unknowns):
                there = stretches(off.undone(self.steps, d + STEP * unit), self.size)
                if there is None or len(there.contacts) != len(problem.data.contacts):
                    return Mistake(reason, gain, math.hypot(*d))
                moved = errors_at(problem._replace(data=there), fit.roots, fit.parameters)
                slopes.append((moved - fit.off)[: 3 * len(problem.freedom)] / STEP)
            by_shift = np.column_stack(slopes)
            at_none = fit._replace(off=fit.off - np.append(by_shift @ d, np.zeros(len(fit.off) - len(by_shift))))
            gain, d = displaced(problem, informative(at_none), by_shift, self.size, REACH_OFF)
            if np.abs(d).max() > 2 * REACH_OFF:  # anything explains the motions, or nothing does
                return Mistake(reason, -math.inf)
            gain, reason = gain + math.log(GEOMETRY), off.reason(d)
            if gain < HOPELESS:
                break
        return Mistake(reason, gain, math.hypot(*d))


class _Off(NamedTuple):
    """A way in which contacts or the motion's frame may be off."""

    unknowns: int
    undone: Callable[[Steps, Array], Steps]
    reason: Callable[[Array], Reason]


def _line_off(d: Array) -> Reason:
    (offset,) = d.tolist()
    side = "right" if offset > 0 else "left"
    return Reason(
        "line_off_sideways",
        f"the object moves as if its contacts were {1e3 * abs(offset):.1f} mm further to the {side}, seen along the push: "
        "the line is off sideways; measure line_origin and line_direction, or the tip's place, again",
    )


def _contacts_off(d: Array) -> Reason:
    x, y = (1e3 * d).tolist()
    return Reason(
        "contacts_displaced",
        f"the object moves as if its contacts were displaced by ({x:z.1f}, {y:z.1f}) mm in the object frame: "
        "give contacts, outline and velocities in the same frame",
    )


def _origin_off(d: Array) -> Reason:
    x, y = (-1e3 * d).tolist()
    return Reason(
        "origin_off",
        f"the motion seems to be that of a point at ({x:z.0f}, {y:z.0f}) mm, not of the object-frame origin: give poses and "
        "velocities of the frame in which outline and contacts are given",
    )


_along = _Off(1, lambda steps, d: steps.moved(steps.motions, steps.contacts + d[0] * left_of(steps.normals)), _line_off)
_aside = _Off(2, lambda steps, d: steps.moved(steps.motions, steps.contacts + d), _contacts_off)
_elsewhere = _Off(2, lambda steps, d: steps.moved(_of_point(steps.motions, d)), _origin_off)


def _of_point(motions: Array, d: Array) -> Array:
    """The motions (r, 3) of the points that lie at d from those whose motions were given."""
    arms = np.broadcast_to(d, (len(motions), 2))
    return np.column_stack((motions[:, :2] + motions[:, 2:] * left_of(arms), motions[:, 2]))


def _wider(points: Array, contacts: Array) -> Array | None:
    """Support points over all that the contacts enclose; None if the support points do already."""
    size = np.ptp(contacts, axis=0)
    if (np.ptp(points, axis=0) > SMALL_SUPPORT * size).any() or not size.min() > 0:
        return None
    low, steps = contacts.min(axis=0), (np.arange(7) + 0.5) / 7
    return np.asarray(low + size * np.stack(np.meshgrid(steps, steps), axis=2).reshape(-1, 2))
