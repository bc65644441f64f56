"""The contenders: each updates the program for w or solves it from scratch, as a competent user would write it.

All contenders get the same groups of two rows: a moment row a, whose |a . w| is minimised, and a hard row b . w >= 0.

Primal form: variables w, and u, v >= 0 with a . w - u + v = 0; minimise sum(u + v). A new observation is two rows.
Dual form:   variables t, -1 <= y <= 1 and z >= 0; maximise t under A'y - B'z >= t. A new observation is two columns, and w is
the vector of multipliers of the n rows.
"""

import math
from collections.abc import Sequence
from typing import Protocol

import highspy
import numpy as np
from scipy import optimize, sparse

from pushfric_core import ConstraintRows, Status
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


class Highs:
    """HiGHS with its dual simplex method, which starts from the last basis, on the dual form: the basis stays as small as n."""

    def __init__(self, n: int, capacity: int) -> None:
        self._n, self._columns = n, np.arange(n, dtype=np.int32)
        self._highs = highspy.Highs()
        options: dict[str, bool | int | float | str] = {
            "output_flag": False,
            "solver": "simplex",
            "simplex_strategy": 1,  # dual: a new observation leaves the basis dual feasible
            "presolve": "off",  # presolve would start from scratch
            "parallel": "off",
            "threads": 1,
            "primal_feasibility_tolerance": EXACT,
            "dual_feasibility_tolerance": EXACT,
        }
        for option, value in options.items():
            self._highs.setOptionValue(option, value)
        none = np.zeros(0, np.int32)
        self._highs.addRows(n, np.zeros(n), np.full(n, math.inf), 0, np.zeros(n, np.int32), none, np.zeros(0))
        self._highs.addCol(-1.0, -math.inf, math.inf, n, self._columns, -np.ones(n))

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

    def _add(self, groups: Groups) -> None:
        n, m = self._n, len(groups)
        values = np.concatenate([rows.a for rows in groups]) * np.tile(((1.0,), (-1.0,)), (m, 1))
        starts = np.arange(0, 2 * m * n, n, dtype=np.int32)
        lower, upper = np.tile((-1.0, 0.0), m), np.tile((1.0, math.inf), m)
        columns = np.tile(self._columns, 2 * m)
        self._highs.addCols(2 * m, np.zeros(2 * m), lower, upper, values.size, starts, columns, values.ravel())


class Linprog:
    """scipy.optimize.linprog on the primal form, in sparse matrices: the whole program each time."""

    def __init__(self, n: int, capacity: int) -> None:
        self._room, self._count = np.empty((2, capacity, n)), 0
        self._objective = math.nan

    def load(self, groups: Groups) -> None:
        for rows in groups:
            self._room[:, self._count] = rows.a
            self._count += 1

    def update(self, rows: ConstraintRows) -> None:
        self.load([rows])
        a, b = self._room[:, : self._count]
        m, n = a.shape
        one, ones = sparse.eye_array(m, format="csc"), sparse.csc_array(np.ones((1, n)))
        result = optimize.linprog(
            np.concatenate((np.zeros(n), np.ones(2 * m))),
            A_eq=sparse.block_array([[sparse.csc_array(a), -one, one], [ones, None, None]], format="csc"),
            b_eq=np.append(np.zeros(m), 1.0),
            A_ub=sparse.hstack((sparse.csc_array(-b), sparse.csc_array((m, 2 * m))), format="csc"),
            b_ub=np.zeros(m),
            method="highs",
            options={"time_limit": SOLVE_TIMEOUT, "primal_feasibility_tolerance": EXACT, "dual_feasibility_tolerance": EXACT},
        )
        if result.status == 1:
            raise OutOfTime
        if result.status != 0:
            raise NoOptimum(result.message)
        self._objective = float(result.fun)

    def objective(self) -> float:
        return self._objective


CONTENDERS: dict[str, type[Contender]] = {"pushfric": Pushfric, "highs": Highs, "linprog": Linprog}
