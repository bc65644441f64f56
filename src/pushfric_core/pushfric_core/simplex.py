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
settled in a ball around c need not be looked at while w stays in it. Of two nested balls, the small one is sorted anew often,
and from the rows of the large one only: so the cost of a data point does not depend on the number before it.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.constraints import ConstraintRows
from pushfric_core.linear_program import HARD_VIOLATION, RELATIVE_GAP, Solution, Status, certify
from pushfric_core.planar import Array

Indices = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]
Rows = npt.NDArray[np.void]  # of `_row_type`

# Rows are scaled to a largest coefficient in [1/2, 1), so that tolerances on them are absolute.

ZERO = 1e-14
"""Values within this of zero are rounding: the side of such a row is remembered, not read off."""

VIOLATED = HARD_VIOLATION / 4
"""A hard row is violated beyond this: well within what the certificate allows, which measures by the largest coefficient."""

OWN_GAP = RELATIVE_GAP / 2
"""Half of what `linear_program.certify` allows: it adds up in another order, and must come to the same conclusion."""

NEGATIVE_WEIGHT = 1e3
"""Cost of a negative w_j beside that of a violated row: even where hard rows contradict each other, w stays in the simplex."""

FLAT = (1e-12, 1e-15)
"""Slopes within this fraction of the gradient do not descend; the second is rounding itself, tried where that fails."""

PARALLEL = 1e-11
"""A row that changes by less than this along an edge is parallel to it: exchanging it would make B singular."""

TIE = 1e-15
"""Breakpoints closer than this are one; of its rows, the steepest makes the best-conditioned exchange."""

STALLED = 12
"""After this many exchanges without progress, a degenerate vertex is split by shifting its conditions apart."""

SHIFT = 1e-10
"""By about this much: far above rounding, and so small that hardly an exchange is wrong when the shift is taken back."""

GOLDEN = (math.sqrt(5) - 1) / 2
"""Its multiples modulo 1 are as different from each other as can be, and the same on every run."""

REFRESH = 100
"""B^-1 is computed afresh after this many updates, before their rounding errors show."""

ROUNDS, EXCHANGES = 15, 20
"""Caps on the descents of a solve and, times n + 10, on the exchanges of each: then the certificate judges what there is."""

FAR, CLOSE = 4096, 192
"""Rows left unsettled in the two balls. Sorting 4096 takes some 0.5 ms; an exchange hardly slows down until a few hundred."""

FLOOR = 1e-9
"""Least radius of a ball: the rows of noiseless data are all zero, and none of them is ever settled."""

RIDGE = 1e-5
"""Part of the identity in C: keeps it invertible before the rows span all directions."""

SAMPLE = 512
"""Rows, or 2 n if that is more, that C is taken from."""

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
        self._rows: Rows = np.zeros(2 * CLOSE, _row_type(n))  # in order of arrival, the first _count in use
        self._count = self._removed = self._groups = 0
        self._vertex = _Vertex(n)
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


