"""A verdict on the input: whether an estimate may be used, and if not, the likely cause and what to do about it.

Every check adds up a few numbers for each observation, or looks at a limited number of observations, so that its cost does not
grow with their number.
"""

import cmath
import heapq
import math
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pushfric_core.geometry.planar import Array, Twist, cross, velocity_at
from pushfric_core.geometry.support import rms_arm
from pushfric_core.solvers.program import Status
from pushfric_core.trajectories.observation import Observation
from pushfric_core.uncertainty.geometry_check import ContactCheck
from pushfric_core.uncertainty.model_comparison import POOR_MISFIT, Explanation
from pushfric_core.uncertainty.outlier_rejection import Change, Rejected
from pushfric_core.uncertainty.reasons import Reason, ReasonCode

if TYPE_CHECKING:
    from pushfric_core.estimation.estimate import Estimate

MAJORITY = 0.5
"""A symptom in more than this share of the observations is not an outlier but a mistake in the input."""

RECEDING = 0.1
"""A contact recedes if it moves outward with more than this share of its speed; less is noise."""

MANY_RECEDE = 0.2
"""If more than this share of the contacts recede, the input is wrong."""

ABOUT_ORIGIN = 0.15
"""Pushes hardly ever turn an object about a point this near its frame's origin, as a share of the support's rms radius."""

TURNED = math.radians(50)
"""Friction keeps each force within the friction cone, so the mean force is turned by no more than this from the motion."""

FEWEST_FORCES = 4
"""With fewer measured forces, nothing is concluded from their directions."""

SCATTERED = 0.5
"""The mean unit vector of the forces, relative to the motion, is longer than this if their frame is right."""

POOR_FIT = 0.2
"""No real push has shown an error per observation above this share of the support's rms radius."""

AT_THE_EDGE = 0.01
"""p_CF lies at the edge of the hull of the support points within this share of their extent."""

ASIDE = 0.1
"""p_CF lies on the wrong side of a line of motion if it is farther from it than this share of the support's rms radius."""

OPPOSED = 0.05
"""Share of the observations for which p_CF may lie on the wrong side; in good runs, real and simulated, at most 0.03 do."""

INERTIA = 0.3
"""Pushes are too fast if the object's speed could give inertia this share of friction."""

CLEAR_MISFIT = 0.06
"""If motions are off by less than this [rad], neither half-planes that are crossed say anything, nor velocities without a
duration, which may be in any unit of time."""

GRAVITY = 9.81  # [m/s^2]
FRICTION = 0.3  # a usual coefficient of support friction
CERTAIN = 1e6
"""Larger odds are reported as more than this."""

OPPOSED_PUSHES = 3
"""... and fewer pushes than this may be bad ones, which the fit tolerates."""

CERTAINLY_OFF = 0.003
"""Contacts and frames that are off by more than this [m] are wrong, however little is known of p_CF."""

LINES = 1000
"""At most this many lines of motion are kept: a sample of all, drawn by what they are, so that their order does not matter."""

DIRECTIONS = np.column_stack([trig(np.arange(64) * math.pi / 32) for trig in (np.cos, np.sin)])
"""(64, 2) unit vectors all around."""


