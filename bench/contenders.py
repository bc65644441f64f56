"""The contenders: each updates the program for w or solves it from scratch, as a competent user would write it.

All contenders get the same groups of two rows: a moment row a, whose |a . w| is minimised, and a hard row b . w >= 0.

Primal form: variables w, and u, v >= 0 with a . w - u + v = 0; minimise sum(u + v). A new observation is two rows.
Dual form:   variables t, -1 <= y <= 1 and z >= 0; maximise t under A'y - B'z >= t. A new observation is two columns, and w is
the vector of multipliers of the n rows.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Protocol

import cvxpy
import highspy
import numpy as np
import osqp
from scipy import optimize, sparse

from pushfric_core import ConstraintRows, Status
from pushfric_core.geometry.planar import Array
from pushfric_core.solvers.simplex import Simplex

SOLVE_TIMEOUT = 120.0
"""Solvers give up after this wall-clock time [s]. It is this long because a busy machine gives them only part of it."""

EXACT = 1e-9
"""Feasibility tolerance given to HiGHS: its default, 1e-7, is coarse compared with objectives of some 0.01 m."""

Groups = Sequence[ConstraintRows]


class NoOptimum(Exception):
    """A solve ended without an optimum."""


class OutOfTime(Exception):
    """A solve took longer than SOLVE_TIMEOUT."""


class Contender(Protocol):
    """A way to find the optimum after every observation."""

    def __init__(self, n: int, capacity: int) -> None:
        """Prepare for n support points and at most `capacity` observations."""

    def load(self, groups: Groups) -> None:
        """Add many observations at once and find the optimum."""

    def update(self, rows: ConstraintRows) -> None:
        """Add one observation and find the optimum. This is what is timed; reading w from a peer's solver is not."""

    def objective(self) -> float:
        """F at the last optimum [m]."""


class Pushfric:
    """The project's own solver."""

    def __init__(self, n: int, capacity: int) -> None:
        self._simplex = Simplex(n)
        self._optimum = self._simplex.solve()

    def load(self, groups: Groups) -> None:
        """As in live use: solve after each observation."""
        for rows in groups:
            self.update(rows)

    def update(self, rows: ConstraintRows) -> None:
        self._simplex.add(rows)
        self._optimum = self._simplex.solve()

    def objective(self) -> float:
        if self._optimum.status is not Status.OPTIMAL:
            raise NoOptimum(f"the result is {self._optimum.status.value}")
        return self._optimum.objective


class _Highs(ABC):
    """HiGHS with its simplex method, which starts from the last basis."""

    def __init__(self, n: int, capacity: int) -> None:
        self._n, self._columns = n, np.arange(n, dtype=np.int32)
        self._highs = highspy.Highs()
        options: dict[str, bool | int | float | str] = {
            "output_flag": False,
            "solver": "simplex",
            "simplex_strategy": 1,  # dual: in both forms a new observation leaves the basis dual feasible
            "presolve": "off",  # presolve would start from scratch
            "parallel": "off",
            "threads": 1,
            "primal_feasibility_tolerance": EXACT,
            "dual_feasibility_tolerance": EXACT,
        }
        for option, value in options.items():
            self._highs.setOptionValue(option, value)

    def load(self, groups: Groups) -> None:
        self._add(groups)
        self._highs.setOptionValue("time_limit", SOLVE_TIMEOUT)
        self._highs.run()
        self.objective()
        self._highs.setOptionValue("time_limit", math.inf)

    def update(self, rows: ConstraintRows) -> None:
        self._add([rows])
        self._highs.run()

    def objective(self) -> float:
        status = self._highs.getModelStatus()
        if status == highspy.HighsModelStatus.kTimeLimit:
            raise OutOfTime
        if status != highspy.HighsModelStatus.kOptimal:
            raise NoOptimum(self._highs.modelStatusToString(status))
        return abs(self._highs.getObjectiveValue())

    @abstractmethod
    def _add(self, groups: Groups) -> None:
        """Give the observations to HiGHS, in this form of the program."""


