"""The program for w by OSQP, a first-order method for quadratic programs: exact enough for least squares, rough for magnitudes.

    minimise  sum_k phi_k(p_k) + phi_k(-q_k)   over   a_k . w = p_k - q_k,   w, p, q >= 0,   sum w = 1

with phi_k as in `program` for the loss l1. For l2, its sides are squared (section 6.1, and the least squares of section 7
without its negative w), which is the estimate for Gaussian errors; then F has the unit of a cost times that of a . w squared.
A side with an infinite cost is hard: its p_k or q_k is zero.
"""

import numpy as np
import osqp
from scipy import sparse

from pushfric_core.geometry.planar import Array, Indices
from pushfric_core.program.constraints import ConstraintRows, stack
from pushfric_core.solvers.active_set import VIOLATED, hard_rows, nearest
from pushfric_core.solvers.program import (
    HARD_VIOLATION,
    NOISELESS,
    Groups,
    Loss,
    Optimum,
    Program,
    Status,
    certify,
    check_rows,
    check_size,
    finite,
    fit_error,
)

SETTINGS = {
    Loss.L1: {"eps_abs": 1e-4, "eps_rel": 1e-4, "max_iter": 2000},  # gaps of some thousandths of F; more is not worth the time
    Loss.L2: {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 20000},
}

LEAST_SQUARES_GAP = 1e-6
"""Least squares are optimal when their gap is within this of F."""


class OsqpProgram(Program):
    """Minimises F over the weights of n support points by OSQP, which is set up again for each solve.

    Args:
        n: number of support points.
        loss: what is minimised.
    Raises:
        ValueError: n < 1.
    """

    def __init__(self, n: int, loss: Loss = Loss.L1) -> None:
        self._n, self._loss = check_size(n), loss
        self._rows: dict[int, ConstraintRows] = {}  # of each group
        self._groups = Groups()
        self._w = np.full(n, 1 / n)
        self._conflicts: list[int] = []

    def add(self, rows: ConstraintRows) -> None:
        check_rows(rows, self._n)
        self._rows[self._groups.next] = ConstraintRows(*map(np.array, rows))
        self._groups.add()

    def remove(self, group: int) -> None:
        self._groups.remove(group)
        del self._rows[group]

    def solve(self) -> Optimum:
        """The w that OSQP finds, and how far it may be from the optimum: with the loss l1, usually UNCERTIFIED."""
        rows = stack([*self._rows.values()], self._n)
        w, y = _solve(rows, self._loss, self._w)
        hard, origin = hard_rows(rows)
        met = nearest(w, hard, w)
        self._conflicts = []
        if met is None:
            self._w, status, at_fault = _least_violation(rows, hard.stacked, origin)
            groups = np.repeat([*self._rows], [len(one.above) for one in self._rows.values()])
            self._conflicts = np.unique(groups[at_fault]).tolist()
            objective = _objective(rows, self._w, self._loss)
            return Optimum(self._w, 0.0, objective, 0.0, objective, status)
        self._w = met
        return certify(rows, met, y).optimum if self._loss is Loss.L1 else _judge(rows, met, y)

    def conflicts(self) -> list[int]:
        return self._conflicts


