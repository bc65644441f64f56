"""What OSQP solves: the program for w once more, its least-squares form (section 6.1), and the tie-break between its optima.

OSQP is a first-order method for quadratic programs. It finds which w_j vanish and which rows are active; with that known, the
optimum is the solution of a linear system, after a few exchanges where OSQP stopped too early. On a linear program it stays
approximate. What comes out is judged by certificates that do not rely on OSQP.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import osqp
from scipy import sparse

from pushfric_core.constraints import ConstraintRows
from pushfric_core.planar import Array
from pushfric_core.solvers.program import HARD_VIOLATION, NOISELESS, RELATIVE_GAP, Solution, Status, certify, fit_error
from pushfric_core.solvers.simplex import Optimum

Indices = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]

LINEAR = {"eps_abs": 1e-4, "eps_rel": 1e-4, "max_iter": 2000, "polishing": True, "verbose": False}
"""Leaves gaps of some thousandths of F, unless its own polish succeeds; a smaller tolerance is not worth its time."""

QUADRATIC = {"eps_abs": 1e-6, "eps_rel": 1e-6, "max_iter": 4000, "verbose": False}
"""Enough to tell what is zero from what is not."""

SPARE = 64
"""Columns at first; they double whenever there are too few."""

RIDGE = 1e-10
"""Makes a linear system without a unique solution regular; refinement takes its effect out again."""

REFINEMENTS = 4

PROXIMITY = 1e-6
"""Weight of |w - start|^2 / 2 beside the largest curvature, where many w are nearly as good and pivoting does not end."""

PIVOTS = 30
"""Cap on the exchanges of active conditions."""

PATIENCE = 3
"""Exchanges of all wrong conditions at once that may fail to reduce their number; from then on, one at a time."""

RENEWED = 1e-3
"""H is summed up anew when its trace falls to this part of its largest: its rounding errors stay below 1e-13 of it."""

ROUNDS = 20
"""Cap on the descents of a solve, and on the halvings of a step."""

ZERO = 1e-13
"""Weights, rows and multipliers this far on their wrong side are rounding."""

VIOLATED = HARD_VIOLATION / 4
"""A hard row is violated beyond this: well within what the certificate allows."""

RANK = 1e-11
"""Singular values below this, as a fraction of the largest, are zero."""

STRICT = 1e-9
"""Multipliers and sums of them this far from a bound, as a fraction of the largest, are at it."""


class OsqpLinearProgram:
    """Minimises F over the weights of n support points by OSQP, approximately; the calls are those of `simplex.Simplex`.

    OSQP gets the dual, where a new row is a new column: it is filled into one of those in reserve, and all iterates remain.

    Args:
        n: number of support points.
    Raises:
        ValueError: n < 1.
    """

    def __init__(self, n: int) -> None:
        self._n = _at_least_one(n)
        self._table = _Table(n + 2)  # a, above, below
        self._groups = 0
        self._present: set[int] = set()
        self._dual: _Dual | None = None
        self._conflicts: list[int] = []

    def add(self, rows: ConstraintRows) -> None:
        """Append the rows of one data point; they become group 0, 1, 2... in order of arrival.

        Raises:
            ValueError: shapes that do not fit, coefficients that are not finite, costs that are negative or NaN.
        """
        _check(rows, self._n)
        self._table.append(np.column_stack(rows), self._groups)
        self._present.add(self._groups)
        self._groups += 1

    def remove(self, group: int) -> None:
        """Take the rows of one data point out again; OSQP starts afresh.

        Raises:
            ValueError: there is no such group, or it was removed before.
        """
        if group not in self._present:
            raise ValueError(f"there is no group {group} to remove")
        self._present.remove(group)
        self._table.remove(group)
        self._dual = None

    def solve(self) -> Optimum:
        """The w found, and how far it may be from the optimum: as a rule UNCERTIFIED.

        O(M n) for each iteration of OSQP, of which there are hundreds.
        """
        n, table = self._n, self._table.rows
        rows = ConstraintRows(table[:, :n], table[:, n], table[:, n + 1])
        if self._dual is None or len(table) > self._dual.capacity:
            self._dual = _Dual(n, max(SPARE, 2 * len(table)))
        w, y = self._dual.solve(rows)
        hard, origin = _hard_rows(rows)
        nearest = _minimise(np.eye(n), w, hard, w)
        if nearest is None:
            self._dual = None  # its iterates lead nowhere
            w, status, contradicting = _least_violation(hard)
            self._conflicts = _distinct(self._table.groups[origin[contradicting]])
            objective = fit_error(rows, rows.a @ w)
            return Optimum(w, 0.0, objective, 0.0, objective, status)
        self._conflicts = []
        w, _, _, objective, lower_bound, gap, status = certify(rows, nearest.w, y)
        return Optimum(w, 0.0, objective, lower_bound, gap, status)

    def conflicts(self) -> list[int]:
        """The groups whose hard rows contradict each other; none unless the last optimum is infeasible."""
        return self._conflicts


class LeastSquares:
    """Minimises the sum of squares over the weights of n support points; the calls are those of `simplex.Simplex`.

        F(w) = sum_k above_k * max(a_k . w, 0)^2 + below_k * max(-a_k . w, 0)^2   over   w >= 0, sum w = 1

    That is the estimate for Gaussian errors, as the sum of magnitudes is for errors of distribution e^-|z| (section 6.1), and
    the least squares of section 7 without its negative w. An infinite cost makes a side hard, here too. F has the unit of a
    cost times that of a . w squared.

    F is w' H w while no row changes sides, H = sum_k c_k a_k a_k', (n, n). A row with one cost for both sides adds to H once,
    so the cost of a data point does not depend on the number of such rows before it. Of the others, a descent looks at all,
    O(M n), and keeps in H what they cost on the side they are on. It minimises w' H w (Newton's method), and is halved until F
    falls, as it must in the end: F is convex and starts with this slope. Hard rows constrain a descent once it turns out to
    violate them.

    Args:
        n: number of support points.
    Raises:
        ValueError: n < 1.
    """

    def __init__(self, n: int) -> None:
        self._n = _at_least_one(n)
        self._even = _Table(n + 1)  # a, cost: the same on both sides
        self._uneven = _Table(n + 2)  # a, above, below
        self._equal, self._low = _Table(n), _Table(n)
        self._groups = 0
        self._present: set[int] = set()
        self._even_hessian = np.zeros((n, n))
        self._uneven_hessian = np.zeros((n, n))
        self._counted = np.zeros(0)  # cost with which each uneven row is in it
        self._largest = 0.0  # that its trace was: what came and went leaves rounding errors of that size
        self._w = np.full(n, 1 / n)
        self._conflicts: list[int] = []

    def add(self, rows: ConstraintRows) -> None:
        """Append the rows of one data point; they become group 0, 1, 2... in order of arrival.

        Raises:
            ValueError: shapes that do not fit, coefficients that are not finite, costs that are negative or NaN.
        """
        _check(rows, self._n)
        above, below = _finite(rows.above), _finite(rows.below)
        even = above == below
        self._even.append(np.column_stack((rows.a, above))[even], self._groups)
        self._even_hessian += _gram(rows.a[even], above[even])
        self._uneven.append(np.column_stack((rows.a, above, below))[~even], self._groups)
        hard, _ = _hard_rows(rows)
        self._equal.append(hard.equal, self._groups)
        self._low.append(hard.low, self._groups)
        self._present.add(self._groups)
        self._groups += 1

    def remove(self, group: int) -> None:
        """Take the rows of one data point out again. O(M n^2): H is summed up anew, as subtraction would leave rounding errors.

        Raises:
            ValueError: there is no such group, or it was removed before.
        """
        if group not in self._present:
            raise ValueError(f"there is no group {group} to remove")
        self._present.remove(group)
        for table in (self._even, self._uneven, self._equal, self._low):
            table.remove(group)
        self._even_hessian = _gram(self._even.rows[:, :-1], self._even.rows[:, -1])
        self._uneven_hessian[:] = 0.0
        self._counted, self._largest = np.zeros(0), 0.0

    def solve(self) -> Optimum:
        """The optimum over the present rows, from the last one."""
        self._conflicts = []
        hard = _Hard(self._equal.rows, self._low.rows)
        for _ in range(ROUNDS):
            start, hessian = self._w, self._hessian(self._w)
            found = _minimise(hessian, np.zeros(self._n), hard, start)
            if found is None:
                return self._infeasible(hard)
            self._w = self._descend(hessian, start, found.w) if hard.allows(start) else found.w
            optimum = self._judge(found.reaction)
            if optimum.status is Status.OPTIMAL:
                break
        return optimum

    def conflicts(self) -> list[int]:
        """The groups whose hard rows contradict each other; none unless the last optimum is infeasible."""
        return self._conflicts

    def _hessian(self, w: Array) -> Array:
        """H at w, where F is w' H w."""
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

        The reaction is nonnegative at any v that meets the hard rows: half of g may be reduced by it.
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

    def _infeasible(self, hard: "_Hard") -> Optimum:
        self._w, status, contradicting = _least_violation(hard)
        self._conflicts = _distinct(np.concatenate((self._equal.groups, self._low.groups))[contradicting])
        objective = max(0.0, float(self._w @ self._hessian(self._w) @ self._w))
        return Optimum(self._w, 0.0, objective, 0.0, objective, status)


