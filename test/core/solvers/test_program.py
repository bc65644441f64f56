import numpy as np
import pytest

from pushfric_core.program.constraints import ConstraintRows
from pushfric_core.solvers.program import Status, certify

ROWS = ConstraintRows(np.array(((1.0, -1.0, 0.0), (1.0, 0.0, -2.0))), np.ones(2), np.ones(2))


def test_a_solution_with_its_multipliers_is_optimal():
    rows = ConstraintRows(np.array(((1.0, -1.0),)), np.ones(1), np.ones(1))
    solution = certify(rows, np.array((0.5, 0.5)), np.zeros(1))
    assert solution.objective == 0
    assert solution.gap == 0
    assert solution.status is Status.OPTIMAL


def test_any_multipliers_give_a_true_lower_bound(rng):
    best = min(float(np.abs(ROWS.a @ w).sum()) for w in rng.dirichlet(np.ones(3), 20000))
    for _ in range(50):
        solution = certify(ROWS, np.full(3, 1 / 3), rng.normal(size=2) * 3)
        assert solution.lower_bound <= best
        assert solution.gap == solution.objective - solution.lower_bound


def test_the_scale_is_part_of_the_solution():
    # |w0 - 2 s| + |w1 - 6 s|
    rows = ConstraintRows(np.array(((1.0, 0.0, -2.0), (0.0, 1.0, -6.0))), np.ones(2), np.ones(2))
    solution = certify(rows, np.array((0.5, 1.5)), np.zeros(2), scale=0.25)
    assert solution.scale == 0.125  # changed with the sum of w
    assert solution.objective == 0
    assert solution.status is Status.OPTIMAL
    assert certify(rows, np.array((0.5, 0.5)), np.zeros(2), scale=-1.0).scale == 0


def test_any_multipliers_give_a_true_lower_bound_with_a_scale_too(rng):
    # |w0 - 2 s| + max(0, 3 w1 - s) + max(0, s - 0.1 (w0 + w1)), evaluated on a fine grid of w and s
    a = np.array(((1.0, 0.0, -2.0), (0.0, 3.0, -1.0), (-0.1, -0.1, 1.0)))
    rows = ConstraintRows(a, np.ones(3), np.array((1.0, 0.0, 0.0)))
    w, s = np.meshgrid(np.linspace(0, 1, 1001), np.linspace(0, 1, 1001))
    residuals = np.tensordot(a, np.stack((w, 1 - w, s)), axes=1)
    best = float((np.abs(residuals[0]) + np.maximum(residuals[1:], 0).sum(axis=0)).min())
    bounds = [certify(rows, np.full(2, 0.5), rng.uniform(-1, 1, 3), scale=0.1).lower_bound for _ in range(2000)]
    assert max(bounds) <= best + 1e-12
    assert max(bounds) > 0.5 * best


def test_rows_that_a_larger_scale_makes_free_prove_nothing():
    # max(0, w0 + w1 - s) + |w0 - w1|: a large s makes the first row free
    rows = ConstraintRows(np.array(((1.0, 1.0, -1.0), (1.0, -1.0, 0.0))), np.ones(2), np.array((0.0, 1.0)))
    solution = certify(rows, np.array((0.5, 0.5)), np.array((1.0, 0.0)), scale=2.0)
    assert solution.objective == 0
    assert solution.lower_bound == 0
    np.testing.assert_array_equal(solution.multipliers, (0, 0))


def test_a_hard_row_bounds_the_scale():
    # s <= w0 + w1 = 1 makes up for multipliers that would reward a larger s by 0.1 per unit
    rows = ConstraintRows(np.array(((-1.0, -1.0, 1.0), (2.0, 2.0, -0.1))), np.array((np.inf, 1.0)), np.zeros(2))
    assert certify(rows, np.array((0.5, 0.5)), np.array((0.0, 1.0)), scale=1.0).lower_bound == pytest.approx(1.9)


def test_a_solution_that_is_not_optimal_is_not_called_so():
    assert certify(ROWS, np.array((1.0, 0.0, 0.0)), np.zeros(2)).status is Status.UNCERTIFIED


def test_weights_are_brought_into_the_simplex():
    assert np.allclose(certify(ROWS, np.array((2.0, 2.0, -1.0)), np.zeros(2)).w, (0.5, 0.5, 0))


def test_a_violated_hard_row_makes_the_solution_infeasible():
    rows = ConstraintRows(np.array(((-1.0, 1.0),)), np.zeros(1), np.full(1, np.inf))
    assert certify(rows, np.array((0.6, 0.4)), np.zeros(1)).status is Status.INFEASIBLE
    assert certify(rows, np.array((0.4, 0.6)), np.zeros(1)).status is Status.OPTIMAL


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match=r"must have shapes \(3,\) and \(2,\), got \(2,\), \(2,\)"):
        certify(ROWS, np.ones(2), np.zeros(2))
    with pytest.raises(ValueError, match=r"must have shapes \(2,\) and \(2,\), got \(3,\), \(2,\)"):
        certify(ROWS, np.ones(3), np.zeros(2), scale=1.0)


def test_weights_without_a_positive_part_are_refused():
    with pytest.raises(ValueError, match="positive part"):
        certify(ROWS, -np.ones(3), np.zeros(2))
