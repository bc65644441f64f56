"""Which pushes are bad, and since when the object is another one: a verdict on every push, by comparison with the others.

Each push is measured in five ways. Four need no estimate: how far the contact's velocity along its normal departs from the
tip's, where the two must agree, at worst and in sum; how much the motion jumps from one observation to the next; and how far
the poses that were seen depart from the velocities. The fifth is the moment that a fit to the other pushes leaves unexplained.
Each is compared with what is usual for these pushes, so that the camera's noise needs no setting.

A change of the object is a shift of p_CF. One fit to all pushes is compared with one whose p_CF may shift after some push. For
errors of a Laplace distribution, the difference in units of their scale is a log-likelihood ratio (Andrews, "Tests for
parameter instability and structural change with unknown change point", 1993).

This uses a separate fit, in which no support is freed, because a shift could hide behind the free forces. Instead, the more of
an observation's moment is open near the centre of rotation, the less the observation counts.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.planar import Array, Indices, left_of, rotation, velocity_at, wrap
from pushfric_core.geometry.support import COR_SHARE, FreeRadii, rms_arm, support_forces
from pushfric_core.program.constraint_rows import ConstraintRows
from pushfric_core.program.row_table import RowTable
from pushfric_core.solvers import empty_program
from pushfric_core.trajectories.observation import Observation
from pushfric_core.uncertainty.contact_friction import tip_at
from pushfric_core.uncertainty.reasons import Reason, ReasonCode

FEWEST_COMPARED = 6
"""With fewer pushes, none is rejected."""

NORMAL = 1.4826
"""The standard deviation of a normal distribution over the median of its absolute values."""

LIMITS = {"mismatch": 4.9, "drift": 5.2, "jump": 3.6, "poses": 2.7}
"""Beyond this many times what is usual, a push is bad: some 3 in 1000 good simulated pushes exceed each, at either noise."""

WIDENING = 4
"""With k pushes, limits are (1 + WIDENING / k) / (1 + WIDENING / 14) times as wide: few pushes hardly show what is usual."""

FLOORS = {"mismatch": 0.01, "drift": 0.01, "jump": 0.05, "poses": 0.02}
"""Lower bound on the typical value, as a fraction of tip speed; below it, finite differences dominate camera noise."""

CONTRADICTS = 8.0
"""A push whose moment is wrong by this many times the scale of the errors contradicts the others."""

HEAVY = 5.0
"""... and by this many times what one in ten of the others is wrong by: the errors of some supports have heavy tails."""

TYPICAL_MOMENT = 0.03
"""Share of the support's size by which moments are usually wrong: beyond it, what is open lowers the weight of an
observation."""

LEAST_ERROR = 6e-3
"""Least scale of the errors, as a share of the support's size. Finite steps, and supports between the support points, cause
errors of this size even without noise, and larger ones in single pushes."""

UNCHANGED = 9.0
"""A change is believed beyond this log-likelihood ratio. For independent errors, it comes about by chance with exp(-9); but
errors of whole pushes have something in common, so that in simulation some 5 of 100 runs of 14 pushes exceed it."""

AGREEING = 3
"""A change is believed only if it explains this many of the last pushes; fewer may be bad pushes."""

LATEST = 4
"""A change is looked for before each of this many last pushes; an earlier one would have been found earlier."""

BEFORE = 5
"""Number of pushes before a change that show what the object was."""

STEPS = 10
"""Number of steps of the reweighted least squares that find a shift of p_CF."""

BROKEN = 1.5
"""Observations of a push that are further apart than this many times the nearest two do not show one motion: in between, the
tip was held up, or frames are missing."""

MISMATCH, JUMP, POSES, SPAN, WEIGHT, MOMENTS = range(6)
"""Columns of the table: what was measured of an observation, its time since the one before it in units of its duration,
its weight in the fit, and, from the last on, the row of its moment."""

RIDGE = 1e-9
"""Keeps sums over supports that bear next to nothing, and the direction of a wholly free support, defined."""

SMALLEST = 1e-200
"""Keeps the division by a determinant of zero defined: observations without slopes ask for no shift."""

REASONS = {
    "mismatch": Reason(
        ReasonCode.TIP_MISMATCH, "the contact moves at another speed than the tip: contact was lost, or tracking jumped"
    ),
    "drift": Reason(
        ReasonCode.TIP_DRIFT,
        "the object moves into or off the tip over the whole push: tracking wandered, or another outline was touched",
    ),
    "jump": Reason(ReasonCode.MOTION_JUMPS, "the motion jumps from one observation to the next: tracking jumped"),
    "poses": Reason(ReasonCode.POSES_DISAGREE, "the velocities disagree with the poses that were seen"),
    "moment": Reason(ReasonCode.MOMENT_CONTRADICTS, "it contradicts the other pushes"),
}
"""For each measure, why a push that fails it is bad."""


class Rejected(NamedTuple):
    """A push that is left out."""

    push_id: int
    reason: Reason


class Change(NamedTuple):
    """A change of the object."""

    since: int  # push_id of the first push after it
    shift: tuple[float, float]  # of p_CF [m]


EXACT = 1000
"""Up to this many observations, bad pushes are looked for after each; then after every second, third, ..., so that the mean
cost does not grow."""


def is_due(count: int, held: int) -> bool:
    """Whether what rests on the first `held` of `count` observations must be computed again (see EXACT)."""
    return not 0 <= count - held <= count // EXACT


class OutlierRejection:
    """Looks at the observations of one object, push by push.

    Args:
        points: (n, 2) support points [m].
    """

    def __init__(self, points: Array) -> None:
        self._points, self._middle = points, points.mean(axis=0)
        self._radius = rms_arm(points) or 1.0
        self._radii = FreeRadii(0.0, COR_SHARE * self._radius)
        self._pushes: list[int] = []  # in order of arrival
        self._places: dict[int, int] = {}  # of each push among them
        self._table = RowTable(MOMENTS + len(points))  # each row belongs to the place of its push
        self._last: tuple[Observation, Array] | None = None
        self._program = empty_program(len(points))
        self._groups: dict[int, list[int]] = {}  # of each push in the program
        self._next = 0
        self._bad: set[int] = set()  # pushes that are not in the program
        self._change: Change | None = None

    def add(self, observation: Observation) -> None:
        """Take an observation.

        Raises:
            UninformativePush: it rotates exactly about a support point.
        """
        motion = self._motion(observation)
        jump = poses = span = math.nan
        if self._last is not None and self._last[0].push_id == observation.push_id:
            before, moved = self._last
            if _tells_tip(before) == _tells_tip(observation):  # otherwise, they are shares of different speeds
                jump = float(np.linalg.norm(motion - moved))
            poses = self._between(before, observation)
            if observation.duration and observation.stamp > before.stamp:
                span = (observation.stamp - before.stamp) / 1e9 / observation.duration
        self._last = observation, motion
        forces = support_forces(self._points, observation.twist, self._radii)
        arms = left_of(self._points - observation.contact_point)
        moments = np.einsum("ij,ij->i", arms, forces.directions / np.maximum(1 - forces.free, RIDGE)[:, None])
        # a force anywhere in a disc: half the radius is its standard deviation along any direction. All supports count alike:
        # with the w of the fit, the weight of an observation would depend on those before it
        doubt = float(np.mean(np.hypot(arms[:, 0], arms[:, 1]) * forces.free)) / 2
        weight = 1 / math.hypot(1.0, doubt / (TYPICAL_MOMENT * self._radius))
        row = np.concatenate(((tip_at(observation)[1], jump, poses, span, weight), moments))
        if observation.push_id not in self._places:
            self._places[observation.push_id] = len(self._pushes)
            self._pushes.append(observation.push_id)
        self._table.append(row[None], self._places[observation.push_id])
        if observation.push_id not in self._bad:
            self._put(observation.push_id, moments, weight)

    @property
    def change(self) -> Change | None:
        """The change of the object; None as long as it seems to be the same."""
        return self._change

    def look(self) -> dict[int, str]:
        """Compare the pushes: the bad ones, and which of REASONS shows it. Also looks for a change of the object."""
        if len(self._pushes) < FEWEST_COMPARED:
            return {}
        pushes, place = np.array(self._pushes), self._table.groups
        found = self._badly_measured(pushes, place)
        for push_id in set(found) - self._bad:
            self._take_out(push_id)
        for push_id in self._bad - set(found):
            self._put_back(push_id)
        self._bad = set(found)
        found |= self._contradicting(pushes, place)
        if self._change is None:
            self._change = self._changed(pushes, place)
        return found

    def _badly_measured(self, pushes: Indices, place: Indices) -> dict[int, str]:
        """The pushes whose motion was measured wrongly."""
        k = len(pushes)
        wider = _wider(k)
        values, spans = self._table.rows[:, :SPAN].copy(), self._table.rows[:, SPAN]
        if np.isfinite(spans).any():
            with np.errstate(invalid="ignore"):
                values[spans > BROKEN * np.nanmin(spans), JUMP:] = np.nan
        worst = np.full((k, 3), np.nan)
        np.fmax.at(worst, place, np.abs(values))
        drift = np.abs(np.bincount(place, weights=np.nan_to_num(values[:, MISMATCH])))
        measured = {
            "mismatch": (worst[:, MISMATCH], NORMAL * _median(np.abs(values[:, MISMATCH]))),
            "drift": (drift, NORMAL * _median(np.where(np.isfinite(worst[:, MISMATCH]), drift, np.nan))),
            "jump": (worst[:, JUMP], _median(worst[:, JUMP])),
            "poses": (worst[:, POSES], _median(worst[:, POSES])),
        }
        found: dict[int, str] = {}
        for name, (sizes, usual) in measured.items():
            with np.errstate(invalid="ignore"):
                beyond = sizes > LIMITS[name] * wider * max(usual, FLOORS[name])
            for index in np.flatnonzero(beyond):
                found.setdefault(int(pushes[index]), name)
        return found

    def _contradicting(self, pushes: Indices, place: Indices) -> dict[int, str]:
        """The pushes that the others contradict: each is compared with a fit without it."""
        since = len(pushes) if self._change is None else int(np.flatnonzero(pushes == self._change.since)[0])
        inside = np.array([push_id not in self._bad for push_id in pushes.tolist()])
        if inside.sum() < FEWEST_COMPARED:
            return {}
        found: dict[int, str] = {}
        limit = CONTRADICTS * _wider(int(inside.sum()))
        sizes = self._misfits(place, inside)
        for index in np.flatnonzero(inside & (sizes > limit / 2) & (np.arange(len(pushes)) < since)):
            push_id = int(pushes[index])
            self._take_out(push_id)
            others = inside.copy()
            others[index] = False
            sizes_without = self._misfits(place, others)
            if sizes_without[index] > max(limit, HEAVY * float(np.quantile(sizes_without[others], 0.9))):
                found[push_id] = "moment"
            self._put_back(push_id)
        return found

    def _misfits(self, place: Indices, inside: npt.NDArray[np.bool_]) -> Array:
        """Mean error of each push, over the scale of the errors of those inside the program."""
        optimum = self._program.nearest_uniform()
        errors = self._table.rows[:, WEIGHT] * np.abs(self._table.rows[:, MOMENTS:] @ optimum.w)
        count = int(np.count_nonzero(inside[place]))
        scale = max(optimum.objective / _freedom(count, optimum.w), LEAST_ERROR * self._radius)
        return np.asarray(np.bincount(place, weights=errors) / np.bincount(place) / scale)

    def _changed(self, pushes: Indices, place: Indices) -> Change | None:
        """Whether a shift of p_CF before some of the last pushes explains them much better than none."""
        inside = np.array([push_id not in self._bad for push_id in pushes.tolist()], dtype=bool)
        k = int(inside.sum())
        if k < BEFORE + AGREEING:
            return None
        used = inside[place]
        rank = (np.cumsum(inside) - 1)[place[used]]
        rows = self._table.rows[used]
        optimum = self._program.nearest_uniform()
        weights, errors = rows[:, WEIGHT], rows[:, MOMENTS:] @ optimum.w
        slopes = rows[:, MOMENTS:] @ self._shift(optimum.w)

        def changes(lasts: Indices) -> list[tuple[float, Change]]:
            """A change before each of some of the last pushes, with its log-likelihood ratio."""
            after = rank >= (k - lasts)[:, None]
            before_it, after_it = np.split(_shifts_that_fit(errors, slopes, weights, np.concatenate((~after, after))), 2)
            left = weights * np.abs(errors + np.where(after, after_it @ slopes.T, before_it @ slopes.T))
            found = []
            for last, remaining, shift in zip(lasts.tolist(), left, after_it - before_it, strict=True):
                scale = max(float(remaining.sum()) / _freedom(len(errors) - 4, optimum.w), LEAST_ERROR * self._radius)
                gains = np.bincount(rank, weights=weights * np.abs(errors) - remaining, minlength=k) / scale
                # a single bad push is not a change
                ratio = float(gains.sum() - gains[k - last :].max())
                found.append((ratio, Change(int(pushes[inside][k - last]), (float(shift[0]), float(shift[1])))))
            return found

        lasts = np.arange(1, min(LATEST, k - BEFORE) + 1)
        if max(changes(lasts[AGREEING - 1 :]))[0] <= UNCHANGED:
            return None
        return max(changes(lasts), key=lambda one: one[0])[1]

    def _shift(self, w: Array) -> Array:
        """(n, 2) of w by a shift of p_CF: a load that tips, on what bears it; a share on all points keeps it defined."""
        load = w + 0.2 / len(w)
        arms = self._points - load @ self._points / load.sum()
        loaded = load[:, None] * arms
        return np.asarray(loaded @ np.linalg.pinv(loaded.T @ arms))

    def _put(self, push_id: int, moments: Array, weight: float) -> None:
        cost = np.array((weight,))
        self._program.add(ConstraintRows(moments[None], cost, cost))
        self._groups.setdefault(push_id, []).append(self._next)
        self._next += 1

    def _put_back(self, push_id: int) -> None:
        for row in self._table.rows[self._table.groups == self._places[push_id]]:
            self._put(push_id, row[MOMENTS:], float(row[WEIGHT]))

    def _take_out(self, push_id: int) -> None:
        for group in self._groups.pop(push_id, ()):
            self._program.remove(group)

    def _motion(self, observation: Observation) -> Array:
        """Velocity of the support's middle and of its rim (3,), over the tip's speed, or over its own."""
        vx, vy = velocity_at(observation.twist, self._middle)
        motion = np.array((vx, vy, observation.twist.omega * self._radius))
        tip = observation.tip_velocity
        return np.asarray(motion / (math.hypot(*tip) if tip is not None and any(tip) else np.linalg.norm(motion)))

    def _between(self, before: Observation, after: Observation) -> float:
        """By how much the poses differ from what the velocities say, over the way of the tip; NaN if unknown."""
        time = (after.stamp - before.stamp) / 1e9
        tip = before.tip_velocity
        if before.pose is None or after.pose is None or tip is None or not any(tip) or not time > 0:
            return math.nan
        off, turn = np.zeros(2), wrap(after.pose.theta - before.pose.theta)
        for sign, pose, twist in ((-1, before.pose, before.twist), (1, after.pose, after.twist)):
            turned = rotation(pose.theta)
            off += sign * (np.array(pose[:2]) + turned @ self._middle) - time / 2 * (turned @ velocity_at(twist, self._middle))
            turn -= time / 2 * twist.omega
        return math.hypot(*off, self._radius * turn) / (time * math.hypot(*tip))


def _tells_tip(observation: Observation) -> bool:
    """Whether the tip is known to move."""
    return observation.tip_velocity is not None and any(observation.tip_velocity)


def _median(values: Array) -> float:
    """Median of those that are known; infinite if none is, so that nothing is unusual."""
    known = values[np.isfinite(values)]
    if not len(known):
        return math.inf
    upper = len(known) // 2
    lower = (len(known) - 1) // 2
    parted = np.partition(known, (lower, upper))  # np.median takes four times as long for few values
    return float(parted[lower] + parted[upper]) / 2


def _wider(pushes: int) -> float:
    return (1 + WIDENING / pushes) / (1 + WIDENING / 14)


def _freedom(count: int, w: Array) -> int:
    return max(count - int(np.count_nonzero(w > 1e-9)) + 1, 1)


def _shifts_that_fit(errors: Array, slopes: Array, weights: Array, parts: npt.NDArray[np.bool_]) -> Array:
    """The d (s, 2) of the least sum of weights * |errors + slopes d| over each of s parts (s, m): least squares, reweighted."""
    d: Array = np.zeros((len(parts), 2))
    counted = parts * weights
    smallest = (0.1 * (parts @ np.abs(errors)) / parts.sum(axis=1) + RIDGE)[:, None]
    (x, y), products = slopes.T, slopes * errors[:, None]
    squares = np.column_stack((x * x, x * y, y * y))
    share = np.empty(counted.shape)
    for _ in range(STEPS):
        np.matmul(d, slopes.T, out=share)
        share += errors
        np.maximum(np.abs(share, out=share), smallest, out=share)
        np.divide(counted, share, out=share)
        xx, xy, yy = (share @ squares).T
        bx, by = (share @ products).T
        ridge = RIDGE * (xx + yy)
        xx, yy = xx + ridge, yy + ridge
        determinant = np.maximum(xx * yy - xy * xy, SMALLEST)
        d = np.empty((len(parts), 2))
        d[:, 0], d[:, 1] = xy * by - yy * bx, xy * bx - xx * by
        d /= determinant[:, None]
    return d
