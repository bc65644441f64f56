"""Whether outline, tip and line lie where the files say: how far contacts are off, and how certain that is.

Two measurements show an error. The depth of the tip in the outline is zero if both are right; it shows an outline that is too
large, too small or shifted, and a wrong radius of the tip. The contact moves with the tip across the edge, so a contact that in
truth lies d further along the edge, in the direction of t, seems to move by omega d too much along n; this shows a line that is
off sideways, and contacts whose frame is shifted.

All are fitted by least squares. The observations of a push share errors, so the uncertainty comes from leaving out each push in
turn (the jackknife for clusters: Cameron and Miller, "A practitioner's guide to cluster-robust inference", 2015).
"""

import math
from typing import NamedTuple

import numpy as np

from pushfric_core.geometry.contact import tangent
from pushfric_core.geometry.planar import Array, velocity_at
from pushfric_core.program.row_table import RowTable
from pushfric_core.trajectories.observation import Observation
from pushfric_core.trajectories.trajectory import Apart
from pushfric_core.uncertainty.reasons import Reason, ReasonCode, contacts_displaced, line_off_sideways
from pushfric_core.wording import counted

SMALLEST = 1e-3
"""A smaller error [m] is not reported: outlines and lines are measured to about a millimetre."""

CHANCE = 1e-3
"""An error is reported if chance makes one that large less often than this."""

CLUSTERS = 200
"""At most this many clusters; if there are more pushes, those with neighbouring numbers are taken together."""

RIDGE = 1e-9
"""Share of the data that is added, so that an unknown which they leave open comes out as zero."""

WILD = 1e6
"""Turns beyond this per metre of the tip's way [rad/m], and mismatches beyond this many times its speed, are no pushes."""

EXACT = 1e-6
"""No length is known better than this [m]; it keeps the test defined for data without noise."""

ALIKE = 1.01
"""Two explanations that leave errors this similar are equally good; then the simpler one is reported."""


class GeometryFault(NamedTuple):
    """A way in which contacts are off."""

    reason: Reason
    size: float  # of the error [m]
    displaces: bool  # p_CF, relative to the contacts; if not, the errors of opposite sides cancel


class ContactCheck:
    """Looks at contacts and tips of observations as they arrive; the cost of a look does not grow with their number."""

    def __init__(self) -> None:
        self._depths: dict[int, tuple[Array, float]] = {}  # of each push the normal, and the least depth that it shows [m]
        self._depth = _ClusteredFit(1, 1)
        self._shift = _ClusteredFit(2, 2)  # of the outline, (x, y)
        # the last unknown is the speed, which wrong scales of camera or pusher falsify
        self._line = _ClusteredFit(1, 2)
        self._frame = _ClusteredFit(2, 3)  # contacts shifted by (x, y)

    def add(self, observation: Observation) -> None:
        """Take an observation."""
        normal, push = np.asarray(observation.contact_normal), observation.push_id
        if observation.depth is not None:
            self._add_depth(push, normal, observation.depth)
        if observation.tip_velocity is None or not any(observation.tip_velocity):
            return
        tip = np.asarray(observation.tip_velocity)
        speed = math.hypot(*tip)
        approach = float(tip @ normal) / speed
        mismatch = approach - float(velocity_at(observation.twist, np.asarray(observation.contact_point)) @ normal) / speed
        turn = -observation.twist.omega / speed
        if max(abs(turn), abs(mismatch)) > WILD:
            return
        self._line.add(push, np.array((turn, approach)), mismatch)
        self._frame.add(push, np.array((*(turn * tangent(normal)), approach)), mismatch)

    def _add_depth(self, push: int, normal: Array, depth: float) -> None:
        """A push is as deep as all its observations: single ones seem deeper where reports of the pusher have late stamps."""
        if push not in self._depths:
            self._depths[push] = normal, depth
            self._depth.add(push, np.ones(1), depth)
            self._shift.add(push, normal, depth)
            return
        normal, before = self._depths[push]
        least = max(min(before, depth), 0.0) if before > 0 else min(max(before, depth), 0.0)
        if least != before:
            self._depths[push] = normal, least
            self._depth.change(push, np.ones(1), before, least)
            self._shift.change(push, normal, before, least)

    def found(self) -> list[GeometryFault]:
        """The errors beyond doubt."""
        along, across = self._off_along(), self._off_across()
        if along is not None and across is not None and across.size < along.size:
            across = None  # where the object turns, a tip that is off sideways is a little inside the outline, too
        return [one for one in (across, along) if one is not None]

    def _off_across(self) -> GeometryFault | None:
        """Whether the tip is inside the outline, or away from it."""
        fit = _better(self._depth, self._shift)
        if fit is None:
            return None
        if fit is self._depth:
            where, size, ahead, late = (
                ("inside", "large", "less far ahead", "late")
                if fit.lengths()[0] > 0
                else ("away from", "small", "further ahead", "early")
            )
            text = (
                f"the tip seems to be {1e3 * fit.size:.1f} mm {where} the outline while it pushes: "
                f"the outline or tip_radius is too {size}, the tip is {ahead} than line_origin says, or images have {late} "
                "stamps; measure these again"
            )
            return GeometryFault(Reason(ReasonCode.TIP_OFF_ACROSS, text), fit.size, False)
        x, y = 1e3 * fit.lengths()
        text = (
            f"the outline seems to be shifted by ({x:.1f}, {y:.1f}) mm in the object frame, because the tip is inside "
            "it on one side and away from it on the other: measure where the outline lies in the frame that is tracked"
        )
        return GeometryFault(Reason(ReasonCode.OUTLINE_SHIFTED, text), fit.size, True)

    def _off_along(self) -> GeometryFault | None:
        """Whether contacts lie elsewhere along the edges."""
        fit = _better(self._line, self._frame)
        if fit is None:
            return None
        if fit is self._line:
            return GeometryFault(line_off_sideways(float(fit.lengths()[0])), fit.size, True)
        return GeometryFault(contacts_displaced(*fit.lengths().tolist()), fit.size, True)


