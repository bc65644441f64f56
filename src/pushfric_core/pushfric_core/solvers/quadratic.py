"""The least-squares form of the program for w (section 6.1)."""

import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.planar import Array
from pushfric_core.program.constraint_rows import ConstraintRows
from pushfric_core.program.row_table import RowTable
from pushfric_core.solvers.active_set import ROUNDS, VIOLATED, ZERO, HardRows, hard_rows, minimise
from pushfric_core.solvers.program import (
    HARD_VIOLATION,
    NOISELESS,
    RELATIVE_GAP,
    Groups,
    Optimum,
    Program,
    Status,
    check_rows,
    check_size,
    finite,
)

Indices = npt.NDArray[np.intp]

RENEWED = 1e-3
"""H is summed up again when its trace falls to this fraction of its largest, so that rounding errors stay below 1e-13 of it."""


class LeastSquares(Program):
    """Minimises the sum of squares over the weights of n support points: a `Program`.

        F(w) = sum_k above_k * max(a_k . w, 0)^2 + below_k * max(-a_k . w, 0)^2   over   w >= 0, sum w = 1

    That is the estimate for Gaussian errors, as the sum of magnitudes is for errors of distribution e^-|z| (section 6.1), and
    the least squares of section 7 without its negative w. Here, too, an infinite cost makes a side hard. F has the unit of a
    cost times that of a . w squared.

    While no row changes sides, F is w' H w with H = sum_k c_k a_k a_k', (n, n). A row with one cost for both sides adds to H
    once, so the cost of an observation does not depend on the number of such rows before it. A descent looks at all other rows,
    O(M n), and keeps in H what they cost on their present side. It minimises w' H w (Newton's method), and its step is halved
    until F falls. It must fall in the end, because F is convex and starts with this slope. Hard rows constrain a descent once
    it turns out to violate them.

    Args:
        n: number of support points.
    Raises:
        ValueError: n < 1.
    """

    def __init__(self, n: int) -> None:
        self._n = check_size(n)
        self._even = RowTable(n + 1)  # a, cost: the same on both sides
        self._uneven = RowTable(n + 2)  # a, above, below
        self._equal, self._low = RowTable(n), RowTable(n)
        self._groups = Groups()
        self._even_hessian = np.zeros((n, n))
        self._uneven_hessian = np.zeros((n, n))
        self._counted = np.zeros(0)  # cost with which each uneven row is in H
        self._largest = 0.0  # trace that H ever had: rows that came and went leave rounding errors of that size
        self._w = np.full(n, 1 / n)
        self._conflicts: list[int] = []

    def add(self, rows: ConstraintRows) -> None:
        check_rows(rows, self._n)
        above, below = finite(rows.above), finite(rows.below)
        even = above == below
        self._even.append(np.column_stack((rows.a, above))[even], self._groups.next)
        self._even_hessian += _gram(rows.a[even], above[even])
        self._uneven.append(np.column_stack((rows.a, above, below))[~even], self._groups.next)
        hard, _ = hard_rows(rows)
        self._equal.append(hard.equal, self._groups.next)
        self._low.append(hard.low, self._groups.next)
        self._groups.add()

    def remove(self, group: int) -> None:
        """As of a `Program`. O(M n^2): H is summed up again, as subtraction would leave rounding errors."""
        self._groups.remove(group)
        for table in (self._even, self._uneven, self._equal, self._low):
            table.remove(group)
        self._even_hessian = _gram(self._even.rows[:, :-1], self._even.rows[:, -1])
        self._uneven_hessian[:] = 0.0
        self._counted, self._largest = np.zeros(0), 0.0

    def solve(self) -> Optimum:
        """The optimum over the present rows, starting from the last one."""
        self._conflicts = []
        hard = HardRows(self._equal.rows, self._low.rows)
        for _ in range(ROUNDS):
            start, hessian = self._w, self._hessian(self._w)
            found = minimise(hessian, np.zeros(self._n), hard, start)
            if found is None:
                return self._infeasible(hard)
            self._w = self._descend(hessian, start, found.w) if hard.allows(start) else found.w
            optimum = self._judge(found.reaction)
            if optimum.status is Status.OPTIMAL:
                break
        return optimum

    def conflicts(self) -> list[int]:
        return self._conflicts

    def _hessian(self, w: Array) -> Array:
        """H at w, with F = w' H w."""
        rows, n = self._uneven.rows, self._n
        cost = np.where(rows[:, :n] @ w > 0, rows[:, n], rows[:, n + 1])
        change = cost - np.pad(self._counted, (0, len(cost) - len(self._counted)))
        switched = np.flatnonzero(change)
        self._uneven_hessian += _gram(rows[switched, :n], change[switched])
        self._counted = cost
        largest, self._largest = self._largest, max(self._largest, float(self._uneven_hessian.trace()))
        if self._uneven_hessian.trace() < RENEWED * largest:
            self._uneven_hessian = _gram(rows[:, :n], cost)
            self._largest = float(self._uneven_hessian.trace())
        return self._even_hessian + self._uneven_hessian

    def _descend(self, hessian: Array, start: Array, end: Array) -> Array:
        """The end of a step, or of the nearest halving of it that reduces F by a tenth of what the slope promises."""
        rows, step = self._uneven.rows, end - start
        if not len(rows):
            return end
        (value, change), (above, below) = (rows[:, : self._n] @ np.column_stack((start, step))).T, rows[:, self._n :].T
        slope, even = 2 * start @ hessian @ step, self._even_hessian @ step

        def uneven(length: float) -> float:
            residuals = value + length * change
            return float(above @ np.maximum(residuals, 0.0) ** 2 + below @ np.maximum(-residuals, 0.0) ** 2)

        rounding = ZERO * (start @ hessian @ start)
        length, before = 1.0, uneven(0.0)
        for _ in range(ROUNDS):
            if length * even @ (2 * start + length * step) + uneven(length) - before <= 0.1 * length * slope + rounding:
                break
            length /= 2
        return end if length == 1.0 else start + length * step

    def _judge(self, reaction: Array) -> Optimum:
        """F at w, and a bound below it: F is convex, so F(v) >= F(w) + g . (v - w) for any v, g the gradient at w.

        The reaction is nonnegative at any v that meets the hard rows, so half of g may be reduced by it.
        """
        w = self._w
        w.setflags(write=False)
        hessian = self._hessian(w)
        half_gradient = hessian @ w
        objective = max(0.0, float(w @ half_gradient))
        bound = 2 * float((half_gradient - reaction).min()) - objective
        lower_bound = max(0.0, min(bound, objective))
        gap = objective - lower_bound
        worst = float(hessian.diagonal().max())
        optimal = gap <= RELATIVE_GAP * max(objective, NOISELESS * worst)
        return Optimum(w, 0.0, objective, lower_bound, gap, Status.OPTIMAL if optimal else Status.UNCERTIFIED)

    def _infeasible(self, hard: HardRows) -> Optimum:
        self._w, status, contradicting = least_violation(hard)
        self._conflicts = distinct(np.concatenate((self._equal.groups, self._low.groups))[contradicting])
        objective = max(0.0, float(self._w @ self._hessian(self._w) @ self._w))
        return Optimum(self._w, 0.0, objective, 0.0, objective, status)