class HighsPrimal(_Highs):
    """Adds rows."""

    def __init__(self, n: int, capacity: int) -> None:
        super().__init__(n, capacity)
        self._width = n
        self._add_columns(0.0, n)
        self._highs.addRow(1.0, 1.0, n, self._columns, np.ones(n))

    def _add(self, groups: Groups) -> None:
        n, m = self._n, len(groups)
        self._add_columns(1.0, 2 * m)
        values, columns = np.empty((m, 2 * n + 2)), np.empty((m, 2 * n + 2), np.int32)
        coefficients = np.stack([rows.a for rows in groups])
        values[:, :n], values[:, n:-n], values[:, -n:] = coefficients[:, 0], (-1.0, 1.0), coefficients[:, 1]
        columns[:, :n] = columns[:, -n:] = self._columns
        columns[:, n:-n] = self._width + np.arange(2 * m).reshape(m, 2)
        starts = (np.arange(m)[:, None] * (2 * n + 2) + (0, n + 2)).ravel().astype(np.int32)
        upper = np.tile((0.0, math.inf), m)
        self._highs.addRows(2 * m, np.zeros(2 * m), upper, values.size, starts, columns.ravel(), values.ravel())
        self._width += 2 * m

    def _add_columns(self, cost: float, count: int) -> None:
        none = np.zeros(0, np.int32)
        starts, upper = np.zeros(count, np.int32), np.full(count, math.inf)
        self._highs.addCols(count, np.full(count, cost), np.zeros(count), upper, 0, starts, none, np.zeros(0))


class HighsDual(_Highs):
    """Adds columns; the basis stays as small as n."""

    def __init__(self, n: int, capacity: int) -> None:
        super().__init__(n, capacity)
        none = np.zeros(0, np.int32)
        self._highs.addRows(n, np.zeros(n), np.full(n, math.inf), 0, np.zeros(n, np.int32), none, np.zeros(0))
        self._highs.addCol(-1.0, -math.inf, math.inf, n, self._columns, -np.ones(n))

    def _add(self, groups: Groups) -> None:
        n, m = self._n, len(groups)
        values = np.concatenate([rows.a for rows in groups]) * np.tile(((1.0,), (-1.0,)), (m, 1))
        starts = np.arange(0, 2 * m * n, n, dtype=np.int32)
        lower, upper = np.tile((-1.0, 0.0), m), np.tile((1.0, math.inf), m)
        columns = np.tile(self._columns, 2 * m)
        self._highs.addCols(2 * m, np.zeros(2 * m), lower, upper, values.size, starts, columns, values.ravel())


class _FromScratch(ABC):
    """Keeps the coefficients in arrays, and solves the whole program each time."""

    def __init__(self, n: int, capacity: int) -> None:
        self._room, self._count = np.empty((2, capacity, n)), 0
        self._objective = math.nan

    def load(self, groups: Groups) -> None:
        for rows in groups:
            self._append(rows)

    def update(self, rows: ConstraintRows) -> None:
        self._append(rows)
        self._objective = self._solve(*self._room[:, : self._count])

    def objective(self) -> float:
        return self._objective

    def _append(self, rows: ConstraintRows) -> None:
        self._room[:, self._count] = rows.a
        self._count += 1

    @abstractmethod
    def _solve(self, a: Array, b: Array) -> float:
        """The objective, from this form of the program."""


class LinprogPrimal(_FromScratch):
    """scipy.optimize.linprog, on sparse matrices."""

    def _solve(self, a: Array, b: Array) -> float:
        m, n = a.shape
        one = sparse.eye_array(m, format="csc")
        ones = sparse.csc_array(np.ones((1, n)))
        return _linprog(
            np.concatenate((np.zeros(n), np.ones(2 * m))),
            A_eq=sparse.block_array([[sparse.csc_array(a), -one, one], [ones, None, None]], format="csc"),
            b_eq=np.append(np.zeros(m), 1.0),
            A_ub=sparse.hstack((sparse.csc_array(-b), sparse.csc_array((m, 2 * m))), format="csc"),
            b_ub=np.zeros(m),
        )


class LinprogDual(_FromScratch):
    """scipy.optimize.linprog, for a user who thinks of the dual."""

    def _solve(self, a: Array, b: Array) -> float:
        m, n = a.shape
        bounds = np.repeat(((-math.inf, math.inf), (-1.0, 1.0), (0.0, math.inf)), (1, m, m), axis=0)
        costs = np.concatenate(((-1.0,), np.zeros(2 * m)))
        return -_linprog(costs, A_ub=np.hstack((np.ones((n, 1)), -a.T, b.T)), b_ub=np.zeros(n), bounds=bounds)