def tip_stays_away(apart: Apart) -> str:
    """That the tip often seems not to touch the object that it pushes, with the likely cause and what to do."""
    return (
        f"the object moves in {apart.pushes} of {counted(apart.of, 'push', 'pushes')} though the tip is "
        f"{1e3 * apart.distance:.1f} mm away from its outline: the outline is too small or shifted, tip_radius is too small, "
        "the line is off, or images have early stamps; measure these again"
    )


class _ClusteredFit:
    """Least squares of p unknowns, with the sums of each push apart.

    Args:
        lengths: number of unknowns that are lengths [m], which come first.
        unknowns: p.
    """

    def __init__(self, lengths: int, unknowns: int) -> None:
        self._lengths, self._p = lengths, unknowns
        self._sums = RowTable(unknowns * (unknowns + 1))  # squares and products of each push
        self._places: dict[int, int] = {}  # of each push in that table
        self._all = np.zeros(unknowns * (unknowns + 1))
        self._total = 0.0  # of the squared values

    def add(self, push_id: int, slopes: Array, value: float) -> None:
        """Take the equation slopes (p,) . unknowns = value of an observation of a push."""
        if push_id not in self._places:
            self._places[push_id] = len(self._places)
            self._sums.append(np.zeros((1, len(self._all))), push_id)
        self._change(push_id, np.append(np.outer(slopes, slopes), slopes * value))
        self._total += value**2

    def change(self, push_id: int, slopes: Array, before: float, after: float) -> None:
        """Let an equation of a push, which has these slopes (p,), have another value."""
        self._change(push_id, np.append(np.zeros(self._p**2), slopes * (after - before)))
        self._total += after**2 - before**2

    def _change(self, push_id: int, more: Array) -> None:
        self._sums.rows[self._places[push_id]] += more
        self._all += more

    def _clusters(self) -> Array:
        """The sums of each cluster: of a push, or of as many with consecutive numbers as make it CLUSTERS at most."""
        together = -(-len(self._places) // CLUSTERS)
        if together <= 1:
            return self._sums.rows
        in_order = self._sums.rows[np.argsort(self._sums.groups)]
        return np.add.reduceat(in_order, np.arange(0, len(in_order), together))

    def lengths(self) -> Array:
        """The unknowns that are lengths [m]."""
        return self._solved(self._all)[: self._lengths]

    @property
    def size(self) -> float:
        """Norm of the lengths together [m]."""
        return math.hypot(*self.lengths())

    @property
    def left(self) -> float:
        """Sum of the squares that are left."""
        return self._total - float(self._solved(self._all) @ self._all[self._p**2 :])

    @property
    def detects(self) -> bool:
        """Whether the lengths differ from zero by more than SMALLEST, and beyond doubt."""
        lengths, part = self.lengths(), slice(self._lengths)
        size = math.hypot(*lengths)
        if len(self._places) < self._p + 2 or size <= SMALLEST:
            return False
        clusters = self._clusters()
        count = len(clusters)
        without = self._solved(self._all - clusters)[:, part]
        errors = without - lengths
        covariance = (count - 1) / count * errors.T @ errors + EXACT**2 * np.eye(self._lengths)
        # pushes that say hardly anything in this direction count as none: Carter, Schnepel and Steigerwald, "Asymptotic
        # behavior of a t-test robust to cluster heterogeneity", 2017
        squares = clusters[:, : self._p**2].reshape(-1, self._p, self._p)[:, part, part]
        said = np.einsum("i,kij,j->k", lengths, squares, lengths) / size**2
        freedom = float(said.sum() ** 2 / max(said @ said, np.finfo(float).tiny)) - self._p
        if freedom < 1:
            return False
        from scipy.special import fdtrc  # takes as long to load as the rest of the estimator, and most runs get by without it

        excess = float(lengths @ np.linalg.pinv(covariance, hermitian=True) @ lengths) / self._lengths
        return bool(fdtrc(self._lengths, freedom, excess) < CHANCE)

    def _solved(self, sums: Array) -> Array:
        """The unknowns (..., p) from squares and products (..., p * p + p)."""
        squares = sums[..., : self._p**2].reshape(*sums.shape[:-1], self._p, self._p)
        ridge = RIDGE * np.trace(squares, axis1=-2, axis2=-1) + np.finfo(float).tiny
        products = sums[..., self._p**2 :, None]
        return np.asarray(np.linalg.solve(squares + ridge[..., None, None] * np.eye(self._p), products)[..., 0])


def _better(simple: _ClusteredFit, other: _ClusteredFit) -> _ClusteredFit | None:
    """The fit that detects an error; if both do, the one that explains more. None if neither does."""
    found = [fit for fit in (simple, other) if fit.detects]
    if len(found) == 2:
        return simple if simple.left <= ALIKE * other.left else other
    return found[0] if found else None
