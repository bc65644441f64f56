"""The program for w, the protocol of its solvers, and the certificate that says how good a solution from any solver is.

    minimise  F(w, s) = sum_k phi_k(a_k . w + b_k s)   over   w >= 0, sum w = 1, s >= 0
    phi_k(r) = above_k * max(r, 0) + below_k * max(-r, 0)

An infinite `above` or `below` makes that side of a row hard. The scale s and the last column b of the rows exist only if
forces were measured. The dual is: maximise min_j (A' y)_j over -below <= y <= above, b . y >= 0. So any such y gives a lower
bound, and any w in the simplex with any s >= 0 an upper one (Lynch 1993, section 3.3, eqs 7 and 11).
"""

from enum import Enum, StrEnum
from typing import NamedTuple, Protocol

import numpy as np

from pushfric_core.geometry.planar import Array
from pushfric_core.program.constraints import ConstraintRows
from pushfric_core.records import comparable

RELATIVE_GAP = 1e-9
"""A solution is optimal when its gap is within this of its objective."""

NOISELESS = 1e-5
"""Floor of the objective in that test, as a fraction of the worst objective any w could have: noiseless data have F = 0."""

HARD_VIOLATION = 1e-9
"""A hard row may be violated by this much of its largest coefficient."""


class Status(Enum):
    """How far a solution can be trusted.

    Example:
        >>> from pushfric_core import Estimator, Status
        >>> Estimator([(-0.05, 0.0), (0.05, 0.0)]).estimate().status is Status.OPTIMAL
        True
    """

    OPTIMAL = "optimal"
    UNCERTIFIED = "uncertified"
    INFEASIBLE = "infeasible"


class Loss(StrEnum):
    """How the residuals of all rows add up to the fit error.

    Example:
        >>> from pushfric_core import EstimatorConfig, Loss
        >>> EstimatorConfig(loss=Loss.L2) == EstimatorConfig(loss="l2")
        True
    """

    L1 = "l1"
    L2 = "l2"


class Solver(StrEnum):
    """The solvers of the linear program.

    Example:
        >>> from pushfric_core import EstimatorConfig, Solver
        >>> EstimatorConfig().solver is Solver.SIMPLEX
        True
    """

    SIMPLEX = "simplex"
    OSQP = "osqp"


@comparable
class Optimum(NamedTuple):
    """The w with the smallest F, and how far that is proven.

    Example:
        >>> from pushfric_core import Estimator
        >>> optimum = Estimator([(-0.05, 0.0), (0.05, 0.0)]).estimate().solution
        >>> optimum.objective, optimum.gap
        (0.0, 0.0)
    """

    w: Array  # (n,) weights, >= 0, sum 1
    scale: float  # s >= 0; 0 if the program has no scale, or nothing determines it
    objective: float  # F(w, s), of the finite costs
    lower_bound: float  # no w and s have a smaller F
    gap: float  # objective - lower_bound, >= 0
    status: Status


class Groups:
    """The groups of rows in a program, one for each observation, numbered in order of arrival."""

    def __init__(self) -> None:
        self.next = 0
        self._present: set[int] = set()

    def add(self) -> None:
        """Take in the next group."""
        self._present.add(self.next)
        self.next += 1

    def remove(self, group: int) -> None:
        """Take a group out again.

        Raises:
            ValueError: there is no such group, or it was removed before.
        """
        if group not in self._present:
            raise ValueError(f"there is no group {group} to remove")
        self._present.remove(group)


class Program(Protocol):
    """A program for w whose rows are added and removed, observation by observation; the protocol of every solver."""

    def add(self, added: ConstraintRows, /) -> None:
        """Append the rows of one observation, if any; they become group 0, 1, 2... in order of arrival.

        Raises:
            ValueError: shapes that do not fit, coefficients that are not finite, costs that are negative or NaN.
        """

    def remove(self, group: int, /) -> None:
        """Take the rows of one observation out again.

        Raises:
            ValueError: there is no such group, or it was removed before.
        """

    def solve(self) -> Optimum:
        """The optimum over the present rows; if hard rows contradict each other, the w that violates them least."""

    def nearest_uniform(self) -> Optimum:
        """As `solve`, but of equally good w the one nearest to equal weights, if this solver can find it."""
        return self.solve()

    def conflicts(self) -> list[int]:
        """The groups whose hard rows contradict each other; none unless the last optimum is infeasible."""


@comparable
class Solution(NamedTuple):
    """A point of the simplex, and a scale, with their certificate."""

    w: Array  # (n,) weights, >= 0, sum 1
    scale: float  # s >= 0; 0 if the rows have no column for it
    multipliers: Array  # (m,) dual y, one per row
    objective: float  # F(w, s), of the finite costs
    lower_bound: float  # no w and s have a smaller F
    gap: float  # objective - lower_bound, >= 0
    status: Status

    @property
    def optimum(self) -> Optimum:
        """The same without the multipliers."""
        return Optimum(self.w, self.scale, self.objective, self.lower_bound, self.gap, self.status)