def nearest_uniform(rows: ConstraintRows, solution: Solution) -> Solution:
    """Of all optimal w of a linear program, the one nearest to equal weights; O(M n), and some O(n^3).

    By complementary slackness with any optimal multipliers y, w is optimal where a . w = 0 in the rows with y inside its box,
    on the side of y in the others, and w_j = 0 where (A' y)_j is above its minimum.

    Args:
        rows: the program.
        solution: an optimal w of it and its multipliers.
    Returns:
        The optimum found, certified; `solution` itself where there is no other, or where the one found cannot be certified.
    Raises:
        ValueError: solution is not optimal.
    """
    if solution.status is not Status.OPTIMAL:
        raise ValueError(f"solution must be optimal, got {solution.status.value}")
    y, (a, above, below) = solution.multipliers, rows
    reduced = y @ a
    support = (solution.w > 0) | (reduced - reduced.min() <= STRICT * np.abs(reduced).max(initial=0.0))
    margin = STRICT * np.abs(y).max(initial=0.0)
    high, low = y >= above - margin, y <= margin - below
    a = a[:, support]
    seen = a.any(axis=1)  # a row of zeros is met by every such w
    a, high, low = _unit_rows(a[seen]), high[seen], low[seen]
    face = _Hard(_row_space(a[~high & ~low]), np.concatenate((a[high & ~low], -a[low & ~high])))
    n, free = len(support), int(support.sum())
    if len(_row_space(np.vstack((face.equal, np.ones(free))))) == free:
        return solution
    nearest = _minimise(np.eye(free), np.full(free, 1 / n), face, solution.w[support])
    if nearest is None:
        return solution
    w = np.zeros(n)
    w[support] = nearest.w
    certified = certify(rows, w, y)
    return certified if certified.status is Status.OPTIMAL else solution


