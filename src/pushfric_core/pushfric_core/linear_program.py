"""The linear program for w, its solution, and the certificate that says how good a solution is, whoever found it.

    minimise  F(w) = sum_k phi_k(a_k . w)   over   w >= 0, sum w = 1
    phi_k(r) = above_k * max(r, 0) + below_k * max(-r, 0)

An infinite `above` or `below` makes that side of a row hard. The dual is: maximise min_j (A' y)_j over -below <= y <= above,
so any y in its box gives a lower bound and any w in the simplex an upper one (Lynch 1993, section 3.3, eqs 7 and 11).
"""

from enum import Enum
from typing import NamedTuple

import numpy as np

from pushfric_core.constraints import ConstraintRows
from pushfric_core.planar import Array

RELATIVE_GAP = 1e-9
"""A solution is optimal when its gap is within this of its objective."""

NOISELESS = 1e-5
"""Floor of the objective in that test, as a fraction of the worst objective any w could have: noiseless data have F = 0."""

HARD_VIOLATION = 1e-9
"""A hard row may be violated by this much of its largest coefficient."""


class Status(Enum):
    """How far a solution can be trusted."""

    OPTIMAL = "optimal"
    UNCERTIFIED = "uncertified"
    INFEASIBLE = "infeasible"


class Solution(NamedTuple):
    """A point of the simplex with its certificate."""

    w: Array  # (n,) weights, >= 0, sum 1
    multipliers: Array  # (m,) dual y, one per row
    objective: float  # F(w), of the finite costs
    lower_bound: float  # no w has a smaller F
    gap: float  # objective - lower_bound, >= 0
    status: Status


def certify(rows: ConstraintRows, w: Array, multipliers: Array) -> Solution:
    """Judge weights and multipliers from any solver, after projecting both onto their feasible sets.

    Args:
        rows: the program.
        w: (n,) candidate weights; negative parts are cut and the sum restored.
        multipliers: (m,) candidate dual; clipped to its box.
    Raises:
        ValueError: w has no positive part, or a shape does not fit.
    """
    if w.shape != (rows.a.shape[1],) or multipliers.shape != (rows.a.shape[0],):
        raise ValueError(
            f"w and multipliers must have shapes {rows.a.shape[1:]} and {rows.a.shape[:1]}, got {w.shape}, {multipliers.shape}"
        )
    w = np.maximum(w, 0.0)
    total = float(w.sum())
    if not total > 0:
        raise ValueError("w must have a positive part")
    w = w / total
    residuals = rows.a @ w
    scale = np.abs(rows.a).max(axis=1, initial=0.0)
    violated = ((residuals > HARD_VIOLATION * scale) & np.isinf(rows.above)) | (
        (residuals < -HARD_VIOLATION * scale) & np.isinf(rows.below)
    )
    objective = fit_error(rows, residuals)
    multipliers = np.clip(multipliers, -rows.below, rows.above)
    # y = 0 is in its box: F is never negative
    lower_bound = max(0.0, min(float((multipliers @ rows.a).min()), objective)) if len(rows.a) else 0.0
    gap = objective - lower_bound
    worst = float(np.sum(scale * np.maximum(_finite(rows.above), _finite(rows.below))))
    if violated.any():
        status = Status.INFEASIBLE
    elif gap <= RELATIVE_GAP * max(objective, NOISELESS * worst):
        status = Status.OPTIMAL
    else:
        status = Status.UNCERTIFIED
    return Solution(w, multipliers, objective, lower_bound, gap, status)


def fit_error(rows: ConstraintRows, residuals: Array) -> float:
    """Sum of the costs of the residuals a . w (m,); the hard sides, satisfied or not, cost nothing."""
    return float(_finite(rows.above) @ np.maximum(residuals, 0.0) + _finite(rows.below) @ np.maximum(-residuals, 0.0))


def _finite(costs: Array) -> Array:
    return np.where(np.isinf(costs), 0.0, costs)