def _solve(rows: ConstraintRows, loss: Loss, start: Array) -> tuple[Array, Array]:
    """Approximate w and multipliers y of the rows, from a `start` for w; even weights if OSQP gave up."""
    (a, above, below), n = rows, len(start)
    # a row with one finite cost for both sides needs no p and q: its square is one of w
    folded = (above == below) & np.isfinite(above) & (loss is Loss.L2)
    hessian = 2 * (a[folded].T * above[folded]) @ a[folded]
    peak = np.abs(a).max(axis=1, initial=0.0)[~folded]
    unit = np.where(peak > 0, peak, 1.0)  # of p and q
    a, sides = a[~folded] / unit[:, None], np.concatenate((above[~folded], below[~folded]))
    m, cost = len(a), finite(sides) * np.tile(unit**2 if loss is Loss.L2 else unit, 2)
    scale = max(float(hessian.max(initial=0.0)), float(cost.max(initial=0.0))) or 1.0
    hessian, cost = hessian / scale, cost / scale
    quadratic, linear = (2 * cost, 0 * cost) if loss is Loss.L2 else (0 * cost, cost)
    identity = sparse.identity(m)
    conditions = sparse.bmat(
        [
            [np.ones((1, n)), None],
            [sparse.csc_matrix(a), sparse.hstack((-identity, identity))],
            [sparse.identity(n), None],
            [None, sparse.identity(2 * m)],
        ],
        format="csc",
    )
    low = np.concatenate(([1.0], np.zeros(m + n + 2 * m)))
    high = np.concatenate(([1.0], np.zeros(m), np.full(n, np.inf), np.where(np.isinf(sides), 0.0, np.inf)))
    solver = osqp.OSQP()
    solver.setup(
        sparse.block_diag((sparse.triu(hessian), sparse.diags(quadratic)), format="csc"),
        np.concatenate((np.zeros(n), linear)),
        conditions,
        low,
        high,
        polishing=True,
        verbose=False,
        **SETTINGS[loss],
    )
    residuals = a @ start
    solver.warm_start(x=np.concatenate((start, np.maximum(residuals, 0.0), np.maximum(-residuals, 0.0))))
    result = solver.solve(raise_error=False)
    w = np.maximum(np.nan_to_num(result.x[:n]), 0.0)
    y = np.zeros(len(above))
    y[~folded] = scale / unit * np.nan_to_num(result.y[1 : 1 + m])
    return w / w.sum() if w.any() else np.full(n, 1 / n), y


def _objective(rows: ConstraintRows, w: Array, loss: Loss) -> float:
    residuals = rows.a @ w
    return fit_error(rows, residuals if loss is Loss.L1 else residuals * np.abs(residuals))


def _judge(rows: ConstraintRows, w: Array, multipliers: Array) -> Optimum:
    """F at w for the loss l2, and a bound below it from the dual: any y gives min_j (A' y)_j - sum_k y_k^2 / (4 cost_k).

    cost_k is that of the side to which y_k pulls; y_k is zero where that is zero, and free where it is infinite.
    """
    w.setflags(write=False)
    a, above, below = rows
    residuals = a @ w
    y = 2 * finite(np.where(residuals > 0, above, below)) * residuals
    y += np.where(np.isinf(np.where(multipliers > 0, above, below)), multipliers, 0.0)
    costs = np.where(y > 0, above, below)
    y = np.where(costs > 0, y, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        paid = np.where(y == 0, 0.0, y**2 / (4 * costs))
    objective = _objective(rows, w, Loss.L2)
    lower_bound = max(0.0, min(float((y @ a).min() - paid.sum()), objective)) if len(a) else 0.0
    gap = objective - lower_bound
    worst = float((np.maximum(finite(above), finite(below)) @ a**2).max(initial=0.0))
    optimal = gap <= LEAST_SQUARES_GAP * max(objective, NOISELESS * worst)
    return Optimum(w, 0.0, objective, lower_bound, gap, Status.OPTIMAL if optimal else Status.UNCERTIFIED)


def _least_violation(rows: ConstraintRows, hard: Array, origin: Indices) -> tuple[Array, Status, Indices]:
    """The w that violates the hard rows least, in squares; INFEASIBLE, and the rows at fault, if no w meets them.

    Weighted with their violations, the rows at fault add up to a row that every w violates (Farkas).
    """
    equal = (np.isinf(rows.above) & np.isinf(rows.below))[origin]
    start = np.full(hard.shape[1], 1 / hard.shape[1])
    w, _ = _solve(ConstraintRows(hard, equal.astype(float), np.ones(len(hard))), Loss.L2, start)
    value = hard @ w
    weight = np.where(equal | (value < 0), -value, 0.0)
    weight[np.abs(weight) <= VIOLATED] = 0.0
    if (weight @ hard).max() < -HARD_VIOLATION * np.abs(weight).sum():
        return w, Status.INFEASIBLE, origin[np.flatnonzero(weight)]
    return w, Status.UNCERTIFIED, origin[:0]