class _Hard(NamedTuple):
    """Rows of largest coefficient 1 with equal @ w = 0, low @ w >= 0."""

    equal: Array
    low: Array

    @property
    def stacked(self) -> Array:
        return np.concatenate(self)

    def allows(self, w: Array) -> bool:
        return bool(np.all(np.abs(self.equal @ w) <= VIOLATED) and np.all(self.low @ w >= -VIOLATED))


class _Minimum(NamedTuple):
    w: Array
    reaction: Array  # (n,) sum of the hard rows, each times its multiplier


class _Table:
    """Rows of numbers, each of a group, with room to grow."""

    def __init__(self, columns: int) -> None:
        self._room = np.empty((SPARE, columns))
        self._groups = np.empty(SPARE, int)
        self._count = 0

    @property
    def rows(self) -> Array:
        return self._room[: self._count]

    @property
    def groups(self) -> Indices:
        return self._groups[: self._count]

    def append(self, rows: Array, group: int) -> None:
        first, self._count = self._count, self._count + len(rows)
        if self._count > len(self._room):
            self._room = np.concatenate((self._room[:first], np.empty((self._count, self._room.shape[1]))))
            self._groups = np.concatenate((self._groups[:first], np.empty(self._count, int)))
        self._room[first : self._count] = rows
        self._groups[first : self._count] = group

    def remove(self, group: int) -> None:
        kept = self.groups != group
        rows, groups = self.rows[kept], self.groups[kept]
        self._count = len(rows)
        self._room[: self._count], self._groups[: self._count] = rows, groups


