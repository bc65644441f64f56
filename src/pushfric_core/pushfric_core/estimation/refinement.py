"""Where the supports are: the program for w over a fine grid of candidates, of which only the useful ones become columns.

Any multipliers y of the rows, each within its costs, give a lower bound on the fit error of all w over the candidates: the
least (A' y)_j (see `solvers.program`). At the optimum over a few points, each of them has (A' y)_j >= F. A candidate with a
smaller (A' y)_j would lower F, so it joins the points (Gilmore and Gomory, "A linear programming approach to the cutting-stock
problem", 1961). Once no such candidate is left, the optimum over the few points is proven to be that over all candidates.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.estimation.estimator import EstimatorConfig, free_radii
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array
from pushfric_core.geometry.support import check_points, support_forces
from pushfric_core.plausible import other_unit
from pushfric_core.program.constraint_rows import ConstraintRows, stack
from pushfric_core.records import comparable
from pushfric_core.solvers import empty_program
from pushfric_core.solvers.program import LevelSets, Loss, Optimum, Solver, Status, certify
from pushfric_core.trajectories.observation import Observation

TOGETHER = 8
"""Largest number of candidates that join in one round; near each of them, no other candidate would lower F more."""

NEARBY = 0.05
"""Candidates are near each other within this share of the extent of all candidates."""

ROUNDS = 500
"""Cap on the rounds; about ten are usual."""


@comparable
class Refined(NamedTuple):
    """The optimum over all candidates.

    Attributes:
        points: (k, 2) the hypothesised points, and the candidates that joined them [m].
        solution: over `points`; its lower bound and status hold for all candidates.
        candidates: number of candidates.
    """

    points: Array
    solution: Optimum
    candidates: int


def candidate_grid(outline: Outline, spacing: float) -> Array:
    """Points (m, 2) all over an outline, at most this far from one another along x and y [m].

    Raises:
        ValueError: the spacing is not positive, longer than the object, or so small that there are too many points.
    """
    longest = float(max(outline.size))
    if not 0 < spacing <= longest:
        asked = other_unit("m", lambda factor: 0 < spacing * factor <= longest)
        raise ValueError(f"the spacing of the candidates must lie in (0, {longest:g}] m, got {spacing:g}{asked}")
    columns, rows = (math.ceil(side / spacing) + 1 for side in outline.size.tolist())
    return outline.grid(columns, rows, inset=0.0)


def refine(
    observations: Iterable[Observation], support_points: npt.ArrayLike, candidates: npt.ArrayLike, config: EstimatorConfig
) -> Refined:
    """Fit w over the support points and all candidates.

    Args:
        observations: the observations.
        support_points: (n, 2) hypothesised supports in the object frame [m], from which the search starts. They also say how
            near the centre of rotation supports are free, as in `Estimator`.
        candidates: (m, 2) where else supports may be [m].
        config: the constraints, with the loss l1 and the solver simplex.
    Raises:
        ValueError: another loss or solver, or points that are not (n, 2) and finite.
        UninformativePush: an observation rotates exactly about a point, and no support is free.
    """
    if (config.loss, config.solver) != (Loss.L1, Solver.SIMPLEX):
        raise ValueError(f"candidates need the loss l1 and the solver simplex, got {config.loss} and {config.solver}")
    start, others = check_points(support_points), check_points(candidates)
    points, free = np.vstack((start, others)), free_radii(start, config)
    columns = len(points) + config.with_scale
    rows = stack(
        [
            constraint.rows(observation, support_forces(points, observation.twist, free))
            for observation in observations
            for constraint in config.constraints
        ],
        columns,
    )
    nearby = NEARBY * float(np.ptp(points, axis=0).max())
    chosen = np.arange(len(start))
    for _ in range(ROUNDS):
        kept = np.concatenate((chosen, np.arange(len(points), columns)))
        program = empty_program(len(chosen), with_scale=config.with_scale)
        assert isinstance(program, LevelSets)
        program.add(ConstraintRows(rows.a[:, kept], rows.above, rows.below))
        program.solve()
        found = program.certificate()
        w = np.zeros(len(points))
        w[chosen] = found.w
        solution = certify(rows, w, found.multipliers, found.scale if config.with_scale else None)
        if found.status is not Status.OPTIMAL or solution.status is Status.OPTIMAL:
            break
        prices = found.multipliers @ rows.a[:, : len(points)]
        prices[chosen] = math.inf
        joining = _best(points, prices, solution.objective, nearby)
        if not len(joining):
            break
        chosen = np.concatenate((chosen, joining))
    optimum = solution.optimum._replace(w=found.w)
    return Refined(points[chosen], optimum, len(others))


def _best(points: Array, prices: Array, objective: float, nearby: float) -> npt.NDArray[np.int64]:
    """The indices of the candidates that lower F most, no two of them near each other."""
    best: list[int] = []
    for index in np.argsort(prices)[: 64 * TOGETHER].tolist():
        if not prices[index] < objective or len(best) == TOGETHER:
            break
        if not best or np.hypot(*(points[best] - points[index]).T).min() > nearby:
            best.append(index)
    return np.array(best, dtype=np.int64)
