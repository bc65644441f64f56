"""The exact incremental solver against HiGHS, from scratch at every check, and against its own certificate."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from pushfric_core.constraints import ConstraintRows, stack
from pushfric_core.linear_program import Status, certify
from pushfric_core.planar import cross, left_of
from pushfric_core.simplex import CLOSE, FAR, Simplex

SEEDS = st.integers(0, 2**32 - 1)
QUICK = settings(derandomize=True, deadline=None, max_examples=40)


def highs(rows):
    """Optimal F, or None where the hard rows contradict each other."""
    m, n = rows.a.shape
    sides = np.concatenate((rows.above, rows.below))
    result = linprog(
        np.concatenate((np.zeros(n), np.where(np.isinf(sides), 0.0, sides))),
        A_eq=np.block([[rows.a, -np.eye(m), np.eye(m)], [np.ones((1, n)), np.zeros((1, 2 * m))]]),
        b_eq=np.append(np.zeros(m), 1.0),
        bounds=[(0, 1)] * n + [(0, 0 if np.isinf(side) else None) for side in sides],
        method="highs",
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )
    assert result.status in (0, 2), result.message
    return result.fun if result.status == 0 else None


def group(a, above=1.0, below=1.0):
    a = np.atleast_2d(np.asarray(a, dtype=float))
    return ConstraintRows(a, np.broadcast_to(above, len(a)).astype(float), np.broadcast_to(below, len(a)).astype(float))


def pushes(rng, n, count, noise=1e-3):
    """Data points of an object 0.1 m wide that rests on three of n supports: a moment row and the hard row f.n >= 0 of each."""
    points = rng.uniform(-0.05, 0.05, (n, 2))
    w = np.zeros(n)
    w[rng.choice(n, min(n, 3), replace=False)] = rng.dirichlet(np.ones(min(n, 3)))
    groups = []
    while len(groups) < count:
        velocities = rng.choice((-1, 1)) * left_of(points - rng.uniform(-0.15, 0.15, 2))
        directions = -velocities / np.hypot(*velocities.T)[:, None]
        force, moment = w @ directions, w @ cross(points, directions)
        if np.hypot(*force) < 0.1:
            continue
        contact = left_of(force) * -moment / (force @ force) + noise * rng.normal(size=2)
        tilt = rng.uniform(-1.4, 1.4)
        normal = (force * np.cos(tilt) + left_of(force) * np.sin(tilt)) / np.hypot(*force)
        a = np.stack((cross(points - contact, directions), directions @ normal))
        groups.append(ConstraintRows(a, np.array((1.0, 0.0)), np.array((1.0, np.inf))))
    return groups, w


def degenerate(kind, rng, n, m):
    """Coefficients (m, n) of a kind that makes vertices coincide."""
    a = rng.normal(size=(m, n))
    match kind:
        case "plain":
            return a
        case "duplicated rows":
            return a[rng.integers(1 + m // 5, size=m)]
        case "integer":
            return np.round(a)
        case "zero rows":
            return a * (rng.random((m, 1)) < 0.5)
        case "noiseless":
            a -= (a @ rng.dirichlet(np.full(n, 0.3)))[:, None]
            return np.where(np.abs(a) < 1e-12, 0.0, a)  # with one support, all is rounding
        case "collinear supports":
            return a[:, rng.integers(min(n, 3), size=n)]
        case "low rank":
            return rng.normal(size=(m, 2)) @ rng.normal(size=(2, n))
        case "one support":
            return a[:, :1]
        case "all units":
            return a * 10.0 ** rng.integers(-4, 5, (m, 1))
    raise AssertionError(kind)


def assert_optimal(simplex, groups):
    """The optimum says OPTIMAL, its certificate is true, and HiGHS agrees."""
    optimum, rows = simplex.solve(), stack(groups, groups[0].a.shape[1])
    truth = certify(rows, optimum.w, simplex.multipliers())
    assert (optimum.status, truth.status, simplex.certificate().status) == (Status.OPTIMAL,) * 3
    sides = np.stack((rows.above, rows.below))
    worst = np.abs(rows.a).max(axis=1) @ np.where(np.isinf(sides), 0.0, sides).max(axis=0)
    assert optimum.objective == pytest.approx(truth.objective, rel=1e-9, abs=1e-14 * worst)
    assert optimum.gap == pytest.approx(truth.gap, abs=1e-9 * max(truth.objective, 1e-6 * worst))
    assert optimum.w.min() >= 0
    assert optimum.w.sum() == pytest.approx(1, abs=1e-12)
    assert optimum.objective == pytest.approx(highs(rows), rel=1e-7, abs=1e-9 * worst + 1e-12)
    return optimum


def test_a_problem_by_hand():
    # |w0 - w1| + |w0 - 3 w1| with w0 = 1 - w1: 0.5 at w1 = 1/4, 1 at w1 = 1/2
    simplex = Simplex(2)
    simplex.add(group([1, -1]))
    np.testing.assert_allclose(simplex.solve().w, (0.5, 0.5))
    simplex.add(group([1, -3]))
    optimum = simplex.solve()
    np.testing.assert_allclose(optimum.w, (0.75, 0.25))
    assert optimum.objective == pytest.approx(0.5)
    assert optimum.lower_bound == pytest.approx(0.5)
    # y0 = 1, and A' y = (0.5, 0.5) asks for y1 = -0.5
    np.testing.assert_allclose(simplex.multipliers(), (1, -0.5))


def test_without_rows_any_weights_are_optimal():
    optimum = Simplex(3).solve()
    assert optimum.w.sum() == 1
    assert optimum[1:] == (0, 0, 0, Status.OPTIMAL)


def test_a_one_sided_row_costs_nothing_on_its_other_side():
    simplex = Simplex(2)
    simplex.add(group([[2, -1], [1, 0]], above=(0, 1), below=(5, 0)))
    # 5 max(0, 1 - 3 w0) + w0
    optimum = simplex.solve()
    np.testing.assert_allclose(optimum.w, (1 / 3, 2 / 3))
    assert optimum.objective == pytest.approx(1 / 3)


def test_a_hard_row_holds_whatever_it_costs():
    simplex = Simplex(2)
    simplex.add(group([1, 0], above=1e6))
    simplex.add(group([2, -1], above=0, below=np.inf))
    np.testing.assert_allclose(simplex.solve().w, (1 / 3, 2 / 3))


def test_an_equality_holds():
    simplex = Simplex(3)
    simplex.add(group([1, 0, 0]))
    simplex.add(group([[1, -1, 0], [2, -2, 0], [1, 1, -1]], above=np.inf, below=np.inf))
    np.testing.assert_allclose(simplex.solve().w, (0.25, 0.25, 0.5), atol=1e-12)


@QUICK
@given(SEEDS, st.integers(3, 40))
def test_pushes_agree_with_highs_at_every_data_point(seed, n):
    groups, _ = pushes(np.random.default_rng(seed), n, 12)
    simplex = Simplex(n)
    for k, rows in enumerate(groups):
        simplex.add(rows)
        assert_optimal(simplex, groups[: k + 1])


@pytest.mark.parametrize(
    "kind",
    [
        "plain",
        "duplicated rows",
        "integer",
        "zero rows",
        "noiseless",
        "collinear supports",
        "low rank",
        "one support",
        "all units",
    ],
)
@QUICK
@given(SEEDS, st.integers(1, 30), st.integers(1, 60), st.booleans())
def test_degenerate_data_agree_with_highs_while_rows_come_and_go(kind, seed, n, m, hard):
    rng = np.random.default_rng(seed)
    a = degenerate(kind, rng, n, m)
    above, below = rng.choice((0.0, 0.05, 1.0, 1.0, 3.0), (2, m))
    if hard:  # such that some w satisfies them all
        residuals = a @ rng.dirichlet(np.full(a.shape[1], 0.3))
        below[(rng.random(m) < 0.3) & (residuals > 1e-6)] = np.inf
        above[(rng.random(m) < 0.3) & (residuals < -1e-6)] = np.inf
    simplex, present = Simplex(a.shape[1]), {}
    for number, rows in enumerate(np.array_split(np.arange(m), 1 + m // 4)):
        present[number] = ConstraintRows(a[rows], above[rows], below[rows])
        simplex.add(present[number])
        simplex.solve()
        if len(present) > 2 and rng.random() < 0.3:
            gone = int(rng.choice(list(present)))
            simplex.remove(gone)
            del present[gone]
    assert_optimal(simplex, list(present.values()))


@QUICK
@given(SEEDS, st.integers(2, 15))
def test_contradicting_groups_are_named_and_their_removal_mends_it(seed, n):
    rng = np.random.default_rng(seed)
    groups = [group(rng.normal(size=(2, n)), above=(1.0, 0.0), below=(1.0, np.inf)) for _ in range(8 * n)]
    simplex, present = Simplex(n), {}
    for number, rows in enumerate(groups):
        simplex.add(rows)
        present[number] = rows
        while simplex.solve().status is Status.INFEASIBLE:
            conflicts = simplex.conflicts()
            assert highs(stack([present[conflict] for conflict in conflicts], n)) is None
            simplex.remove(conflicts[-1])
            del present[conflicts[-1]]
        assert simplex.conflicts() == []
    assert len(present) < len(groups)
    assert_optimal(simplex, list(present.values()))


def test_while_infeasible_w_stays_in_the_simplex():
    simplex = Simplex(2)
    simplex.add(group([1, -3], above=0, below=np.inf))
    simplex.add(group([0.1, -1]))
    simplex.add(group([-1, 2], above=0, below=np.inf))
    optimum = simplex.solve()
    assert optimum.status is Status.INFEASIBLE
    assert simplex.certificate().status is Status.INFEASIBLE
    assert simplex.conflicts() == [0, 2]
    assert optimum.w.min() >= 0
    assert optimum.w.sum() == pytest.approx(1)
    assert optimum.lower_bound == 0


@QUICK
@given(SEEDS, st.integers(2, 25))
def test_the_order_of_arrival_does_not_matter(seed, n):
    rng = np.random.default_rng(seed)
    groups, _ = pushes(rng, n, 40)
    objectives = []
    for order in (range(40), rng.permutation(40), rng.permutation(40)):
        simplex = Simplex(n)
        for k in order:
            simplex.add(groups[k])
            simplex.solve()
        objectives.append(simplex.solve().objective)
    assert objectives == pytest.approx([objectives[0]] * 3, rel=1e-9)


def test_rows_added_together_or_one_by_one_give_the_same(rng):
    groups, _ = pushes(rng, 20, 100)
    together, one_by_one = Simplex(20), Simplex(20)
    together.add(stack(groups, 20))
    for rows in groups:
        one_by_one.add(rows)
        one_by_one.solve()
    assert together.solve().objective == pytest.approx(one_by_one.solve().objective, rel=1e-9)


def test_noiseless_pushes_find_a_perfect_fit(rng):
    groups, truth = pushes(rng, 12, 150, noise=0.0)
    simplex = Simplex(12)
    for rows in groups:
        simplex.add(rows)
        optimum = simplex.solve()
        assert optimum.status is Status.OPTIMAL
        assert optimum.objective < 1e-14
    np.testing.assert_allclose(optimum.w, truth, atol=1e-9)


@pytest.mark.parametrize("n", [1, 10])
def test_thousands_of_rows_settle_and_the_certificate_stays_true(rng, n):
    groups, _ = pushes(rng, n, FAR)  # two rows each: both balls are sorted several times
    simplex = Simplex(n)
    for k, rows in enumerate(groups):
        simplex.add(rows)
        optimum = simplex.solve()
        assert optimum.status is Status.OPTIMAL
        if k % 256 == 0:
            assert simplex.certificate().objective == pytest.approx(optimum.objective, rel=1e-12)
            assert simplex.certificate().status is Status.OPTIMAL
    fresh = Simplex(n)
    fresh.add(stack(groups, n))
    assert fresh.solve().objective == pytest.approx(optimum.objective, rel=1e-9)


def test_a_sudden_change_of_the_data_moves_settled_rows(rng):
    before, _ = pushes(rng, 8, 500)
    after, _ = pushes(rng, 8, 1500)
    simplex = Simplex(8)
    for k, rows in enumerate(before + after):
        simplex.add(rows)
        if simplex.solve().status is Status.INFEASIBLE:
            simplex.remove(k)
            assert simplex.solve().status is Status.OPTIMAL
    assert simplex.certificate().status is Status.OPTIMAL


def test_a_sliding_window_forgets(rng):
    groups, _ = pushes(rng, 10, 8 * CLOSE)
    simplex = Simplex(10)
    for k, rows in enumerate(groups):
        simplex.add(rows)
        if k >= 50:
            simplex.remove(k - 50)
        assert simplex.solve().status is Status.OPTIMAL
    assert len(simplex.multipliers()) == 100
    assert_optimal(simplex, groups[-50:])


def test_removal_of_settled_rows(rng):
    groups, _ = pushes(rng, 10, 2000)
    simplex = Simplex(10)
    for rows in groups:
        simplex.add(rows)
        simplex.solve()
    for gone in range(0, 2000, 3):
        simplex.remove(gone)
        assert simplex.solve().status is Status.OPTIMAL
    assert_optimal(simplex, [rows for k, rows in enumerate(groups) if k % 3])


def test_units_do_not_matter(rng):
    groups, _ = pushes(rng, 10, 30)
    metres, millimetres = Simplex(10), Simplex(10)
    for a, above, below in groups:
        metres.add(ConstraintRows(a, above, below))
        millimetres.add(ConstraintRows(a * 1000, above / 1000, below / 1000))
    np.testing.assert_allclose(metres.solve().w, millimetres.solve().w, atol=1e-9)


def test_weights_of_an_optimum_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        Simplex(2).solve().w[0] = 1


def test_a_support_needs_a_point():
    with pytest.raises(ValueError, match="n must be at least 1, got 0"):
        Simplex(0)


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        (group(np.ones((2, 3))), r"shapes \(m, 2\), \(m,\), \(m,\), m > 0; got \(2, 3\), \(2,\), \(2,\)"),
        (group(np.ones((0, 2))), r"m > 0; got \(0, 2\)"),
        (group([1, np.nan]), "coefficients of the rows must be finite"),
        (group([1, -np.inf]), "coefficients of the rows must be finite"),
        (group([1, 2], above=-1), "costs of the rows must not be negative"),
        (group([1, 2], below=np.nan), "costs of the rows must not be negative or NaN"),
    ],
)
def test_rows_that_cannot_be_used(rows, text):
    simplex = Simplex(2)
    with pytest.raises(ValueError, match=text):
        simplex.add(rows)
    assert len(simplex.multipliers()) == 0


def test_only_a_present_group_can_be_removed():
    simplex = Simplex(2)
    simplex.add(group([1, 2]))
    with pytest.raises(ValueError, match="there is no group 1 to remove"):
        simplex.remove(1)
    simplex.remove(0)
    with pytest.raises(ValueError, match="there is no group 0 to remove"):
        simplex.remove(0)