class _Dual:
    """OSQP's copy of a linear program: maximise t over A' y >= t, -below <= y <= above; the multipliers of A' y >= t are w.

    In units in which coefficients and costs are about one.
    """

    def __init__(self, n: int, capacity: int) -> None:
        self.capacity = capacity
        self._n, self._count = n, 0
        self._unit = np.ones(capacity)  # y = unit times the variable
        self._scale = 0.0
        self._bounds = np.zeros((2, n + capacity))
        self._bounds[1, :n] = np.inf
        self._solver = osqp.OSQP()

    def solve(self, rows: ConstraintRows) -> tuple[Array, Array]:
        """Approximate w and y; not even that where OSQP gave up."""
        first, self._count = self._count, len(rows.a)
        values = self._columns(ConstraintRows(*(part[first:] for part in rows)), first)
        if first == 0:
            self._set_up(values)
        elif len(values):
            n, low_high = self._n, self._bounds
            slots = (np.arange(first, self._count)[:, None] * (n + 1) + np.arange(n)).ravel()
            self._solver.update(Ax=values.ravel(), Ax_idx=slots.astype(np.int32), l=low_high[0], u=low_high[1])
        result = self._solver.solve(raise_error=False)
        w, y = -result.y[: self._n], result.x[: self._count] * self._unit[: self._count]
        if not (np.isfinite(w).all() and np.isfinite(y).all() and w.max() > 0):
            return np.full(self._n, 1 / self._n), np.zeros(self._count)
        return w, y

    def _columns(self, rows: ConstraintRows, first: int) -> Array:
        """The new rows in OSQP's units; their bounds are entered."""
        peak = np.abs(rows.a).max(axis=1, initial=0.0)
        cost = np.maximum(_finite(rows.above), _finite(rows.below))
        self._scale = self._scale or float((cost * peak).max(initial=0.0)) or float(peak.max(initial=0.0)) or 1.0
        unit = np.where(cost > 0, cost, self._scale / np.where(peak > 0, peak, 1.0))
        self._unit[first : self._count] = unit
        self._bounds[:, self._n + first : self._n + self._count] = -rows.below / unit, rows.above / unit
        return rows.a * unit[:, None] / self._scale

    def _set_up(self, values: Array) -> None:
        n, capacity = self._n, self.capacity
        columns = np.zeros((capacity, n + 1))
        columns[: len(values), :n], columns[:, n] = values, 1.0
        places = np.tile(np.arange(n + 1), (capacity, 1))
        places[:, n] += np.arange(capacity)
        data, indices = np.append(columns, -np.ones(n)), np.append(places, np.arange(n))
        starts = np.append(np.arange(capacity + 1) * (n + 1), capacity * (n + 1) + n)
        matrix = sparse.csc_matrix((data, indices, starts), shape=(n + capacity, capacity + 1))
        objective = np.append(np.zeros(capacity), -1.0)
        nothing = sparse.csc_matrix((capacity + 1, capacity + 1))
        self._solver.setup(nothing, objective, matrix, *self._bounds, **LINEAR)


