"""The optimal w of a linear program that is nearest to equal weights."""

import numpy as np

from pushfric_core.program.constraint_rows import ConstraintRows
from pushfric_core.solvers.active_set import HardRows, nearest, row_space, unit_rows
from pushfric_core.solvers.program import Solution, Status, certify

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
