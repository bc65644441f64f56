"""The w that meets hard rows and is nearest to a point, exactly: exchanges find which conditions are active.

Among them is the optimal w of a linear program that is nearest to equal weights.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.planar import Array, Indices
from pushfric_core.program.constraints import ConstraintRows
from pushfric_core.solvers.program import HARD_VIOLATION, Solution, Status, certify

Mask = npt.NDArray[np.bool_]

PIVOTS = 30
"""Cap on the exchanges of active conditions."""

FRUITLESS = 3
"""Number of exchanges of all wrong conditions that may fail to reduce their number; afterwards, one is exchanged at a time."""

ROUNDS = 20
"""Cap on the rounds in which violated rows join."""

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


def nearest(point: Array, hard: HardRows, start: Array) -> Array | None:
    """The w (n,) of the simplex and the hard rows that is nearest to a point (n,); None if no w was found that meets them.

    The conditions active at `start` (n,) are tried first. Inactive hard rows join when they are violated.
    """
    found, free, active = start, start > 0, hard.low @ start <= ZERO
    chosen = np.flatnonzero(active)
    for _ in range(ROUNDS):
        part = HardRows(hard.equal, hard.low[chosen])
        closer = _pivot(point, part, free, active[chosen])
        if closer is None:
            closer = _least_distance(point, part)
        if closer is None:
            break
        found, free = closer, closer > 0
        value = hard.low @ found
        active[chosen] = value[chosen] <= ZERO
        value[chosen] = 0.0
        worst = np.argsort(value)[: len(start)]
        worst = worst[value[worst] < -VIOLATED]
        if not worst.size:
            break
        active[worst] = True
        chosen = np.append(chosen, worst)
    return found if hard.allows(found) else None


def _pivot(point: Array, hard: HardRows, free: Mask, active: Mask) -> Array | None:
    """Block principal pivoting: solve with w_j = 0 outside `free` and the low rows in `active` met; exchange what is wrong.

    None if the exchanges do not end.
    """
    n, equal = len(point), len(hard.equal)
    free, active = free.copy(), active.copy()
    fewest, patience = 2 * (n + len(active)), FRUITLESS
    for _ in range(PIVOTS):
        if not free.any():
            free[:] = True
        conditions = np.concatenate((np.ones((1, n)), hard.equal, hard.low[active]))
        # the nearest free w at which the conditions, of which the first is sum w = 1, hold
        inverse, lacking = np.linalg.pinv(conditions[:, free], RANK), -conditions[:, free] @ point[free]
        lacking[0] += 1
        change = inverse @ lacking
        dual = change @ inverse
        w = np.zeros(n)
        w[free] = point[free] + change
        reduced = w - point - dual @ conditions
        multipliers = np.zeros(len(active))
        multipliers[active] = dual[1 + equal :]
        wrong = np.concatenate((np.where(free, w, reduced), np.where(active, multipliers, hard.low @ w))) < -ZERO
        count = int(wrong.sum())
        if not count:
            w = np.maximum(w, 0.0)
            w /= w.sum()
            return w if hard.allows(w) else None
        if count < fewest:
            fewest, patience = count, FRUITLESS
        elif patience:
            patience -= 1
        else:
            wrong[: np.flatnonzero(wrong)[-1]] = False
        free ^= wrong[:n]
        active ^= wrong[n:]
    return None


def _least_distance(point: Array, hard: HardRows) -> Array | None:
    """As `nearest`, by nonnegative least squares (Lawson and Hanson 1974, Solving Least Squares Problems, ch. 23)."""
    from scipy.optimize import nnls  # hardly any program needs this

    n = len(point)
    equalities = np.vstack((np.ones(n), hard.equal))
    start, _, rank, _ = np.linalg.lstsq(equalities, np.append(1.0, np.zeros(len(hard.equal))), rcond=RANK)
    along = np.linalg.svd(equalities)[2][rank:].T
    start = start + along @ (along.T @ (point - start))
    sides = np.vstack((np.eye(n), hard.low))
    least = np.vstack(((sides @ along).T, -sides @ start))
    residual = least @ nnls(least, np.append(np.zeros(n - rank), 1.0))[0] - np.append(np.zeros(n - rank), 1.0)
    if abs(residual[-1]) <= ZERO:
        return None  # the rows contradict each other
    w = np.maximum(start - along @ residual[:-1] / residual[-1], 0.0)
    return np.asarray(w / w.sum()) if w.any() else None


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


STRICT = 1e-9
"""Multipliers and sums of them this far from a bound, as a fraction of the largest, are at it."""


def nearest_uniform(rows: ConstraintRows, solution: Solution) -> Solution:
    """The optimal w of a linear program that is nearest to equal weights; O(M n), and some O(n^3).

    By complementary slackness with any optimal multipliers y, w is optimal if a . w = 0 in the rows with y inside its box and
    lies on the side of y in the others, and if w_j = 0 for every (A' y)_j above the minimum.

    Args:
        rows: the program.
        solution: an optimal w of it and its multipliers.
    Returns:
        The optimum found, certified; `solution` itself if there is no other optimum, or the one found cannot be certified.
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
    a, high, low = unit_rows(a[seen]), high[seen], low[seen]
    face = HardRows(row_space(a[~high & ~low]), np.concatenate((a[high & ~low], -a[low & ~high])))
    n, free = len(support), int(support.sum())
    if len(row_space(np.vstack((face.equal, np.ones(free))))) == free:
        return solution
    found = nearest(np.full(free, 1 / n), face, solution.w[support])
    if found is None:
        return solution
    w = np.zeros(n)
    w[support] = found
    certified = certify(rows, w, y)
    return certified if certified.status is Status.OPTIMAL else solution
