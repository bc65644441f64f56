"""A verdict on the input: whether an estimate may be used, and if not, the likely cause and what to do about it."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pushfric_core.belief.doubts import Change, Rejected
from pushfric_core.belief.judge import Judgement
from pushfric_core.geometry.planar import cross, velocity_at
from pushfric_core.geometry.support import rms_arm
from pushfric_core.wording import Reason

if TYPE_CHECKING:
    from pushfric_core.estimation.estimate import Estimate

POOR_MISFIT = 0.25
"""Motions of good runs, real and simulated, are typically off by less than this [rad]."""

CERTAINLY_OFF = 0.003
"""Contacts and frames that are off by more than this [m] are wrong, however little is known of p_CF."""

RIVAL = math.log(100)
"""The second mistake is told, too, unless the likeliest is more probable than it by this factor's logarithm."""

ASIDE = 0.1
"""p_CF lies on the wrong side of a line of motion if it is farther from it than this share of the support's rms radius."""

OPPOSED, OPPOSED_PUSHES = 0.05, 3
"""Share of the observations for which a given p_CF may lie on the wrong side; fewer pushes may be bad ones."""


@dataclass(frozen=True)
class Verdict:
    """Whether an estimate may be used.

    Attributes:
        mistakes: why it may not be used; none if it may, but for a change.
        rejected: the pushes that are left out, each with the reason; they do not speak against the use.
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
        since = self.change.since_push
        changed = (
            f"the object is another one since push_id {since}, p_CF shifted by about ({x:z.1f}, {y:z.1f}) mm: its load "
            f"was moved, or it was exchanged; start again from push_id {since}, with reset or by leaving the earlier "
            "pushes out"
        )
        return Reason("object_changed", changed), *self.mistakes

    @property
    def use(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.reasons

    def __str__(self) -> str:
        return "may be used" if self.use else f"do not use it: {'; '.join(map(str, self.reasons))}"


def verdict_on(estimate: "Estimate", judgement: Judgement) -> Verdict:
    """Whether an estimate may be used, by what was judged of its observations, or when the last push had ended."""
    belief, doubts = judgement
    center_known = belief is not None and estimate.lack is None and not estimate.center_given
    radius = math.inf if belief is None or belief.confidence is None or not center_known else belief.confidence
    known_to = min(radius, CERTAINLY_OFF)
    mistakes = [one for one in doubts.mistakes if one.size > known_to]
    notes = [one.reason for one in doubts.mistakes if one.size <= known_to][:1]
    wrong = [one.reason for one in mistakes[:1]]
    if len(mistakes) > 1 and mistakes[0].odds - mistakes[1].odds < RIVAL:
        wrong.append(Reason(mistakes[1].reason.code, f"or else: {mistakes[1].reason.text}"))
    wrong += doubts.symptoms
    # what a mistake in the input brings about says nothing of its own, and its remedy would be the wrong one
    change = None if wrong else doubts.change
    conflicts = [] if wrong or change is not None else _conflicts(estimate, doubts.misfit)
    if (tip := doubts.tip_off) is None:
        wrong += conflicts
    elif conflicts or (tip.displaces and tip.size > known_to):
        wrong.append(tip.reason)
    else:
        notes.append(tip.reason)
    lack = [] if estimate.lack is None else [estimate.lack]
    if not (wrong or lack or change or estimate.center_given) and estimate.useful_radius < radius:
        known = "not known" if math.isinf(radius) else f"only known to within {1e3 * radius:.1f} mm"
        asked = f"p_CF is {known}, and {1e3 * estimate.useful_radius:.1f} mm are asked for"
        lack = [Reason("uncertain", f"{asked}: push more, at other places and on other sides")]
    rejected = sorted({*estimate.rejected, *doubts.rejected})
    return Verdict((*wrong, *lack), tuple(rejected), change, tuple(notes))


def _conflicts(estimate: "Estimate", misfit: float | None) -> list[Reason]:
    """Whether pushes contradict each other, or what is known of the object."""
    if estimate.contradiction is not None:
        text = f"{estimate.contradiction}: leave out a bad one of them with --exclude-push"
        return [Reason("contradiction", text)]
    if misfit is not None and misfit > POOR_MISFIT:
        text = (
            f"motions are typically {math.degrees(misfit):.0f} degrees off, far more than those of real pushes: "
            "check the units and frames of contact, twist and outline, and the support points"
        )
        return [Reason("poor_fit", text)]
    return _opposed(estimate) if estimate.center_given and estimate.lack is None else []


def _opposed(estimate: "Estimate") -> list[Reason]:
    """Whether the half-planes of section 6.2, which need no support points, contradict the p_CF that was given.

    It lies on the side of each line along which a contact moved to which the object turned (Mason's theorem 2).
    """
    center, limit = estimate.center_of_friction, -ASIDE * rms_arm(estimate.support_points)
    lines, opposed = 0, []
    for one in estimate.observations:
        velocity = velocity_at(one.twist, one.contact_point)
        if one.twist.omega == 0 or not velocity.any():
            continue
        lines += 1
        side = float(cross(velocity, center - one.contact_point)) / math.hypot(*velocity)
        if math.copysign(side, side * one.twist.omega) < limit:
            opposed.append(one.push_id)
    pushes = len(set(opposed))
    if len(opposed) <= OPPOSED * lines or pushes < OPPOSED_PUSHES:
        return []
    x, y = (1e3 * center).tolist()
    text = (
        f"the half-planes contradict the program: in {100 * len(opposed) / lines:.0f} % of the observations, of {pushes} "
        f"pushes, the object turns the other way than one with p_CF at ({x:z.1f}, {y:z.1f}) mm: the centre of friction that "
        "was given must be wrong"
    )
    return [Reason("half_planes", text)]
