"""A vertex of the linear program, and the walk from it to the best one: the simplex method for a piecewise linear cost.

A vertex is where n conditions a . w = 0 are active: the sum of w (always), some w_j, some rows. With B the n x n matrix of
their normals, B^-1 is kept and updated in place. Its first column is w; column i is the edge that leaves condition i alone.

1. Price.  With g the gradient of all inactive rows, lambda = g B^-1: leaving condition i upwards costs above_i + lambda_i per
   unit, downwards below_i - lambda_i. Where no edge descends, y = -lambda on the active rows completes the dual optimum.
2. Search. Along an edge F is convex and piecewise linear. Its breakpoints are the rows that reach zero; the slope grows by
   (above + below) |a . d| at each. The row that turns it upwards becomes active.
3. Exchange the two conditions: a rank-one update of B^-1.

Hard rows, w_j >= 0 among them, are met lexicographically: first the sum of their violations is minimised, by the same three
steps with other costs; then F, with their costs infinite. A new data point changes g alone: a few exchanges restore optimality.
"""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from pushfric_core.linear_program import HARD_VIOLATION
from pushfric_core.planar import Array

Indices = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]
Rows = npt.NDArray[np.void]  # as stored: a, cost (above, below), scale, norm, side, group

# Rows are scaled to a largest coefficient in [1/2, 1), so that tolerances on them are absolute.

ZERO = 1e-14
"""Values within this of zero are rounding: the side of such a row is remembered, not read off."""

VIOLATED = HARD_VIOLATION / 4
"""A hard row is violated beyond this: well within what the certificate allows, which measures by the largest coefficient."""

NEGATIVE_WEIGHT = 1e3
"""Cost of a negative w_j beside that of a violated row: even where hard rows contradict each other, w stays in the simplex."""

PARALLEL = 1e-11
"""A row that changes by less than this along an edge is parallel to it: exchanging it would make B singular."""

TIE = 1e-15
"""Breakpoints closer than this are one; of its rows, the steepest makes the best-conditioned exchange."""

STALLED = 12
"""After this many exchanges without progress, a degenerate vertex is split by shifting its conditions apart."""

GOLDEN = (math.sqrt(5) - 1) / 2
"""Its multiples modulo 1 are as different from each other as can be, and the same on every run."""

REFRESH = 100
"""B^-1 is computed afresh after this many updates, before their rounding errors show."""

EXCHANGES = 20
"""Cap, times n + 10, on the exchanges of a descent: then the certificate judges what there is."""

CLOSE = 192
"""About as many rows, and n more, are left to a vertex: an exchange hardly slows down until a few hundred."""

VIOLATION, FIT = 0, 1  # the two costs, in lexicographic order


class Vertex:
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
        self.put(new, side_of(value, rows["side"]))

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
        wrong = self._on_hardside_of()
        return float(np.abs(self.value[wrong]).max()) if wrong.size else 0.0

    def _on_hardside_of(self) -> Indices:
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
            blocked = self._on_hardside_of()
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


def side_of(value: Array, side: Array) -> Array:
    """The side of each row, read off its value where that is clear; an active row stays so."""
    return np.where((np.abs(value) > ZERO) & (side != 0), np.sign(value), side)
