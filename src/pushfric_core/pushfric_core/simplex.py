"""The linear program for w, solved exactly and incrementally: one vertex, walked to the next optimum as data points arrive.

`vertex` walks; here is what makes the walk's cost independent of how many data points came before, and what certifies its end.

A row far from zero keeps its side, so it is linear: |a . (w - c)| <= |a|* |w - c| with |v|^2 = v' C v and |a|*^2 = a' C^-1 a, C
the second moment of the rows (w moves most where the rows see it least: in any other norm the bound is ten times worse). Rows
settled in a ball around c need not be looked at while w stays in it. Of two nested balls, the small one is sorted anew often,
and from the rows of the large one only: so the cost of a data point does not depend on the number before it.
"""

import math
from typing import NamedTuple

import numpy as np

from pushfric_core.constraints import ConstraintRows
from pushfric_core.linear_program import RELATIVE_GAP, Solution, Status, certify
from pushfric_core.planar import Array
from pushfric_core.vertex import CLOSE, FIT, VIOLATED, VIOLATION, ZERO, Indices, Mask, Rows, Vertex, side_of

OWN_GAP = RELATIVE_GAP / 2
"""Half of what `linear_program.certify` allows: it adds up in another order, and must come to the same conclusion."""

FLAT = (1e-12, 1e-15)
"""Slopes within this fraction of the gradient do not descend; the second is rounding itself, tried where that fails."""

SHIFT = 1e-10
"""Conditions of a degenerate vertex are shifted apart by about this: far above rounding, hardly ever misleading an exchange."""

ROUNDS = 15
"""Cap on the descents of a solve: then the certificate judges what there is."""

FAR = 4096
"""Rows left unsettled in the large ball, as CLOSE are in the small one: sorting them takes some 0.5 ms."""

FLOOR = 1e-9
"""Least radius of a ball: the rows of noiseless data are all zero, and none of them is ever settled."""

RIDGE = 1e-5
"""Part of the identity in C: keeps it invertible before the rows span all directions."""

