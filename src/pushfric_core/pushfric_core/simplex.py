"""The linear program for w, solved exactly and incrementally: one vertex, walked to the next optimum as data points arrive.

A vertex is where n conditions a . w = 0 are active: the sum of w (always), some w_j, some rows. With B the n x n matrix of
their normals, B^-1 is kept and updated in place. Its first column is w; column i is the edge that leaves condition i alone.

1. Price.  With g the gradient of all inactive rows, lambda = g B^-1: leaving condition i upwards costs above_i + lambda_i per
   unit, downwards below_i - lambda_i. Where no edge descends, y = -lambda on the active rows completes the dual optimum.
2. Search. Along an edge F is convex and piecewise linear. Its breakpoints are the rows that reach zero; the slope grows by
   (above + below) |a . d| at each. The row that turns it upwards becomes active.
3. Exchange the two conditions: a rank-one update of B^-1.

Hard rows, w_j >= 0 among them, are met lexicographically: first the sum of their violations is minimised, by the same three
steps with other costs; then F, with their costs infinite. A new data point changes g alone: a few exchanges restore optimality.

A row far from zero keeps its side, so it is linear: |a . (w - c)| <= |a|* |w - c| with |v|^2 = v' C v and |a|*^2 = a' C^-1 a, C
the second moment of the rows (w moves most where the rows see it least: in any other norm the bound is ten times worse). Rows
settled in a ball around c need not be looked at while w stays in it; of two nested balls, the small one is sorted anew often and
from the rows of the large one only, so that the cost of a data point does not depend on the number before it.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.constraints import ConstraintRows
from pushfric_core.linear_program import HARD_VIOLATION, NOISELESS, RELATIVE_GAP, Solution, Status, certify
from pushfric_core.planar import Array

Indices = npt.NDArray[np.intp]

# Rows are scaled to a largest coefficient in [1/2, 1), so these tolerances on them are absolute.

ZERO = 1e-14
"""Residuals within this of zero are rounding: the side of such a row is remembered, not read off."""

VIOLATED = HARD_VIOLATION / 4
"""A hard row is violated beyond this: well within what the certificate allows."""

NEGATIVE_WEIGHT = 1e3
"""Cost of a negative w_j beside that of a violated row: even where hard rows contradict each other, w stays in the simplex."""

FLAT = (1e-12, 1e-15)
"""Slopes within this fraction of the gradient do not descend; the second is rounding itself, tried where the first is too coarse."""

PARALLEL = 1e-11
"""A row that changes by less than this along an edge is parallel to it: exchanging it would make B singular."""

TIE = 1e-13
"""Breakpoints closer than this are one; of its rows, the steepest makes the best-conditioned exchange."""

STALLED = 12
"""After this many exchanges without progress, a degenerate vertex is split by shifting its conditions apart."""

SHIFT = 1e-10
"""By about this much: far above rounding, and so small that hardly an exchange is wrong when the shift is taken back."""

REFRESH = 100
"""B^-1 is computed afresh after this many updates, before their rounding errors show."""

ROUNDS, EXCHANGES = 50, 50
"""Caps on the rounds of a solve, and on the exchanges of a round per condition: beyond them the certificate judges what there is."""

FAR, CLOSE = 4096, 192
"""Rows kept unsettled in the two balls: sorting the far one costs a few hundred microseconds, an exchange in the close one is
hardly slower than in a smaller one."""

RIDGE = 1e-5
"""Part of the identity in C: keeps it invertible before the rows span all directions."""

VIOLATION, FIT = 0, 1  # the two costs, in lexicographic order


class Optimum(NamedTuple):
    """The w with the smallest F and how far that is proven: a `linear_program.Solution` without its multipliers."""

    w: Array  # (n,) weights, >= 0, sum 1
    objective: float  # F(w), of the finite costs
    lower_bound: float  # no w has a smaller F
    gap: float  # objective - lower_bound, >= 0
    status: Status


class Simplex:
    """Minimises F over the weights of n support points while rows come and go.

    Args:
        n: number of support points.
    Raises:
        ValueError: n < 1.
    """

    def __init__(self, n: int) -> None:
        if n < 1:
            raise ValueError(f"n must be at least 1, got {n}")
        self._n = n
        self._rows = np.zeros(2 * CLOSE, _row_type(n))  # in order of arrival, the first _count in use
        self._count = self._removed = self._groups = 0
        self._worst = 0.0
        self._conditions = _Conditions(n, 2 * CLOSE)
        self._settled = np.zeros((2, n))  # gradient of the settled rows, per cost: none of them is violated
        self._far_gradient = np.zeros(n)  # of those settled in the far ball
        self._far_center, self._far_radius = np.zeros(n), np.inf
        self._close_center, self._close_radius = np.zeros(n), np.inf
        self._near: Indices = np.arange(0)  # rows not settled in the far ball; nor are those from _fresh on
        self._fresh = 0
        self._metric, self._metric_count, self._measured = np.eye(n), 0, 0
        self._product = np.empty((n, n))
        self._restart()

    def add(self, rows: ConstraintRows) -> None:
        """Append the rows of one data point; they become group 0, 1, 2... in order of arrival.

        Raises:
            ValueError: shapes that do not fit, coefficients that are not finite, costs that are negative or NaN.
        """
        records = self._records(rows)
        first, self._count = self._count, self._count + len(records)
        if self._count > len(self._rows):
            self._rows = np.concatenate((self._rows, np.zeros(self._count, self._rows.dtype)))
        self._rows[first : self._count] = records
        self._groups += 1
        self._worst += float(records["worst"].sum())
        if self._conditions.has_room(len(records)):
            self._conditions.append(records, np.arange(first, self._count), self._w)
        else:
            self._sort()

    def remove(self, group: int) -> None:
        """Take the rows of one data point out again.

        Raises:
            ValueError: there is no such group, or it was removed before.
        """
        first, last = np.searchsorted(self._rows["group"][: self._count], (group, group + 1))
        rows, numbers = self._rows[first:last], np.arange(first, last)
        if not rows["present"].any():
            raise ValueError(f"there is no group {group} to remove")
        settled = ~self._conditions.free(numbers)
        gradients = (_cost_at(rows["side"], rows["above"], rows["below"]) * settled)[:, None] * rows["a"]
        self._settled[FIT] -= gradients.sum(axis=0)
        self._far_gradient -= gradients[(numbers < self._fresh) & ~np.isin(numbers, self._near)].sum(axis=0)
        self._worst -= float(rows["worst"].sum())
        self._removed += len(rows)
        # without cost, a row is in nobody's way: it may stay active until an exchange takes it out
        for name in ("above", "below", "worst", "present"):
            rows[name] = 0

    def solve(self) -> Optimum:
        """The optimum over the present rows, from the last one. Where the optimum is not unique, w is one of its vertices."""
        for flat in FLAT:
            self._optimise(flat)
            optimum = self._judge()
            if optimum.status is not Status.UNCERTIFIED:
                return optimum
            self._invert()
        self._restart()
        self._optimise(FLAT[0])
        return self._judge()

    def multipliers(self) -> Array:
        """The dual y of the last optimum, one per present row in order of arrival; its lower bound is min_j (A' y)_j."""
        self._remember_sides()
        rows = self._rows[: self._count]
        y = _finite(_cost_at(rows["side"], rows["above"], rows["below"]))
        numbers = self._conditions.row[self._active]
        y[numbers[numbers >= 0]] = self._multipliers[numbers >= 0]
        if self._infeasible or (y @ rows["a"]).min() < 0:
            y[:] = 0.0
        return np.asarray((y / rows["scale"])[rows["present"] > 0])

    def certificate(self) -> Solution:
        """The last optimum judged from scratch, by all rows: O(M)."""
        rows = self._rows[: self._count]
        rows = rows[rows["present"] > 0]
        scale = rows["scale"]
        original = ConstraintRows(rows["a"] * scale[:, None], rows["above"] / scale, rows["below"] / scale)
        return certify(original, self._w, self.multipliers())

    def conflicts(self) -> list[int]:
        """The groups whose hard rows contradict each other, if the last optimum is infeasible.

        The violated rows and the multipliers of the active ones are a combination with a positive value for every w (Farkas).
        """
        if not self._infeasible:
            return []
        y, _ = self._conditions.multipliers(VIOLATION)
        y[self._active] = -(y @ self._conditions.a[: len(y)]) @ self._inverse
        y[: 1 + self._n] = 0
        involved = self._conditions.row[np.flatnonzero(np.abs(y) > HARD_VIOLATION)]
        return [int(group) for group in np.unique(self._rows["group"][involved])]

    # ------------------------------------------------------------------------------------------ from vertex to optimum

    def _optimise(self, flat: float) -> None:
        for _ in range(ROUNDS):
            phase = VIOLATION if self._conditions.violated() else FIT
            self._descend(phase, flat)
            consistent = self._locate()
            if not self._within_ball():
                self._sort()
            elif phase == FIT and consistent:
                self._infeasible = False
                return
            elif phase == VIOLATION and consistent and self._conditions.violated():
                self._infeasible = True
                return

    def _descend(self, phase: int, flat: float) -> None:
        """Exchange conditions until no edge descends."""
        conditions = self._conditions
        value, side, cost, kink = conditions.value, conditions.side, conditions.cost[phase], conditions.kink[phase]
        a = conditions.a[: conditions.count]
        y, blocked = conditions.multipliers(phase)
        box = cost[:, self._active]
        slopes = np.empty_like(box)
        tolerance, stalled = None, 0
        for _ in range(EXCHANGES * conditions.count):
            gradient = self._settled[phase] + y @ a
            if tolerance is None:
                tolerance = -flat * max(gradient.max(), -gradient.min())
            multipliers = gradient @ self._inverse
            np.add(box[0], multipliers, out=slopes[0])
            np.subtract(box[1], multipliers, out=slopes[1])
            edge = int(slopes.argmin()) if phase == FIT else self._cheapest(slopes, tolerance)
            slope = slopes.item(edge)
            if slope >= tolerance:
                break
            ...


class _Conditions:
    """
    """
