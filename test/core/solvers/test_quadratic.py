"""OSQP's programs against HiGHS, SLSQP and nonnegative least squares, and against their own certificates."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from programs import filled, group, highs, pushes, solved_while_rows_come_and_go, solved_with
from scipy.optimize import minimize, nnls

from pushfric_core.program.constraints import ConstraintRows, stack
from pushfric_core.solvers.active_set import nearest_uniform
from pushfric_core.solvers.osqp import OsqpProgram
from pushfric_core.solvers.program import Loss, Status, certify
from pushfric_core.solvers.simplex import Simplex

SEEDS = st.integers(0, 2**32 - 1)
QUICK = settings(derandomize=True, deadline=None, max_examples=15)
LeastSquares = partial(OsqpProgram, loss=Loss.L2)
EVERY_PROGRAM = pytest.mark.parametrize("program", [Simplex, OsqpProgram, LeastSquares])


def squares(rows, w):
    """The sum of squares, row by row."""
    total = 0.0
    for a, above, below in zip(*rows, strict=True):
        value = float(a @ w)
        cost = above if value > 0 else below
        if np.isfinite(cost):
            total += cost * value**2
    return total


def slsqp(rows):
    """Approximate least sum of squares, by a general solver, for coefficients of about one."""
    n = rows.a.shape[1]
    above, below = (np.where(np.isinf(cost), 0.0, cost) for cost in (rows.above, rows.below))
    hard = np.concatenate((rows.a[np.isinf(rows.below)], -rows.a[np.isinf(rows.above)]))

    def slope(w):
        value = rows.a @ w
        return 2 * (above * np.maximum(value, 0) - below * np.maximum(-value, 0)) @ rows.a

    result = minimize(
        lambda w: squares(rows, w),
        np.full(n, 1 / n),
        jac=slope,
        method="SLSQP",
        bounds=[(0, 1)] * n,
        constraints=[
            {"type": "eq", "fun": lambda w: w.sum() - 1, "jac": lambda w: np.ones(n)},
            {"type": "ineq", "fun": lambda w: hard @ w, "jac": lambda w: hard},
        ],
        options={"ftol": 1e-14, "maxiter": 1000},
    )
    assert result.success, result.message
    return result.fun


def nearest_by_nnls(point, equal, low):
    """The w of the simplex nearest to `point` with equal @ w = 0, low @ w >= 0: Lawson and Hanson's least distance program.

    The conditions may be violated by rounding, as only one w may satisfy them.
    """
    n = len(point)
    equalities = np.vstack((np.ones(n), equal))
    _, singular, basis = np.linalg.svd(equalities)
    rank = int((singular > 1e-10 * singular[0]).sum())
    start = np.linalg.lstsq(equalities, np.append(1.0, np.zeros(len(equal))), rcond=1e-10)[0]
    along = basis[rank:].T
    start = start + along @ (along.T @ (point - start))
    sides = np.vstack((np.eye(n), low))
    least = np.vstack(((sides @ along).T, -sides @ start - 1e-9))
    residual = -np.append(np.zeros(n - rank), 1.0)
    residual += least @ nnls(least, -residual)[0]
    return start - along @ residual[:-1] / residual[-1]


# ---- what the programs share


@EVERY_PROGRAM
def test_without_rows_any_weights_are_optimal(program):
    optimum = program(3).solve()
    assert optimum.w.sum() == pytest.approx(1)
    assert optimum[1:] == (0, 0, 0, 0, Status.OPTIMAL)


@EVERY_PROGRAM
def test_a_hard_row_holds_whatever_it_costs(program):
    optimum = filled(program(2), group([1, 0], above=1e6), group([2, -1], above=0, below=np.inf)).solve()
    np.testing.assert_allclose(optimum.w, (1 / 3, 2 / 3), atol=1e-8)


@EVERY_PROGRAM
def test_equalities_hold(program):
    equalities = group([[1, -1, 0], [2, -2, 0], [0, 0, 0], [1, 1, -1]], above=np.inf, below=np.inf)
    balanced = filled(program(3), group([1, 0, 0]), equalities)
    np.testing.assert_allclose(balanced.solve().w, (0.25, 0.25, 0.5), atol=1e-8)
    assert balanced.conflicts() == []


@EVERY_PROGRAM
def test_contradicting_groups_are_named_and_removing_one_helps(program):
    # w0 >= 3 w1, and w0 <= 2 w1
    hard = group([1, -3], above=0, below=np.inf), group([1, -2], above=np.inf, below=0)
    contradictory = filled(program(2), hard[0], group([0.1, -1]), hard[1])
    optimum = contradictory.solve()
    assert optimum.status is Status.INFEASIBLE
    assert contradictory.conflicts() == [0, 2]
    assert optimum.w.min() >= 0
    assert optimum.w.sum() == pytest.approx(1)
    assert optimum.lower_bound == 0
    contradictory.remove(2)
    optimum = contradictory.solve()
    assert optimum.status is not Status.INFEASIBLE
    assert contradictory.conflicts() == []
    # |0.1 w0 - w1| is 0 only at w0 = 10 / 11, which is allowed
    np.testing.assert_allclose(optimum.w, (10 / 11, 1 / 11), atol=1e-3)


@pytest.mark.parametrize("program", [OsqpProgram, LeastSquares])
def test_bad_arguments_are_refused(program):
    three = program(3)
    with pytest.raises(ValueError, match=r"rows must have shapes \(m, 3\), \(m,\), \(m,\), got \(1, 2\), \(1,\), \(1,\)"):
        three.add(group([1, 2]))
    with pytest.raises(ValueError, match="coefficients of the rows must be finite"):
        three.add(group([1, np.nan, 0]))
    for cost in (-1, np.nan):
        with pytest.raises(ValueError, match="costs of the rows must not be negative or NaN"):
            three.add(group([1, 2, 3], below=cost))


@EVERY_PROGRAM
def test_only_a_present_group_can_be_removed(program):
    with pytest.raises(ValueError, match="n must be at least 1, got 0"):
        program(0)
    three = filled(program(3), group([1, 2, 3]))
    three.remove(0)
    for gone in range(2):
        with pytest.raises(ValueError, match=f"there is no group {gone} to remove"):
            three.remove(gone)


# ---- the linear program


def test_a_linear_program_by_hand():
    # |w0 - w1| + |w0 - 3 w1| with w0 = 1 - w1: 0.5 at w1 = 1/4
    optimum = filled(OsqpProgram(2), group([1, -1]), group([1, -3])).solve()
    np.testing.assert_allclose(optimum.w, (0.75, 0.25), atol=1e-3)
    assert optimum.objective == pytest.approx(0.5, rel=1e-3)
    assert optimum.lower_bound == pytest.approx(0.5, rel=1e-3)


@QUICK
@given(SEEDS, st.integers(3, 20), st.sampled_from((0.0, 0.002)))
def test_bounds_enclose_the_optimum_of_highs(seed, n, half_width):
    groups = pushes(np.random.default_rng(seed), n, 12, half_width=half_width)[0]
    program = OsqpProgram(n)
    for k, rows in enumerate(groups):
        optimum = solved_with(program, rows)
        best, worst = highs(stack(groups[: k + 1], n)), 0.1 * (k + 1)
        assert optimum.lower_bound - 1e-6 * worst <= best <= optimum.objective + 1e-6 * worst
        assert optimum.gap == optimum.objective - optimum.lower_bound
        assert optimum.gap <= 0.02 * worst
        assert optimum.status in (Status.OPTIMAL, Status.UNCERTIFIED)


def test_reserve_columns_are_used_and_freed(rng):
    groups = pushes(rng, 8, 90)[0]
    program = OsqpProgram(8)
    for rows in groups:  # two rows each: exceeds the columns in reserve twice
        optimum = solved_with(program, rows)
    assert optimum.objective == pytest.approx(highs(stack(groups, 8)), rel=0.02)
    for number in range(45):
        program.remove(2 * number)
    assert program.solve().objective == pytest.approx(highs(stack(groups[1::2], 8)), rel=0.02)


# ---- least squares


def test_least_squares_by_hand():
    # (w0 - w1)^2 + 4 (w0 - 3 w1)^2 with w0 = 1 - w1: the slope in w1 is 2 (-2) (1 - 2 w1) + 8 (-4) (1 - 4 w1)
    optimum = filled(LeastSquares(2), group([1, -1]), group([1, -3], 4, 4)).solve()
    w1 = 36 / 136
    np.testing.assert_allclose(optimum.w, (1 - w1, w1), rtol=1e-12)
    assert optimum.objective == pytest.approx((1 - 2 * w1) ** 2 + 4 * (1 - 4 * w1) ** 2)
    assert optimum.status is Status.OPTIMAL


def test_a_one_sided_row_costs_nothing_on_its_other_side():
    # 5 max(0, 1 - 3 w0)^2 + w0^2: the slope is -30 (1 - 3 w0) + 2 w0
    program = filled(LeastSquares(2), group([[2, -1], [1, 0]], above=(0, 1), below=(5, 0)))
    np.testing.assert_allclose(program.solve().w, (15 / 46, 31 / 46))


def test_unconstrained_least_squares_would_be_negative():
    # w0 + w1 - w2 = 1 - 2 w2 and w0 - w1 + 2 w2 ask for (-0.25, 0.75, 0.5); without negative w the second cannot be zero
    optimum = filled(LeastSquares(3), group([[1, 1, -1], [4, 1, 0.5]])).solve()
    # with w1 = 1 - w2: (1 - 2 w2)^2 + (1 - w2 / 2)^2
    np.testing.assert_allclose(optimum.w, (0, 1 - 5 / 8.5, 5 / 8.5), atol=1e-9)


@QUICK
@given(SEEDS, st.integers(2, 25), st.sampled_from((0.0, 0.002)), st.sampled_from((0.0, 1e-3)))
def test_least_squares_agree_with_a_general_solver(seed, n, half_width, noise):
    groups = pushes(np.random.default_rng(seed), n, 3 * n, noise, half_width)[0]
    program = LeastSquares(n)
    for k, rows in enumerate(groups):
        optimum = solved_with(program, rows)
        assert optimum.status is not Status.INFEASIBLE
        assert optimum.w.min() >= 0
        assert optimum.w.sum() == pytest.approx(1, abs=1e-12)
        present = stack(groups[: k + 1], n)
        assert optimum.objective == pytest.approx(squares(present, optimum.w), rel=1e-9, abs=1e-16)
        assert (present.a[np.isinf(present.below)] @ optimum.w).min() >= -1e-9
    assert optimum.status is Status.OPTIMAL
    metre = 20.0  # to about one
    scaled = ConstraintRows(np.where(np.isinf(present.below)[:, None], 1.0, metre) * present.a, present.above, present.below)
    assert metre**2 * optimum.objective == pytest.approx(slsqp(scaled), rel=1e-4, abs=1e-7)


@QUICK
@given(SEEDS, st.integers(1, 20), st.integers(1, 50), st.booleans())
def test_rows_of_all_kinds_agree_with_a_general_solver_while_they_are_added_and_removed(seed, n, m, hard):
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(m, n)) * (rng.random((m, 1)) < 0.9)
    above, below = rng.choice((0.0, 0.05, 1.0, 1.0, 3.0), (2, m))
    if hard:  # such that some w satisfies them all
        residuals = a @ rng.dirichlet(np.full(n, 0.3))
        below[(rng.random(m) < 0.3) & (residuals > 1e-6)] = np.inf
        above[(rng.random(m) < 0.3) & (residuals < -1e-6)] = np.inf
    program = LeastSquares(n)
    rows = stack(solved_while_rows_come_and_go(program, rng, ConstraintRows(a, above, below)), n)
    optimum = program.solve()
    assert optimum.status is Status.OPTIMAL
    assert optimum.objective == pytest.approx(squares(rows, optimum.w), rel=1e-9, abs=1e-13)
    assert optimum.objective == pytest.approx(slsqp(rows), rel=1e-5, abs=1e-8)


def test_least_squares_of_thousands_of_rows_do_not_drift(rng):
    groups = pushes(rng, 10, 1000, half_width=0.001)[0]
    program = LeastSquares(10)
    for k, rows in enumerate(groups):
        program.add(rows)
        if k % 40 == 0:
            assert program.solve().status is Status.OPTIMAL
    fresh = filled(LeastSquares(10), stack(groups, 10))
    assert program.solve().objective == pytest.approx(fresh.solve().objective, rel=1e-9)


# ---- the tie-break


def optimum_of(rows):
    simplex = filled(Simplex(rows.a.shape[1]), rows)
    assert simplex.solve().status is Status.OPTIMAL
    return simplex.certificate()


def most_even(rows):
    return nearest_uniform(rows, optimum_of(rows))


def test_of_equally_good_weights_the_most_even_is_taken():
    # |w0 - w1 - w2| is zero wherever w0 = 1/2
    nearest = most_even(group([1, -1, -1]))
    np.testing.assert_allclose(nearest.w, (0.5, 0.25, 0.25))
    assert nearest.status is Status.OPTIMAL
    assert nearest.objective == pytest.approx(0, abs=1e-15)


def test_one_sided_rows_bound_the_choice():
    # w0 <= w1 / 3 costs nothing: of w with w1 >= 3 w0, (1/5, 7/15, 1/3) is out as 3/5 > 7/15
    nearest = most_even(group([3, -1, 0], above=1, below=0))
    # minimise over (x, 3 x, 1 - 4 x): x + 9 x - 4 (1 - 4 x) = 0
    x = 4 / 26
    np.testing.assert_allclose(nearest.w, (x, 3 * x, 1 - 4 * x))


def test_a_row_with_a_cost_keeps_it():
    # w0 + 2 w1 + 2 w2 + w3 is least on the edge between the first and the last
    np.testing.assert_allclose(most_even(group([1, 2, 2, 1])).w, (0.5, 0, 0, 0.5))


def test_without_rows_all_weights_are_the_same():
    rows = group(np.zeros((0, 4)))
    np.testing.assert_allclose(nearest_uniform(rows, certify(rows, np.array((1.0, 0, 0, 0)), np.zeros(0))).w, 0.25)


def test_the_only_optimum_is_kept():
    rows = group([[1, -1], [1, -3]])
    solution = optimum_of(rows)
    assert nearest_uniform(rows, solution) is solution


def test_a_tie_is_broken_only_between_optima():
    rows = group([1, -1])
    with pytest.raises(ValueError, match="solution must be optimal, got uncertified"):
        nearest_uniform(rows, certify(rows, np.array((1.0, 0.0)), np.zeros(1)))


@QUICK
@given(SEEDS, st.integers(3, 30), st.integers(1, 20), st.sampled_from((0.0, 0.002)))
def test_no_optimum_is_nearer(seed, n, count, half_width):
    rows = stack(pushes(np.random.default_rng(seed), n, count, half_width=half_width)[0], n)
    solution = optimum_of(rows)
    nearest = nearest_uniform(rows, solution)
    assert nearest.status is Status.OPTIMAL
    assert nearest.objective == pytest.approx(solution.objective, rel=2e-9, abs=1e-15)
    y, reduced = solution.multipliers, solution.multipliers @ rows.a
    zero = np.eye(n)[reduced - reduced.min() > 1e-8 * np.abs(reduced).max(initial=0)]
    inside = (y < rows.above - 1e-8) & (y > 1e-8 - rows.below)
    low = np.concatenate((rows.a[~inside & (y >= rows.above - 1e-8)], -rows.a[~inside & (y <= 1e-8 - rows.below)]))
    truth = nearest_by_nnls(np.full(n, 1 / n), np.concatenate((rows.a[inside], zero)), low)
    np.testing.assert_allclose(nearest.w, truth, atol=1e-6)