@dataclass(frozen=True)
class Verdict:
    """Whether an estimate may be used.

    Attributes:
        mistakes: of the input.
        rejected: pushes that were left out; the estimate may be used without them.
        change: since when the object is another one; None while it seems to be the same.
        notes: what should be put right although the estimate may be used.
    """

    mistakes: tuple[Reason, ...] = ()
    rejected: tuple[Rejected, ...] = ()
    change: Change | None = None
    notes: tuple[Reason, ...] = ()

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Why it may not be used; none if it may."""
        if self.change is None:
            return self.mistakes
        x, y = (1e3 * value for value in self.change.shift)
        changed = (
            f"the object is another one since push {self.change.since}, p_CF shifted by about ({x:.1f}, {y:.1f}) mm: its load "
            f"was moved, or it was exchanged; start again from push {self.change.since}, with reset or by leaving the earlier "
            "pushes out"
        )
        return Reason(ReasonCode.OBJECT_CHANGED, changed), *self.mistakes

    @property
    def use(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.reasons

    def __str__(self) -> str:
        return "may be used" if self.use else f"do not use it: {'; '.join(map(str, self.reasons))}"


class InputCheck:
    """Looks at the observations of one object as they arrive.

    Args:
        points: (n, 2) support points [m].
    """

    def __init__(self, points: Array) -> None:
        self._points = points
        self._middle = points.mean(axis=0)
        self._radius = rms_arm(points)
        self._count = self._behind = self._inverted = self._receding = self._about_origin = self._forces = self._fast = (
            self._timed
        ) = 0
        self._fastest = math.sqrt(INERTIA * FRICTION * GRAVITY * self._radius)
        self._turn = 0j
        self._lines = _Lines()
        self._contacts = ContactCheck()

    def add(self, observation: Observation) -> None:
        """Take an observation."""
        contact, normal = np.asarray(observation.contact_point), np.asarray(observation.contact_normal)
        vx, vy, omega = observation.twist
        self._count += 1
        behind, recedes = bool((contact - self._middle) @ normal < 0), _recedes(observation.twist, contact, normal)
        self._behind += behind
        self._inverted += behind and recedes
        self._receding += recedes and not behind
        self._about_origin += math.hypot(vx, vy) < ABOUT_ORIGIN * self._radius * abs(omega)
        fast = math.hypot(*velocity_at(observation.twist, self._middle)) > self._fastest
        self._fast += fast
        self._timed += fast and observation.duration is not None
        self._lines.add(observation)
        self._contacts.add(observation)
        if observation.force is not None and any(observation.force):
            motion = complex(*velocity_at(observation.twist, self._middle))
            if motion != 0:
                turned = complex(*observation.force) / motion
                self._turn += turned / abs(turned)
                self._forces += 1

    def verdict(self, estimate: "Estimate", change: Change | None = None) -> Verdict:
        """On the estimate from these observations, with a change of the object that they have shown."""
        # what a mistake in the input brings about says nothing of its own, and its remedy would be the wrong one
        lack = [] if estimate.lack is None else [estimate.lack]
        mistakes = self._mistakes(estimate.comparison.misfit or 0.0)
        explained = estimate.comparison.explanations
        if explained and explained[0].size <= min(_within(estimate), CERTAINLY_OFF):
            explained = ()  # a length that p_CF is not known to is none to worry about
        if any(one.code is ReasonCode.NORMALS_INWARD for one in mistakes) or (mistakes and not explained):
            return Verdict((*mistakes, *lack))
        if explained and explained[0].since is None:
            return Verdict((*_likeliest(explained), *lack))
        if explained:
            first = explained[0]
            assert first.since is not None
            assert first.shift is not None
            return Verdict((*_likeliest(explained)[1:], *lack), change=change or Change(first.since, first.shift))
        wrong = [] if change is not None else self._conflicts(estimate)
        found = self._contacts.found()
        if not found:
            return Verdict((*wrong, *lack), change=change)
        misplaced = [one.reason for one in found]
        if wrong or any(one.displaces and one.size > _within(estimate) for one in found):
            return Verdict((*misplaced, *lack), change=change)
        return Verdict(tuple(lack), change=change, notes=tuple(misplaced))

    def _mistakes(self, misfit: float) -> list[Reason]:
        """Mistakes that the observations themselves show; the misfit [rad] decides which of them count."""
        found = []
        wrong_motion = False  # against which forces would seem turned
        if self._behind > MAJORITY * self._count or self._inverted > MANY_RECEDE * self._count:
            text = (
                f"the normals point inward in {self._behind} of {self._count} observations: contact_normal must point away "
                "from the object; negate normal_x and normal_y"
            )
            found.append(Reason(ReasonCode.NORMALS_INWARD, text))
        elif self._about_origin > MAJORITY * self._count:
            wrong_motion = True
            text = (
                f"the object seems to turn about the origin of its frame in {self._about_origin} of {self._count} "
                "observations, as if omega were in degrees: give omega in radians per unit of time"
            )
            found.append(Reason(ReasonCode.OMEGA_IN_DEGREES, text))
        elif self._receding > MANY_RECEDE * self._count:
            wrong_motion = True
            text = (
                f"the contact moves away from the pusher in {self._receding} of {self._count} observations: vx, vy, omega must "
                "be the velocity of the object-frame origin, in the object frame"
            )
            found.append(Reason(ReasonCode.CONTACTS_RECEDE, text))
        if self._timed > MAJORITY * self._count or (self._fast > MAJORITY * self._count and misfit > CLEAR_MISFIT):
            text = (
                f"the object moves faster than {self._fastest:.2g} m/s in {self._fast} of {self._count} observations, where "
                "inertia is not small next to friction: push more slowly, or give vx, vy in m/s"
            )
            found.append(Reason(ReasonCode.TOO_FAST, text))
        if self._forces >= FEWEST_FORCES and not wrong_motion:
            mean = self._turn / self._forces
            turn = math.degrees(cmath.phase(mean))
            if abs(mean) < SCATTERED:
                text = "the measured forces do not turn with the object: give force_x, force_y in the object frame"
                found.append(Reason(ReasonCode.FORCES_SCATTERED, text))
            elif abs(turn) > 180 - math.degrees(TURNED):
                text = "the measured forces oppose the motion: force_x, force_y are of the pusher ON the object; negate them"
                found.append(Reason(ReasonCode.FORCES_OPPOSED, text))
            elif abs(turn) > math.degrees(TURNED):
                text = f"the measured forces are turned by {turn:.0f} degrees against the motion: check the sensor's frame"
                found.append(Reason(ReasonCode.FORCES_TURNED, text))
        return found

    def _conflicts(self, estimate: "Estimate") -> list[Reason]:
        """Whether pushes contradict each other, or what is known of the object."""
        if estimate.contradiction is not None:
            text = f"{estimate.contradiction}: leave out a bad one of them with --exclude-push"
            return [Reason(ReasonCode.CONTRADICTION, text)]
        if estimate.lack is not None:
            return []
        misfit = estimate.comparison.misfit
        fits = misfit is not None and misfit <= CLEAR_MISFIT and not estimate.center_given
        return self._doubts(estimate) or ([] if fits else self._opposed(estimate))

    def _doubts(self, estimate: "Estimate") -> list[Reason]:
        """Mistakes that the fit shows."""
        error, misfit = estimate.moment_error, estimate.comparison.misfit
        what = "check the units and frames of contact, twist and outline, and the support points"
        if error is not None and error > POOR_FIT * self._radius:
            text = f"the observations err by {error * 1e3:.1f} mm on average, far more than real pushes do: {what}"
            return [Reason(ReasonCode.POOR_FIT, text)]
        if misfit is not None and misfit > POOR_MISFIT:
            text = f"motions are typically {math.degrees(misfit):.0f} degrees off, far more than those of real pushes: {what}"
            return [Reason(ReasonCode.POOR_FIT, text)]
        reach = (DIRECTIONS @ (self._points - estimate.center_of_friction).T).max(axis=1)
        extent = reach[:32] + reach[32:]
        thick = extent.min() > 0.1 * extent.max()
        if estimate.status is not Status.INFEASIBLE and thick and reach.min() < AT_THE_EDGE * extent.max():
            text = "p_CF lies at the edge of the hull of the support points: give support points further out"
            return [Reason(ReasonCode.SUPPORT_TOO_SMALL, text)]
        return []

    def _opposed(self, estimate: "Estimate") -> list[Reason]:
        """Whether the half-planes of section 6.2, which need no support points, contradict the p_CF of the program."""
        center = estimate.center_of_friction
        sides, pushes = self._lines.sides(center)
        wrong = sides < -ASIDE * self._radius
        share, opposed = wrong.sum() / max(len(sides), 1), sorted(set(pushes[wrong].tolist()))
        if share <= OPPOSED or len(opposed) < OPPOSED_PUSHES:
            return []
        x, y = (1e3 * center).tolist()
        cause = (
            "the centre of friction that was given must be wrong"
            if estimate.center_given
            else "check the unit and sign of omega, that vx, vy are the velocity of the object-frame origin, and that contacts "
            "and support points have the same frame"
        )
        text = (
            f"the half-planes contradict the program: in {100 * share:.0f} % of the observations, of {len(opposed)} pushes, "
            f"the object turns the other way than one with p_CF at ({x:.1f}, {y:.1f}) mm: {cause}"
        )
        return [Reason(ReasonCode.HALF_PLANES, text)]


def _within(estimate: "Estimate") -> float:
    """How far p_CF may be off [m]; asked for only where something is wrong, because it takes longer than an observation."""
    return math.inf if estimate.confidence is None else estimate.confidence


def _likeliest(explained: Sequence[Explanation]) -> list[Reason]:
    """The likeliest explanation, with how much likelier it is than the next, and the next one, if there is one."""
    first, *others = explained
    odds = math.exp(min(first.gain - (others[0].gain if others else 0.0), 100.0))
    times = "more than a million times" if odds > CERTAIN else f"{odds:.2g} times"
    rival = "as the next explanation" if others else "as no mistake"
    reasons = [Reason(first.reason.code, f"{first.reason.text} (this is {times} as likely {rival})")]
    return reasons + [Reason(one.reason.code, f"or else: {one.reason.text}") for one in others[:1] if one.reason.text]


class _Lines:
    """The lines along which contacts moved: p_CF lies on the side of each to which the object turned (Mason's theorem 2)."""

    def __init__(self) -> None:
        self._kept: list[tuple[int, tuple[float, ...], int]] = []  # a heap: the checksum, negated; the line; its row
        self._rows = np.empty((LINES, 5))  # contact, unit direction, push

    def add(self, observation: Observation) -> None:
        """Take the line of an observation, with p_CF on its left. One without a turn or a line has none."""
        vx, vy = velocity_at(observation.twist, observation.contact_point).tolist()
        speed = math.copysign(math.hypot(vx, vy), observation.twist.omega)
        if speed == 0 or observation.twist.omega == 0:
            return
        line = (*observation.contact_point, vx / speed, vy / speed, float(observation.push_id))
        ranked = -zlib.crc32(struct.pack("5d", *line)), line
        row = len(self._kept)
        if row < LINES:
            heapq.heappush(self._kept, (*ranked, row))
        elif ranked > self._kept[0][:2]:  # the lines with the lowest checksums stay
            row = self._kept[0][2]
            heapq.heapreplace(self._kept, (*ranked, row))
        else:
            return
        self._rows[row] = line

    def sides(self, point: Array) -> tuple[Array, Array]:
        """How far a point (2,) lies on the side of each line where p_CF must be [m], and the push of each line."""
        lines = self._rows[: len(self._kept)]
        return cross(lines[:, 2:4], point - lines[:, :2]), lines[:, 4].astype(int)


def _recedes(twist: Twist, contact: Array, normal: Array) -> bool:
    velocity = velocity_at(twist, contact)
    return bool(velocity @ normal > RECEDING * math.hypot(*velocity))
