"""Quadratic programs over the weights and hard rows, solved exactly: exchanges find which conditions are active.

If the exchanges do not end by themselves, OSQP, a first-order method, finds which w_j vanish and which rows are active. Then
the optimum is the solution of a linear system, after a few more exchanges if OSQP stopped too early.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.errors import SolverUnavailable
from pushfric_core.geometry.planar import Array
from pushfric_core.program.constraint_rows import ConstraintRows
from pushfric_core.solvers.program import HARD_VIOLATION

Indices = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]

QUADRATIC = {"eps_abs": 1e-6, "eps_rel": 1e-6, "max_iter": 4000, "verbose": False}
"""Tolerance of OSQP, small enough to distinguish zeros."""

RIDGE = 1e-10
"""Makes a linear system without a unique solution regular; refinement removes its effect."""

REFINEMENTS = 4

PROXIMITY = 1e-6
"""Weight of |w - start|^2 / 2 relative to the largest curvature, if pivoting does not end because many w are nearly as good."""

PIVOTS = 30
"""Cap on the exchanges of active conditions."""

FRUITLESS = 3
"""Number of exchanges of all wrong conditions that may fail to reduce their number; afterwards, one is exchanged at a time."""

ROUNDS = 20
"""Cap on the descents of a solve, and on the halvings of a step."""

ZERO = 1e-13
"""Weights, rows and multipliers this far on their wrong side are rounding."""

VIOLATED = HARD_VIOLATION / 4
"""A hard row is violated beyond this: well within what the certificate allows."""

RANK = 1e-11
"""Singular values below this, as a fraction of the largest, are zero."""


class HardRows(NamedTuple):
    """Rows of largest coefficient 1 with equal @ w = 0, low @ w >= 0."""

    equal: Array  # (p, n)
    low: Array  # (q, n)

    @property
    def stacked(self) -> Array:
        """All rows (p + q, n)."""
        return np.concatenate(self)

    def allows(self, w: Array) -> bool:
        """Whether w (n,) meets the rows, within VIOLATED."""
        return bool(np.all(np.abs(self.equal @ w) <= VIOLATED) and np.all(self.low @ w >= -VIOLATED))


class Minimum(NamedTuple):
    """The solution of a quadratic program."""

    w: Array
    reaction: Array  # (n,) sum of the hard rows, each times its multiplier


def minimise(hessian: Array, linear: Array, hard: HardRows, start: Array) -> Minimum | None:
    """min w' H w / 2 - linear . w over the simplex and the hard rows; None if the hard rows could not be met.

    The conditions active at `start` are tried first, then those that OSQP finds. Proximal steps approach the point that those
    lead to, until its own active conditions give the optimum. Inactive hard rows join when they are violated.

    Args:
        hessian: H (n, n).
        linear: (n,).
        hard: the hard rows.
        start: (n,) where to begin.
    """
    scale = float(hessian.diagonal().max()) or 1.0
    hessian, linear = hessian / scale, linear / scale
    found, asked = Minimum(start, np.zeros(len(start))), False
    free, active = start > 0, hard.low @ start <= ZERO
    chosen = np.flatnonzero(active)
    for _ in range(ROUNDS):
        part = HardRows(hard.equal, hard.low[chosen])
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
        found = Minimum(start, scale * nearby.reaction)
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


def least_weights(hessian: Array, start: Array) -> Array:
    """The w (n,) >= 0, sum 1, of least w' H w, for H (n, n) positive definite: from `start`, that of a similar H."""
    hessian = hessian / float(hessian.diagonal().max())
    none = np.zeros((0, len(start)))
    found = _pivot(hessian, np.zeros(len(start)), HardRows(none, none), start > 0, np.zeros(0, dtype=bool), start)
    if found is not None:
        return found.w
    # the exchanges go round in a circle, which is rare; a soft sum instead of a hard one scales the same optimum
    from scipy.optimize import nnls

    root = np.linalg.cholesky(hessian).T
    w, _ = nnls(np.vstack((root, np.ones(len(start)))), np.append(np.zeros(len(start)), 1.0))
    return np.asarray(w / w.sum())


def _pivot(hessian: Array, linear: Array, hard: HardRows, free: Mask, active: Mask, start: Array) -> Minimum | None:
    """Block principal pivoting: solve with w_j = 0 outside `free` and the low rows in `active` met; exchange what is wrong.

    If several w are optimal, the result is one near `start`. It is None if the exchanges do not end.
    """
    n, equal = len(start), len(hard.equal)
    free, active = free.copy(), active.copy()
    fewest, patience = 2 * (n + len(active)), FRUITLESS
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
            return Minimum(w, reaction) if hard.allows(w) else None
        if count < fewest:
            fewest, patience = count, FRUITLESS
        elif patience:
            patience -= 1
        else:
            wrong[: np.flatnonzero(wrong)[-1]] = False
        free ^= wrong[:n]
        active ^= wrong[n:]
    return None


def _stationary(hessian: Array, linear: Array, conditions: Array, free: Mask, start: Array) -> tuple[Array, Array]:
    """The free w at which the gradient is a combination of the conditions, of which the first is sum w = 1; its factors."""
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


def _approximate(hessian: Array, linear: Array, hard: HardRows) -> tuple[Array, Mask, Mask]:
    """The result of OSQP: w, which of them are not zero, and which low rows are active."""
    # hardly any program needs this
    from scipy import sparse

    try:
        import osqp
    except ModuleNotFoundError as error:
        raise SolverUnavailable("this quadratic program needs the package osqp: pip install 'pushfric_core[osqp]'") from error

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
    # as in OSQP's own polish, a condition is active if its multiplier exceeds its value
    active = (conditions @ w < -np.nan_to_num(result.y))[1 + equal :]
    w = np.maximum(w, 0.0)
    w = w / w.sum() if w.any() else np.full(n, 1 / n)
    return w, ~active[:n], active[n:]


def hard_rows(rows: ConstraintRows) -> tuple[HardRows, Indices]:
    """The hard sides, and the row that each comes from, stacked."""
    a, above, below = rows[0], np.isinf(rows.above), np.isinf(rows.below)
    nonzero = a.any(axis=1)
    equal, low, high = (np.flatnonzero(nonzero & side) for side in (above & below, below & ~above, above & ~below))
    hard = HardRows(unit_rows(a[equal]), unit_rows(np.concatenate((a[low], -a[high]))))
    return hard, np.concatenate((equal, low, high))


def unit_rows(a: Array) -> Array:
    """The rows (m, n), each scaled to a largest coefficient of 1; rows of zeros are left out."""
    peak = np.abs(a).max(axis=1, initial=0.0)
    return np.asarray(a[peak > 0] / peak[peak > 0, None])


def row_space(a: Array) -> Array:
    """An orthonormal basis (r, n) of the space that the rows (m, n) span."""
    if not len(a):
        return a
    _, singular, basis = np.linalg.svd(np.linalg.qr(a, mode="r"))
    return np.asarray(basis[: int((singular > RANK * singular[0]).sum())])