def least_violation(hard: HardRows) -> tuple[Array, Status, Indices]:
    """The w that violates the hard rows least, in squares; INFEASIBLE, and the rows at fault, if no w meets them.

    Weighted with their violations, the rows at fault add up to a row that every w violates (Farkas).

    Returns:
        w (n,); INFEASIBLE, or UNCERTIFIED if no contradiction is proven; the indices of the rows at fault in `hard.stacked`.
    """
    rows = hard.stacked
    equal = np.arange(len(rows)) < len(hard.equal)
    softened = LeastSquares(rows.shape[1])
    softened.add(ConstraintRows(rows, equal.astype(float), np.ones(len(rows))))
    w = softened.solve().w
    value = rows @ w
    weight = np.where(equal | (value < 0), -value, 0.0)
    weight[np.abs(weight) <= VIOLATED] = 0.0
    if (weight @ rows).max() < -HARD_VIOLATION * np.abs(weight).sum():
        return w, Status.INFEASIBLE, np.flatnonzero(weight)
    return w, Status.UNCERTIFIED, np.arange(0)


def _gram(a: Array, cost: Array) -> Array:
    return np.asarray((a.T * cost) @ a)


def distinct(groups: Indices) -> list[int]:
    """The groups that occur, ascending."""
    return [int(group) for group in np.unique(groups)]
