"""The linear and quadratic programs for w, their solvers and certificates.

All solvers are peers behind `program.Program`; each is loaded when it is first needed.
"""

from pushfric_core.errors import SolverUnavailable, installing
from pushfric_core.solvers.program import Loss, Program, Solver


def empty_program(n: int, loss: Loss = Loss.L1, solver: Solver = Solver.SIMPLEX, with_scale: bool = False) -> Program:
    """A program over the weights of n support points that has no rows yet.

    Args:
        n: number of support points.
        loss: L2 needs OSQP, whatever `solver` is.
        solver: of the linear program.
        with_scale: the rows have one more column, that of the scale; only the simplex solver can handle it.
    Raises:
        ValueError: n < 1, or a scale with another solver.
        SolverUnavailable: the solver needs the package osqp, which is not installed.
    """
    simplex = loss is Loss.L1 and solver is Solver.SIMPLEX
    if with_scale and not simplex:
        raise ValueError(f"measured forces with a scale need the loss l1 and the solver simplex, got {loss} and {solver}")
    if simplex:
        from pushfric_core.solvers.simplex import Simplex

        return Simplex(n, with_scale)
    try:
        from pushfric_core.solvers.osqp import OsqpProgram
    except ModuleNotFoundError as error:
        if error.name != "osqp":
            raise
        what = "loss l2" if loss is Loss.L2 else "solver osqp"
        raise SolverUnavailable(f"the {what} needs the package osqp: {installing('osqp')}") from error
    return OsqpProgram(n, loss)
