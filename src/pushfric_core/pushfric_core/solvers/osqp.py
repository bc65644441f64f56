"""The linear program for w, solved approximately by OSQP, a first-order method for quadratic programs; for comparison."""

import numpy as np
import osqp
from scipy import sparse

from pushfric_core.geometry.planar import Array
from pushfric_core.program.constraint_rows import ConstraintRows
from pushfric_core.program.row_table import SPARE, RowTable
from pushfric_core.solvers.active_set import hard_rows, minimise
from pushfric_core.solvers.program import Groups, Optimum, Program, certify, check_rows, check_size, finite, fit_error
from pushfric_core.solvers.quadratic import distinct, least_violation

LINEAR = {"eps_abs": 1e-4, "eps_rel": 1e-4, "max_iter": 2000, "polishing": True, "verbose": False}
"""Tolerance that leaves gaps of some thousandths of F, unless OSQP's polish succeeds; a smaller one is not worth the time."""


class OsqpLinearProgram(Program):
    """Minimises F over the weights of n support points by OSQP, approximately.

    OSQP gets the dual, in which a new row is a new column. The row fills a column in reserve, so all iterates remain valid.

    Args:
        n: number of support points.
    Raises:
        ValueError: n < 1.
    """

    def __init__(self, n: int) -> None:
        self._n = check_size(n)
        self._table = RowTable(n + 2)  # a, above, below
        self._groups = Groups()
        self._dual: _Dual | None = None
        self._conflicts: list[int] = []

    def add(self, rows: ConstraintRows) -> None:
        check_rows(rows, self._n)
        self._table.append(np.column_stack(rows), self._groups.next)
        self._groups.add()

    def remove(self, group: int) -> None:
        self._groups.remove(group)
        self._table.remove(group)
        self._dual = None  # OSQP starts again

    def solve(self) -> Optimum:
        """The w that OSQP finds, and how far it may be from the optimum; the status is usually UNCERTIFIED.

        O(M n) for each iteration of OSQP, of which there are hundreds.
        """
        n, table = self._n, self._table.rows
        rows = ConstraintRows(table[:, :n], table[:, n], table[:, n + 1])
        if self._dual is None or len(table) > self._dual.capacity:
            self._dual = _Dual(n, max(SPARE, 2 * len(table)))
        w, y = self._dual.solve(rows)
        hard, origin = hard_rows(rows)
        nearest = minimise(np.eye(n), w, hard, w)
        if nearest is None:
            self._dual = None  # its iterates are useless
            w, status, contradicting = least_violation(hard)
            self._conflicts = distinct(self._table.groups[origin[contradicting]])
            objective = fit_error(rows, rows.a @ w)
            return Optimum(w, 0.0, objective, 0.0, objective, status)
        self._conflicts = []
        return certify(rows, nearest.w, y).optimum

    def conflicts(self) -> list[int]:
        return self._conflicts


class _Dual:
    """OSQP's copy of a linear program: maximise t over A' y >= t, -below <= y <= above; the multipliers of A' y >= t are w.

    It is in units in which coefficients and costs are about one.
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
        """Approximate w and y, or nothing useful if OSQP gave up."""
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
        cost = np.maximum(finite(rows.above), finite(rows.below))
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
