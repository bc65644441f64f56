"""Plain stand-in for the exact incremental solver: HiGHS through scipy, from scratch at every call."""

import numpy as np
from scipy.optimize import linprog

from pushfric_core.constraints import ConstraintRows
from pushfric_core.errors import InfeasibleProgram, SolverFailed
from pushfric_core.linear_program import Solution, certify
from pushfric_core.planar import Array

TIGHT = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
INFEASIBLE = 2  # scipy's status


def solve(rows: ConstraintRows) -> Solution:
    """Minimise the fit error over the simplex.

    Raises:
        InfeasibleProgram: the hard rows contradict each other.
        SolverFailed: HiGHS gave up; its message is passed on.
    """
    m, n = rows.a.shape
    # a . w = above part - below part, both nonnegative; a hard side has no part
    costs = np.concatenate((np.zeros(n), np.nan_to_num(rows.above, posinf=0.0), np.nan_to_num(rows.below, posinf=0.0)))
    equations = np.block([[rows.a, -np.eye(m), np.eye(m)], [np.ones((1, n)), np.zeros((1, 2 * m))]])
    limits: Array = np.concatenate((np.ones(n), np.where(np.isinf(np.concatenate((rows.above, rows.below))), 0.0, np.inf)))
    bounds = np.stack((np.zeros(n + 2 * m), limits), axis=1)
    result = linprog(costs, A_eq=equations, b_eq=np.append(np.zeros(m), 1.0), bounds=bounds, method="highs", options=TIGHT)
    if result.status == INFEASIBLE:
        raise InfeasibleProgram("no weights satisfy all hard constraints")
    if not result.success:
        raise SolverFailed(f"HiGHS: {result.message}")
    return certify(rows, result.x[:n], -result.eqlin.marginals[:m])