SAMPLE = 512
"""Rows, or 2 n if that is more, that C is taken from."""


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
        self._rows: Rows = np.zeros(2 * CLOSE, _row_type(n))  # in order of arrival, the first _count in use
        self._count = self._removed = self._groups = 0
        self._vertex = Vertex(n)
        self._infeasible = False
        self._metric = np.eye(n)  # |v| is the length of metric @ v
        self._metric_count = self._measured = 0  # rows there were when it was chosen; rows whose |a|* is known
        self._far = self._close = _Ball(self._vertex.w, np.inf, np.zeros(n))
        self._near: Indices = np.arange(0)  # rows not settled in the far ball; those from _fresh on are not, either
        self._fresh = 0

    def add(self, rows: ConstraintRows) -> None:
        """Append the rows of one data point; they become group 0, 1, 2... in order of arrival.

        Raises:
            ValueError: shapes that do not fit, no rows, coefficients that are not finite, costs that are negative or NaN.
        """
        new = self._scaled(rows)
        first, self._count = self._count, self._count + len(new)
        if self._count > len(self._rows):
            grown = np.empty(2 * self._count, self._rows.dtype)
            grown[:first] = self._rows[:first]
            self._rows = grown
        self._rows[first : self._count] = new
        self._groups += 1
        if self._vertex.has_room(len(new)):
            self._vertex.append(new, np.arange(first, self._count))
        else:
            self._sort()

    def remove(self, group: int) -> None:
        """Take the rows of one data point out again.

        Raises:
            ValueError: there is no such group, or it was removed before.
        """
        first, last = np.searchsorted(self._rows["group"][: self._count], (group, group + 1))
        rows, numbers = self._rows[first:last], np.arange(first, last)
        if not rows["scale"].any():
            raise ValueError(f"there is no group {group} to remove")
        gradients = _slope(rows)[:, None] * rows["a"]
        settled = ~self._vertex.free(numbers)
        far = settled & (numbers < self._fresh) & ~np.isin(numbers, self._near)
        self._vertex.settled[FIT] -= gradients[settled].sum(axis=0)
        self._far.gradient -= gradients[far].sum(axis=0)
        self._removed += len(rows)
        # without cost, a row is in nobody's way: it may stay active until an exchange takes it out
        rows["cost"] = rows["scale"] = 0.0

    def solve(self) -> Optimum:
        """The optimum over the present rows, from the last one. Where the optimum is not unique, w is one of its vertices."""
        for flat in FLAT:
            optimum = self._optimise(flat)
            if optimum.status is not Status.UNCERTIFIED:
                return optimum
            self._vertex.invert()
        self._vertex.restart()
        self._sort()
        return self._optimise(FLAT[0])

    def multipliers(self) -> Array:
        """The dual y of the last optimum, one per present row in order of arrival; O(M)."""
        self._remember_sides()
        rows = self._rows[: self._count]
        y = _slope(rows)
        numbers, active = self._vertex.active_rows()
        y[numbers] = active
        if self._infeasible or (y @ rows["a"]).min() < 0:
            y[:] = 0.0  # F >= 0 is the better bound
        present = rows["scale"] > 0
        return np.asarray(y[present] / rows["scale"][present])

    def certificate(self) -> Solution:
        """The last optimum, judged from scratch by `linear_program.certify`; O(M)."""
        rows = self._rows[: self._count]
        rows = rows[rows["scale"] > 0]
        scale = rows["scale"][:, None]
        unscaled = ConstraintRows(rows["a"] * scale, *(rows["cost"] / scale).T)
        return certify(unscaled, self._vertex.w, self.multipliers())

    def conflicts(self) -> list[int]:
        """The groups whose hard rows contradict each other; none unless the last optimum is infeasible.

        Weighted with the multipliers of the least violation, their rows add up to one that every w violates (Farkas).
        """
        if not self._infeasible:
            return []
        return [int(group) for group in np.unique(self._rows["group"][self._vertex.contradiction()])]

    def _scaled(self, rows: ConstraintRows) -> Rows:
        """The rows as they are stored: scaled by a power of two, which is exact."""
        a, above, below = rows
        m = len(above)
        if not m or a.shape != (m, self._n) or below.shape != (m,):
            raise ValueError(
                f"rows must have shapes (m, {self._n}), (m,), (m,), m > 0; got {a.shape}, {above.shape}, {below.shape}"
            )
        peak, cost = np.abs(a).max(axis=1), np.array((above, below))
        if not math.isfinite(peak.sum()):
            raise ValueError("the coefficients of the rows must be finite")
        if not cost.min() >= 0:
            raise ValueError("the costs of the rows must not be negative or NaN")
        scale = np.ldexp(1.0, np.frexp(peak)[1])
        cost *= scale
        if not peak.all():
            cost[:, peak == 0] = 0.0  # a row of zeros costs nothing, and no w violates it
        new: Rows = np.empty(m, self._rows.dtype)
        new["a"] = a / scale[:, None]
        new["cost"] = cost.T
        new["scale"] = scale
        new["side"] = np.where(cost[0] <= cost[1], 1.0, -1.0)
        new["group"] = self._groups
        return new

    def _optimise(self, flat: float) -> Optimum:
        """Lexicographic descent, until w is optimal for the unsettled rows and no other was settled wrongly."""
        vertex = self._vertex
        for effort in range(ROUNDS):
            shift = SHIFT * 0.1**effort
            if vertex.violation() > ZERO:
                vertex.descend(VIOLATION, flat, shift)
                vertex.locate()
            self._infeasible = vertex.violation() > VIOLATED
            if not self._infeasible:
                vertex.descend(FIT, flat, shift)
            consistent = vertex.locate()
            if not self._close.holds(vertex.w, self._metric):
                self._sort(effort)
            elif consistent:
                break
        return self._judge()

    def _judge(self) -> Optimum:
        """How good w is: from sums over the settled rows, or from all rows where that does not prove it optimal."""
        objective, lower_bound = self._vertex.bounds()
        lower_bound = max(0.0, min(lower_bound, objective))
        gap = objective - lower_bound
        if not self._infeasible and gap <= OWN_GAP * objective and self._vertex.w.min() >= 0:
            return Optimum(self._vertex.w, objective, lower_bound, gap, Status.OPTIMAL)
        truth = self.certificate()
        status = Status.INFEASIBLE if self._infeasible else truth.status
        return Optimum(truth.w, truth.objective, truth.lower_bound, truth.gap, status)

    def _sort(self, effort: int = 0) -> None:
        """Centre the close ball on w: settle the rows far from zero there, and give the vertex the others.

        Each effort doubles the balls, so that a descent that leads out of them again and again ends with all rows unsettled.
        """
        self._remember_sides()
        w = self._vertex.w
        grown = self._count - self._fresh > max(FAR, len(self._near))
        if self._measure() or effort or grown or not self._far.holds(w, 2 * self._metric):
            unsettled, self._far = _settle(self._rows[: self._count], w, FAR << effort)
            self._near, self._fresh = np.flatnonzero(unsettled), self._count
        near = np.concatenate((self._near, np.arange(self._fresh, self._count)))
        rows = self._rows[near]
        unsettled, self._close = _settle(rows, w, (CLOSE + self._n) << effort)
        self._rows["side"][near] = rows["side"]
        # w is within half the far radius now: whatever the close ball allows stays in the far one
        self._close.radius = min(self._close.radius, self._far.radius / 2)
        self._vertex.settled[FIT] = self._far.gradient + self._close.gradient
        self._vertex.replace(rows[unsettled], near[unsettled])

    def _measure(self) -> bool:
        """Bring the norms |a|* up to date; True if the metric, and so all of them, changed."""
        if 2 * self._removed > self._count:
            self._compact()
        renew = self._count >= 2 * self._metric_count
        if renew:
            sample = self._rows["a"][: self._count : 1 + self._count // max(SAMPLE, 2 * self._n)]
            second_moment = sample.T @ sample / len(sample) + RIDGE * np.eye(self._n)
            self._metric = np.linalg.cholesky(second_moment).T
            self._metric_count, self._measured = self._count, 0
        rows = self._rows[self._measured : self._count]
        whitened = rows["a"] @ np.linalg.inv(self._metric)
        rows["norm"] = np.sqrt(np.einsum("ij,ij->i", whitened, whitened)) + ZERO
        self._measured = self._count
        return renew

    def _compact(self) -> None:
        """Forget the removed rows, except active ones."""
        rows = self._rows[: self._count]
        kept = (rows["scale"] > 0) | (rows["side"] == 0)
        self._vertex.renumber(np.cumsum(kept) - 1)
        self._count, self._removed, self._metric_count = int(kept.sum()), 0, 0
        self._rows[: self._count] = rows[kept]

    def _remember_sides(self) -> None:
        numbers, sides = self._vertex.sides()
        self._rows["side"][numbers] = sides


class _Ball:
    """Where the rows settled around its centre keep their sides."""

    def __init__(self, center: Array, radius: float, gradient: Array) -> None:
        self.center, self.radius, self.gradient = center, radius, gradient

    def holds(self, w: Array, metric: Array) -> bool:
        if self.radius == np.inf:
            return True
        offset = metric @ (w - self.center)
        return bool(offset @ offset <= self.radius**2)


def _settle(rows: Rows, w: Array, size: int) -> tuple[Mask, _Ball]:
    """Which rows must stay unsettled, about `size` of them, and the ball that settles the others; updates their sides."""
    value = rows["a"] @ w
    rows["side"] = side = side_of(value, rows["side"])
    ratio = np.abs(value) / rows["norm"]
    above, below = rows["cost"].T
    # active rows and hard rows on their hard side stay, removed ones go
    ratio[(side == 0) | np.isinf(np.where(side > 0, above, below))] = 0.0
    radius = max(FLOOR, float(np.partition(ratio, size)[size])) if len(rows) > size else np.inf
    unsettled = (ratio <= radius) & ((rows["scale"] > 0) | (side == 0))
    return unsettled, _Ball(w, radius, np.where(unsettled, 0.0, _slope(rows)) @ rows["a"])


def _slope(rows: Rows) -> Array:
    """Derivative of each row's cost on its side; 0 where it is active or its cost infinite."""
    above, below = _finite(rows["cost"]).T
    return np.where(rows["side"] > 0, above, np.where(rows["side"] < 0, -below, 0.0))


def _finite(cost: Array) -> Array:
    return np.where(np.isinf(cost), 0.0, cost)


def _row_type(n: int) -> np.dtype[np.void]:
    """A stored row. All fields have 8 bytes, so that the coefficients of many rows are a matrix with a stride."""
    return np.dtype([("a", float, n), ("cost", float, 2), ("scale", float), ("norm", float), ("side", float), ("group", int)])