def _linprog(costs: Array, **program) -> float:
    options = {"time_limit": SOLVE_TIMEOUT, "primal_feasibility_tolerance": EXACT, "dual_feasibility_tolerance": EXACT}
    result = optimize.linprog(costs, method="highs", options=options, **program)
    if result.status == 1:
        raise OutOfTime
    if result.status != 0:
        raise NoOptimum(result.message)
    return float(result.fun)


class Cvxpy(_FromScratch):
    """CVXPY with the program as its manual would write it, and with the solver that it chooses."""

    def _solve(self, a: Array, b: Array) -> float:
        w = cvxpy.Variable(a.shape[1])
        problem = cvxpy.Problem(cvxpy.Minimize(cvxpy.norm1(a @ w)), [w >= 0, cvxpy.sum(w) == 1, b @ w >= 0])
        problem.solve()
        if problem.status != cvxpy.OPTIMAL:
            raise NoOptimum(problem.status)
        return float(problem.value)


class Osqp:
    """OSQP on the dual form; on the primal form it often ends at its iteration limit.

    The program cannot grow, so columns of zeros, bounded to zero, are held in reserve, and a new observation fills two of them.
    """

    def __init__(self, n: int, capacity: int) -> None:
        self._n, self._count = n, 0
        width = 2 * capacity
        # column of t: n entries; the others: n entries, and a one in the row of their bounds
        self._values = np.zeros(n + width * (n + 1))
        self._values[:n] = -1.0
        self._columns = self._values[n:].reshape(capacity, 2, n + 1)
        self._columns[..., n] = 1.0
        self._lower = np.zeros(n + width)
        self._upper = np.concatenate((np.full(n, math.inf), np.zeros(width)))
        self._solver = osqp.OSQP()
        self._w = np.full(n, 1 / n)

    def load(self, groups: Groups) -> None:
        for rows in groups:
            self._append(rows)
        n, width = self._n, 2 * len(self._columns)
        entries = np.concatenate((np.tile(np.arange(n), (width, 1)), n + np.arange(width)[:, None]), axis=1)
        rows_of = np.concatenate((np.arange(n), entries.ravel()))
        starts = np.concatenate(((0,), n + np.arange(width + 1) * (n + 1)))
        costs = np.zeros(1 + width)
        costs[0] = -1.0
        matrix = sparse.csc_matrix((self._values, rows_of, starts), shape=(n + width, 1 + width))
        none = sparse.csc_matrix((1 + width, 1 + width))
        self._solver.setup(none, costs, matrix, self._lower, self._upper, verbose=False, time_limit=SOLVE_TIMEOUT)
        self._solve()

    def update(self, rows: ConstraintRows) -> None:
        first = self._n + self._count * 2 * (self._n + 1)
        self._append(rows)
        changed = np.arange(first, first + 2 * (self._n + 1))
        self._solver.update(Ax=self._values[changed], Ax_idx=changed, l=self._lower, u=self._upper)
        self._solve()

    def objective(self) -> float:
        """F at the point of the simplex nearest to w [m]."""
        w = np.maximum(self._w, 0.0)
        return float(np.abs(self._columns[: self._count, 0, :-1] @ w).sum() / w.sum())

    def _append(self, rows: ConstraintRows) -> None:
        self._columns[self._count, :, :-1] = rows.a * ((1.0,), (-1.0,))
        bounds = self._n + 2 * self._count
        self._lower[bounds] = -1.0
        self._upper[bounds : bounds + 2] = 1.0, math.inf
        self._count += 1

    def _solve(self) -> None:
        result = self._solver.solve(raise_error=False)
        if result.info.status == "run time limit reached":
            raise OutOfTime
        self._w = -result.y[: self._n]


CONTENDERS: dict[str, type[Contender]] = {
    "pushfric": Pushfric,
    "highs_primal": HighsPrimal,
    "highs_dual": HighsDual,
    "linprog": LinprogPrimal,
    "linprog_dual": LinprogDual,
    "osqp": Osqp,
    "cvxpy": Cvxpy,
}

APPROXIMATE = ("osqp",)
"""Contenders whose objective need not be the exact optimum."""