def certify(rows: ConstraintRows, w: Array, multipliers: Array, scale: float | None = None) -> Solution:
    """Judge weights, multipliers and scale from any solver, after projecting all of them onto their feasible sets.

    Args:
        rows: the program.
        w: (n,) candidate weights; negative parts are cut and the sum restored.
        multipliers: (m,) candidate dual; clipped to its box.
        scale: candidate s if the rows have a last column for it; cut at zero, and changed as the sum of w is.
    Raises:
        ValueError: w has no positive part, or a shape does not fit.
    """
    m, n = rows.a.shape
    if scale is not None:
        n -= 1
    if w.shape != (n,) or multipliers.shape != (m,):
        raise ValueError(f"w and multipliers must have shapes ({n},) and ({m},), got {w.shape}, {multipliers.shape}")
    w = np.maximum(w, 0.0)
    total = float(w.sum())
    if not total > 0:
        raise ValueError("w must have a positive part")
    w, scale = w / total, max(scale or 0.0, 0.0) / total
    a, b = rows.a[:, :n], rows.a[:, n:].sum(axis=1)
    largest = np.abs(a).max(axis=1, initial=0.0)
    residuals = a @ w + b * scale
    tolerance = HARD_VIOLATION * np.maximum(largest, np.abs(b) * scale)
    violated = ((residuals > tolerance) & np.isinf(rows.above)) | ((residuals < -tolerance) & np.isinf(rows.below))
    objective = fit_error(rows, residuals)
    multipliers, bound = _lower_bound(rows, n, np.clip(multipliers, -rows.below, rows.above), objective)
    # y = 0 is in its box: F is never negative
    lower_bound = max(0.0, min(bound, objective))
    gap = objective - lower_bound
    worst = largest_fit_error(rows, n)
    if violated.any():
        status = Status.INFEASIBLE
    elif gap <= RELATIVE_GAP * max(objective, NOISELESS * worst):
        status = Status.OPTIMAL
    else:
        status = Status.UNCERTIFIED
    return Solution(w, scale, multipliers, objective, lower_bound, gap, status)


def _lower_bound(rows: ConstraintRows, n: int, multipliers: Array, objective: float) -> tuple[Array, float]:
    """The bound that multipliers in their box give, and the multipliers without those that would spoil it."""
    a, b = rows.a[:, :n], rows.a[:, n:].sum(axis=1)
    shortfall = max(0.0, -float(multipliers @ b))
    if shortfall > 0:
        most = largest_scale(a, b, np.where(b > 0, rows.above, rows.below), objective)
        if most < np.inf:
            return multipliers, float((multipliers @ a).min(initial=np.inf)) - most * shortfall
        # a larger scale costs nothing in any row, so that y b <= 0 in all of them
        multipliers = np.where(b == 0, multipliers, 0.0)
    return multipliers, float((multipliers @ a).min()) if len(a) else 0.0


def largest_scale(a: Array, b: Array, cost: Array, objective: float) -> float:
    """A bound on s in all (w, s) that are as good as the objective; infinite if a larger s costs nothing in any row.

    phi_k >= cost_k (|b_k| s - relief_k), with cost_k on the side to which s moves row k and relief_k the most that w can move
    it back; these add up to F at most. A hard row allows |b_k| s <= relief_k.

    Args:
        a: (m, n) columns of w.
        b: (m,) column of s.
        cost: (m,)
        objective: F.
    """
    relief = (-np.sign(b)[:, None] * a).max(axis=1)
    hard, soft = np.isinf(cost) & (b != 0), np.isfinite(cost) & (b != 0) & (cost > 0)
    bounds = relief[hard] / np.abs(b[hard])
    if soft.any():
        bounds = np.append(bounds, (objective + cost[soft] @ relief[soft]) / (cost[soft] @ np.abs(b[soft])))
    return max(0.0, float(bounds.min(initial=np.inf)))


def fit_error(rows: ConstraintRows, residuals: Array) -> float:
    """Sum of the costs of the residuals a . w + b s (m,); the hard sides, satisfied or not, cost nothing."""
    return float(finite(rows.above) @ np.maximum(residuals, 0.0) + finite(rows.below) @ np.maximum(-residuals, 0.0))


def largest_fit_error(rows: ConstraintRows, n: int) -> float:
    """A bound on the fit error of any n weights."""
    return float(np.sum(np.abs(rows.a[:, :n]).max(axis=1, initial=0.0) * np.maximum(finite(rows.above), finite(rows.below))))


def finite(costs: Array) -> Array:
    """The costs, with zero in place of infinite ones."""
    return np.where(np.isinf(costs), 0.0, costs)


def check_size(n: int) -> int:
    """The number of support points.

    Raises:
        ValueError: there are no support points.
    """
    if n < 1:
        raise ValueError(f"n must be at least 1, got {n}")
    return n


def check_rows(rows: ConstraintRows, n: int) -> None:
    """Refuse rows that no program over n support points can take.

    Raises:
        ValueError: shapes that do not fit, coefficients that are not finite, costs that are negative or NaN.
    """
    a, above, below = rows
    m = len(above)
    if a.shape != (m, n) or below.shape != (m,):
        raise ValueError(f"rows must have shapes (m, {n}), (m,), (m,), got {a.shape}, {above.shape}, {below.shape}")
    if not np.isfinite(a).all():
        raise ValueError("the coefficients of the rows must be finite")
    if not np.minimum(above, below).min(initial=0.0) >= 0:
        raise ValueError("the costs of the rows must not be negative or NaN")
