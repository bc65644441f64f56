"""The fit over a fine grid of candidates, against the whole program and an independent solver, and where it finds the feet."""

from dataclasses import replace

import numpy as np
import pytest
from problems import four_feet, three_feet
from scipy.optimize import linprog

from pushfric_core.estimation.estimator import EstimatorConfig, free_radii
from pushfric_core.estimation.refinement import candidate_grid, refine
from pushfric_core.geometry.planar import Twist
from pushfric_core.geometry.support import support_forces
from pushfric_core.program.constraint_rows import stack
from pushfric_core.solvers.program import Status


def noisy(problem, rng, noise=0.05):
    """The problem's data points, with twists that err by this share of themselves."""
    return [
        replace(o, twist=Twist(*(np.array(o.twist) * (1 + noise * rng.normal(size=3))).tolist())) for o in problem.observations
    ]


def least_error(observations, points, start, config):
    """The least F over all points, from an independent solver."""
    free = free_radii(start, config)
    forces = [support_forces(points, o.twist, free) for o in observations]
    rows = stack([c.rows(o, f) for o, f in zip(observations, forces, strict=True) for c in config.constraints], len(points))
    m, n = rows.a.shape
    soft_above, soft_below = np.isfinite(rows.above), np.isfinite(rows.below)
    above, below = np.hstack((rows.a, -np.diag(soft_above * 1.0))), np.hstack((-rows.a, -np.diag(soft_below * 1.0)))
    costs = np.where(soft_above, rows.above, 0.0), np.where(soft_below, rows.below, 0.0)
    within = np.vstack(
        (np.hstack((above, np.zeros((m, m)))), np.hstack((below[:, :n], np.zeros((m, m)), below[:, n:]))),
    )
    total = np.concatenate((np.ones(n), np.zeros(2 * m)))[None]
    return linprog(np.concatenate((np.zeros(n), *costs)), within, np.zeros(2 * m), total, [1.0], bounds=(0, None)).fun


@pytest.mark.parametrize(
    "config", [EstimatorConfig(), EstimatorConfig(cor_radius=0.0, pull_penalty=0.1)], ids=["auto", "paper"]
)
@pytest.mark.parametrize("problem", [four_feet(), three_feet()], ids=lambda problem: problem.name)
def test_it_is_the_optimum_over_all_candidates(problem, config):
    data = noisy(problem, np.random.default_rng(0))
    start = problem.outline.grid(4, 4, 0.01)
    candidates = candidate_grid(problem.outline, 0.005)
    refined = refine(data, start, candidates, config)
    expected = least_error(data, np.vstack((start, candidates)), start, config)
    assert refined.solution.status is Status.OPTIMAL
    assert refined.solution.objective == pytest.approx(expected, rel=1e-6)
    assert refined.solution.lower_bound == pytest.approx(expected, rel=1e-6)
    assert refined.candidates == len(candidates)
    assert refined.solution.w.shape == (len(refined.points),)
    assert len(refined.points) < len(start) + len(candidates) / 2


def test_the_weight_gathers_at_the_feet():
    problem = three_feet()
    data = noisy(problem, np.random.default_rng(1), 0.01)
    start = problem.outline.grid(3, 3, 0.0)
    refined = refine(data, start, candidate_grid(problem.outline, 0.002), EstimatorConfig(cor_radius=0.0))
    distances = np.linalg.norm(refined.points[:, None] - problem.truth.points, axis=2).min(axis=1)
    assert refined.solution.w[distances < 0.008].sum() > 0.85


def test_the_grid_covers_the_outline():
    outline = four_feet().outline
    points = candidate_grid(outline, 0.03)
    assert np.ptp(points, axis=0) == pytest.approx(outline.size)
    assert np.diff(np.unique(points[:, 0].round(9))).max() <= 0.03


@pytest.mark.parametrize("spacing", [0.0, -1.0, float("nan"), float("inf"), 1e-5])
def test_a_spacing_that_makes_no_sense_is_refused(spacing):
    with pytest.raises(ValueError, match=r"spacing|a grid may have at most"):
        candidate_grid(four_feet().outline, spacing)


def test_other_losses_are_refused():
    with pytest.raises(ValueError, match="candidates need the loss l1"):
        refine([], [[0.0, 0.0]], [[0.1, 0.0]], EstimatorConfig(loss="l2"))