def _minimise(hessian: Array, linear: Array, hard: _Hard, start: Array) -> _Minimum | None:
    """min w' H w / 2 - linear . w over the simplex and the hard rows; None where these could not be met.

    The conditions active at `start` are tried first, then those that OSQP finds, and the point they lead to is approached by
    proximal steps until its own do. Inactive hard rows join when they are violated.
    """
    scale = float(hessian.diagonal().max()) or 1.0
    hessian, linear = hessian / scale, linear / scale
    found, asked = _Minimum(start, np.zeros(len(start))), False
    free, active = start > 0, hard.low @ start <= ZERO
    chosen = np.flatnonzero(active)
    for _ in range(ROUNDS):
        part = _Hard(hard.equal, hard.low[chosen])
        exact = nearby = _pivot(hessian, linear, part, free, active[chosen], start)
        if nearby is None:
            if not asked:
                start, free, active[chosen] = _approximate(hessian, linear, part)
                asked = True
            proximal = hessian + PROXIMITY * np.eye(len(start))
            nearby = _pivot(proximal, linear + PROXIMITY * start, part, free, active[chosen], start)
        if nearby is None:
            break
        start, free = nearby.w, nearby.w > 0
        found = _Minimum(start, scale * nearby.reaction)
        value = hard.low @ start
        active[chosen] = value[chosen] <= ZERO
        value[chosen] = 0.0
        worst = np.argsort(value)[: len(start)]
        worst = worst[value[worst] < -VIOLATED]
        if exact is not None and not worst.size:
            break
        active[worst] = True
        chosen = np.append(chosen, worst)
    return found if hard.allows(found.w) else None


def _pivot(hessian: Array, linear: Array, hard: _Hard, free: Mask, active: Mask, start: Array) -> _Minimum | None:
    """Block principal pivoting: solve with the w_j not in `free` zero and the low rows in `active` met, exchange what is wrong.

    Of optimal w, one near `start`. None where that does not end.
    """
    n, equal = len(start), len(hard.equal)
    free, active = free.copy(), active.copy()
    fewest, patience = 2 * (n + len(active)), PATIENCE
    for _ in range(PIVOTS):
        if not free.any():
            free[:] = True
        conditions = np.concatenate((np.ones((1, n)), hard.equal, hard.low[active]))
        x, dual = _stationary(hessian, linear, conditions, free, start)
        w = np.zeros(n)
        w[free] = x
        reduced = hessian @ w - linear - dual @ conditions
        multipliers = np.zeros(len(active))
        multipliers[active] = dual[1 + equal :]
        wrong = np.concatenate((np.where(free, w, reduced), np.where(active, multipliers, hard.low @ w))) < -ZERO
        count = int(wrong.sum())
        if not count:
            w = np.maximum(w, 0.0)
            w /= w.sum()
            # of the right sign, or they prove nothing
            reaction = dual[1 : 1 + equal] @ hard.equal + np.maximum(multipliers, 0.0) @ hard.low
            return _Minimum(w, reaction) if hard.allows(w) else None
        if count < fewest:
            fewest, patience = count, PATIENCE
        elif patience:
            patience -= 1
        else:
            wrong[: np.flatnonzero(wrong)[-1]] = False
        free ^= wrong[:n]
        active ^= wrong[n:]
    return None


def _stationary(hessian: Array, linear: Array, conditions: Array, free: Mask, start: Array) -> tuple[Array, Array]:
    """The free w where the gradient is a combination of the conditions, the first of them sum w = 1; and its coefficients."""
    size, rest = int(free.sum()), len(conditions)
    matrix = np.zeros((size + rest, size + rest))
    matrix[:size, :size] = hessian[np.ix_(free, free)]
    matrix[size:, :size] = conditions[:, free]
    matrix[:size, size:] = conditions[:, free].T
    target = np.concatenate((linear[free], np.ones(1), np.zeros(rest - 1)))
    inverse = np.linalg.inv(matrix + np.diag(np.repeat((RIDGE, -RIDGE), (size, rest))))
    x = np.concatenate((start[free], np.zeros(rest)))
    for _ in range(REFINEMENTS):
        x += inverse @ (target - matrix @ x)
    return x[:size], -x[size:]


