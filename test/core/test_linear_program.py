import numpy as np
import pytest

from pushfric_core.constraints import ConstraintRows
from pushfric_core.linear_program import Status, certify

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


def test_a_solution_that_is_not_optimal_says_so():
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


def test_weights_without_a_positive_part_are_refused():
    with pytest.raises(ValueError, match="positive part"):
        certify(ROWS, -np.ones(3), np.zeros(2))
