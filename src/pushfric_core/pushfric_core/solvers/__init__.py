"""The linear and quadratic programs for w, their solvers and certificates.

All solvers are peers behind `program.Program`; each is loaded when it is first needed.
"""

from pushfric_core.errors import SolverUnavailable
from pushfric_core.geometry.planar import Array
from pushfric_core.solvers.program import Loss, Program, Solver


def least_weights(hessian: Array, start: Array) -> Array:
    """The w (n,) >= 0, sum 1, of least w' H w, found fast from that of a similar H (n, n), positive definite."""
    from pushfric_core.solvers import active_set

    return active_set.least_weights(hessian, start)


def empty_program(n: int, loss: Loss = Loss.L1, solver: Solver = Solver.SIMPLEX, with_scale: bool = False) -> Program:
    """A program over the weights of n support points that has no rows yet.

    Args:
        n: number of support points.
        loss: L2 selects the solver for least squares, whatever `solver` is.
        solver: of the linear program.
        with_scale: the rows have one more column, that of the scale; only the simplex solver can handle it.
    Raises:
        ValueError: n < 1, or a scale with another solver.
        SolverUnavailable: the solver needs the package osqp, which is not installed.
    """
    name = "least squares" if loss is Loss.L2 else solver.value
    if with_scale and name != Solver.SIMPLEX:
        raise ValueError(f"measured forces with a scale need the loss l1 and the solver simplex, got {loss} and {solver}")
    try:
        if loss is Loss.L2:
            from pushfric_core.solvers.quadratic import LeastSquares

            return LeastSquares(n)
        if solver is Solver.OSQP:
            from pushfric_core.solvers.osqp import OsqpLinearProgram

            return OsqpLinearProgram(n)
        from pushfric_core.solvers.simplex import Simplex

        return Simplex(n, with_scale)
    except ModuleNotFoundError as error:
        if error.name != "osqp":
            raise
        raise SolverUnavailable(f"the solver {name} needs the package osqp: pip install 'pushfric_core[osqp]'") from error