class _Vertex:
    """n active conditions, the inverse of their normals, and every condition that may become active.

    Conditions are numbered by position: sum w = 1; then w_j >= 0, j = 1..n; then the rows that are not settled.
    """

    def __init__(self, n: int) -> None:
        self.n, self.fixed, self.count = n, 1 + n, 1 + n
        self.settled = np.zeros((2, n))  # gradient of the settled rows, per cost: none of them is violated
        self.a = np.vstack((np.ones(n), np.eye(n)))
        self.row = np.full(self.fixed, -1)  # number of the row
        self.value = np.zeros(self.fixed)  # a . w, or shifted from it while a degenerate vertex is left
        self.side = np.ones(self.fixed)  # +1, -1, or 0 while active: explicit, for at zero the value does not tell
        self.cost = np.zeros((2, 2, self.fixed))  # VIOLATION and FIT; above and below zero
        self.cost[:, :, 0] = np.inf
        self.cost[:, 1, 1:] = [[NEGATIVE_WEIGHT], [np.inf]]
        self.slope = np.zeros((2, 2, self.fixed))  # derivative of the cost there; 0 where it is infinite
        self.slope[VIOLATION, 1, 1:] = -NEGATIVE_WEIGHT
        self.y = np.zeros((2, self.fixed))  # multipliers, per cost: the slope on its side, 0 while active
        self.reserve(2 * CLOSE)
        self.limit = len(self.row)  # of count: beyond, rows ought to be settled
        self.inverse, self.product = np.empty((n, n)), np.empty((n, n))  # B^-1, and room for an update of it
        self.restart()

    def restart(self) -> None:
        """Stand where the last support point bears everything."""
        left = np.flatnonzero(self.side == 0)
        self.put(left, np.ones(len(left)))
        self.active = np.arange(self.n)  # their positions; the first is always sum w = 1
        self.activate(self.active)
        self.normals = self.a[self.active]  # B
        self.dual = np.zeros(self.n)  # their multipliers, as `bounds` left them
        self.invert()
        self.locate()

    # ---- the conditions

    def reserve(self, rows: int) -> None:
        """Make room for so many rows; those there are lost."""

        def resized(old: npt.NDArray[Any]) -> npt.NDArray[Any]:
            new = np.zeros((*old.shape[:-1], self.fixed + rows), old.dtype)
            new[..., : self.fixed] = old[..., : self.fixed]
            return new

        self.a = np.ascontiguousarray(resized(self.a.T).T)
        self.row, self.value, self.side = map(resized, (self.row, self.value, self.side))
        self.cost, self.slope, self.y = map(resized, (self.cost, self.slope, self.y))

    def has_room(self, rows: int) -> bool:
        return self.count + rows <= self.limit

    def append(self, rows: Rows, numbers: Indices) -> None:
        """Add inactive rows, numbered upwards."""
        new = slice(self.count, self.count + len(rows))
        self.count = new.stop
        self.row[new] = numbers
        self.a[new] = a = rows["a"]
        self.value[new] = value = a @ self.w
        self.cost[FIT, :, new] = cost = rows["cost"].T
        self.cost[VIOLATION, :, new] = hard = np.isinf(cost)
        self.slope[VIOLATION, :, new] = hard
        self.slope[FIT, :, new] = np.where(hard, 0.0, cost)
        self.slope[:, 1, new] *= -1.0
        self.put(new, _side(value, rows["side"]))

    def replace(self, rows: Rows, numbers: Indices) -> None:
        """Exchange all rows for others; the active ones must be among them."""
        active_rows = self.row[self.active]
        self.count = self.fixed
        self.limit = self.fixed + len(rows) + len(rows) // 2 + CLOSE
        if self.limit > len(self.row):
            self.reserve(2 * self.limit)
        self.append(rows, numbers)
        self.active = np.where(active_rows < 0, self.active, self.fixed + np.searchsorted(numbers, active_rows))
        self.activate(self.active)

    def free(self, numbers: Indices) -> Mask:
        """Take the costs of these consecutive rows away; tells which of them are here."""
        first, last = self.fixed + np.searchsorted(self.row[self.fixed : self.count], (numbers[0], numbers[-1] + 1))
        for costs in (self.cost, self.slope, self.y):
            costs[..., first:last] = 0.0
        return np.isin(numbers, self.row[first:last])

    def renumber(self, numbers: Indices) -> None:
        self.row[self.fixed : self.count] = numbers[self.row[self.fixed : self.count]]

    def sides(self) -> tuple[Indices, Array]:
        """Number and side of every row here."""
        rows = slice(self.fixed, self.count)
        return self.row[rows], self.side[rows]

    def put(self, conditions: slice | Indices, side: Array) -> None:
        """Put inactive conditions on a side, +1 or -1."""
        self.side[conditions] = side
        self.y[:, conditions] = np.where(side > 0, self.slope[:, 0, conditions], self.slope[:, 1, conditions])

    def activate(self, conditions: int | Indices) -> None:
        self.side[conditions] = 0.0
        self.y[:, conditions] = 0.0

    def violation(self) -> float:
        """The largest of a hard condition."""
        wrong = self._on_hard_side()
        return float(np.abs(self.value[wrong]).max()) if wrong.size else 0.0

    def _on_hard_side(self) -> Indices:
        return self.y[VIOLATION, : self.count].nonzero()[0]

    # ---- the walk

    def descend(self, phase: int, flat: float, shift: float) -> None:
        """Exchange conditions until no edge descends."""
        stalled = 0
        for _ in range(EXCHANGES * (10 + self.n)):
            gradient, slopes = self._price(phase)
            flattest = -flat * math.sqrt(gradient @ gradient)
            edge = int(slopes.argmin())
            if slopes[edge] >= flattest:
                return
            if phase == VIOLATION:
                edge = self._cheapest(slopes, flattest)
            step = self._follow(edge, phase, slopes[edge])
            if step is None:
                return
            stalled = stalled + 1 if step < TIE else 0
            if stalled == STALLED:
                self._shift(shift)
                stalled = 0

    def _price(self, phase: int) -> tuple[Array, Array]:
        """The gradient, and the slope of every edge: (2n,), upwards and downwards."""
        gradient = self.settled[phase] + self.y[phase, : self.count] @ self.a[: self.count]
        multipliers = gradient @ self.inverse
        slopes = self.cost[phase].take(self.active, axis=1)
        slopes[0] += multipliers
        slopes[1] -= multipliers
        return gradient, slopes.reshape(-1)

    def _cheapest(self, slopes: Array, flattest: float) -> int:
        """Of the edges that reduce the violation, the one that raises F least for it: the dual simplex rule."""
        falling = np.flatnonzero(slopes < flattest)
        price = self._price(FIT)[1][falling] / -slopes[falling]
        return int(falling[price.argmin()])

    def _follow(self, edge: int, phase: int, slope: float) -> float | None:
        """Move along a descending edge to the condition that turns it upwards, and exchange; the length of the step."""
        value, side = self.value[: self.count], self.side[: self.count]
        upwards, i = edge < self.n, edge % self.n
        direction = self.inverse[:, i] if upwards else -self.inverse[:, i]
        change = self.a[: self.count] @ direction
        approach = side * change
        if phase == FIT:
            # a condition on its hard side is met, but by rounding only: it blocks either way
            blocked = self._on_hard_side()
            if blocked.size:
                approach[blocked] = -np.abs(change[blocked])
        ahead = (approach < -PARALLEL).nonzero()[0]
        speed = -approach.take(ahead)
        distance = np.maximum((side * value).take(ahead), 0.0) / speed
        order = distance.argsort()
        kinks = (self.cost[phase, 0] + self.cost[phase, 1]).take(ahead) * speed
        turn = int(kinks.take(order).cumsum().searchsorted(-slope))
        if turn == len(order):
            return None  # by rounding only, as the costs are bounded below
        distances = distance.take(order)
        tied = order[turn : distances.searchsorted(distances[turn] + TIE, "right")]
        nearest = tied[speed[tied].argmax()] if len(tied) > 1 else tied[0]
        step, entering, leaving = float(distance[nearest]), ahead[nearest], self.active[i]
        value += step * change
        if turn:
            crossed = ahead[order[:turn]]
            self.put(crossed, -side[crossed])
        side[leaving] = 1.0 if upwards else -1.0
        self.y[:, leaving] = self.slope[:, 0 if upwards else 1, leaving]
        self.activate(entering)
        value[entering] = 0.0
        self._exchange(i, entering)
        return step

    def _exchange(self, i: int, entering: int) -> None:
        """Put a condition in the place of the i-th active one."""
        self.active[i] = entering
        self.normals[i] = self.a[entering]
        self.moved = True
        self.updates += 1
        if self.updates > REFRESH:
            self.invert()
            return
        row = self.normals[i] @ self.inverse
        column = self.inverse[:, i] / row[i]
        row[i] = 0.0
        np.multiply(column[:, None], row, out=self.product)
        self.inverse -= self.product
        self.inverse[:, i] = column

    def _shift(self, shift: float) -> None:
        """Move the conditions that are nearly zero off zero, each by another amount, so that edges have a length."""
        value, side = self.value[: self.count], self.side[: self.count]
        amounts = shift * (1.0 + np.arange(self.count) * GOLDEN % 1.0)
        value += np.where(side * value < shift, side * amounts, 0.0)

    def invert(self) -> None:
        """B^-1 afresh."""
        self.inverse[:] = np.linalg.inv(self.normals)
        self.moved = True  # since `locate`
        self.updates = 0

    def locate(self) -> bool:
        """w and all values afresh from the active conditions; False if a condition turns out to be on its other side."""
        if not self.moved:
            return True
        w = self.inverse[:, 0].copy()
        error = self.normals @ w
        error[0] -= 1.0
        w -= self.inverse @ error
        w[np.abs(w) < ZERO] = 0.0
        w.setflags(write=False)
        self.w: Array = w
        self.moved = False
        self.value[: self.count] = value = self.a[: self.count] @ w
        wrong = (self.side[: self.count] * value < -ZERO).nonzero()[0]
        if wrong.size:
            self.put(wrong, -self.side[wrong])
        return not wrong.size

    # ---- the certificate

    def bounds(self) -> tuple[float, float]:
        """F(w), and a bound below it from the multipliers."""
        value, (above, below) = self.value[: self.count], self.slope[FIT, :, : self.count]
        objective = self.settled[FIT] @ self.w + np.maximum(above * value, below * value).sum()
        gradient = self.settled[FIT] + self.y[FIT, : self.count] @ self.a[: self.count]
        y = -gradient @ self.inverse
        y -= (gradient + y @ self.normals) @ self.inverse
        above, below = self.cost[FIT].take(self.active, axis=1)
        self.dual = np.minimum(np.maximum(y, -below), above)
        self.dual[self.active < self.fixed] = 0.0
        return float(objective), float((gradient + self.dual @ self.normals).min())

    def active_rows(self) -> tuple[Indices, Array]:
        """Numbers and multipliers of the active rows."""
        rows = self.active >= self.fixed
        return self.row[self.active[rows]], self.dual[rows]

    def contradiction(self) -> Indices:
        """The rows with a multiplier in the least violation."""
        y = self.y[VIOLATION, : self.count].copy()
        y[self.active] = -(y @ self.a[: self.count]) @ self.inverse
        y[: self.fixed] = 0.0
        return self.row[np.flatnonzero(np.abs(y) > VIOLATED)]


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
    rows["side"] = side = _side(value, rows["side"])
    ratio = np.abs(value) / rows["norm"]
    above, below = rows["cost"].T
    # active rows and hard rows on their hard side stay, removed ones go
    ratio[(side == 0) | np.isinf(np.where(side > 0, above, below))] = 0.0
    radius = max(FLOOR, float(np.partition(ratio, size)[size])) if len(rows) > size else np.inf
    unsettled = (ratio <= radius) & ((rows["scale"] > 0) | (side == 0))
    return unsettled, _Ball(w, radius, np.where(unsettled, 0.0, _slope(rows)) @ rows["a"])


def _side(value: Array, side: Array) -> Array:
    """The side of each row, read off its value where that is clear; an active row stays so."""
    return np.where((np.abs(value) > ZERO) & (side != 0), np.sign(value), side)


def _slope(rows: Rows) -> Array:
    """Derivative of each row's cost on its side; 0 where it is active or its cost infinite."""
    above, below = _finite(rows["cost"]).T
    return np.where(rows["side"] > 0, above, np.where(rows["side"] < 0, -below, 0.0))


def _finite(cost: Array) -> Array:
    return np.where(np.isinf(cost), 0.0, cost)


def _row_type(n: int) -> np.dtype[np.void]:
    """A stored row. All fields have 8 bytes, so that the coefficients of many rows are a matrix with a stride."""
    return np.dtype([("a", float, n), ("cost", float, 2), ("scale", float), ("norm", float), ("side", float), ("group", int)])