def _approximate(hessian: Array, linear: Array, hard: _Hard) -> tuple[Array, Mask, Mask]:
    """What OSQP makes of it: w, which of them are not zero, and which low rows are active."""
    n, equal = len(linear), len(hard.equal)
    conditions = np.concatenate((np.ones((1, n)), hard.equal, np.eye(n), hard.low))
    low = np.zeros(len(conditions))
    high = np.full(len(conditions), np.inf)
    low[0] = high[0] = 1.0
    high[1 : 1 + equal] = 0.0
    solver = osqp.OSQP()
    # convex whatever the rounding
    hessian = hessian + RIDGE * np.eye(n)
    solver.setup(sparse.triu(hessian, format="csc"), -linear, sparse.csc_matrix(conditions), low, high, **QUADRATIC)
    result = solver.solve(raise_error=False)
    w = np.nan_to_num(result.x)
    # as OSQP's own polish tells: a condition is active where its multiplier exceeds its value
    active = (conditions @ w < -np.nan_to_num(result.y))[1 + equal :]
    w = np.maximum(w, 0.0)
    w = w / w.sum() if w.any() else np.full(n, 1 / n)
    return w, ~active[:n], active[n:]


def _least_violation(hard: _Hard) -> tuple[Array, Status, Indices]:
    """The w that violates the hard rows least, in squares; INFEASIBLE, and the rows at fault, if no w meets them.

    Weighted with their violations, these rows add up to one that every w violates (Farkas).
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


def _hard_rows(rows: ConstraintRows) -> tuple[_Hard, Indices]:
    """The hard sides, and the row that each comes from, stacked."""
    a, above, below = rows[0], np.isinf(rows.above), np.isinf(rows.below)
    nonzero = a.any(axis=1)
    equal, low, high = (np.flatnonzero(nonzero & side) for side in (above & below, below & ~above, above & ~below))
    hard = _Hard(_unit_rows(a[equal]), _unit_rows(np.concatenate((a[low], -a[high]))))
    return hard, np.concatenate((equal, low, high))


def _unit_rows(a: Array) -> Array:
    """Scaled to a largest coefficient of 1; rows of zeros are left out."""
    peak = np.abs(a).max(axis=1, initial=0.0)
    return np.asarray(a[peak > 0] / peak[peak > 0, None])


def _row_space(a: Array) -> Array:
    """An orthonormal basis of what the rows span."""
    if not len(a):
        return a
    _, singular, basis = np.linalg.svd(np.linalg.qr(a, mode="r"))
    return np.asarray(basis[: int((singular > RANK * singular[0]).sum())])


def _gram(a: Array, cost: Array) -> Array:
    return np.asarray((a.T * cost) @ a)


def _finite(costs: Array) -> Array:
    return np.where(np.isinf(costs), 0.0, costs)


def _distinct(groups: Indices) -> list[int]:
    return [int(group) for group in np.unique(groups)]


def _at_least_one(n: int) -> int:
    if n < 1:
        raise ValueError(f"n must be at least 1, got {n}")
    return n


def _check(rows: ConstraintRows, n: int) -> None:
    a, above, below = rows
    m = len(above)
    if a.shape != (m, n) or below.shape != (m,):
        raise ValueError(f"rows must have shapes (m, {n}), (m,), (m,), got {a.shape}, {above.shape}, {below.shape}")
    if not np.isfinite(a).all():
        raise ValueError("the coefficients of the rows must be finite")
    if not np.minimum(above, below).min(initial=0.0) >= 0:
        raise ValueError("the costs of the rows must not be negative or NaN")
