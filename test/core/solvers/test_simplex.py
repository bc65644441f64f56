"""The exact incremental solver against HiGHS, from scratch at every check, and against its own certificate."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from problems import rows_of
from programs import filled, group, highs, pushes, solved_while_rows_come_and_go, solved_with

from pushfric_core.geometry.planar import Twist, left_of
from pushfric_core.program.constraints import (
    Cone,
    ConstraintRows,
    Frictionless,
    Moment,
    NormalForce,
    SensedDirection,
    SensedForce,
    stack,
)
from pushfric_core.solvers import basis, pivoting
from pushfric_core.solvers import simplex as simplex_module
from pushfric_core.solvers.program import HARD_VIOLATION, Status, certify
from pushfric_core.solvers.simplex import CLOSE, Simplex
from pushfric_core.trajectories.observation import Observation

SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(autouse=True)
def sizes(request, monkeypatch):
    """Small balls, in which few rows stay unsettled, so that small programs settle and sort rows; or those of the module."""
    if getattr(request, "param", "small balls") == "small balls":
        monkeypatch.setattr(basis, "ROOM", 4)
        for name, rows in (("CLOSE", 2), ("CLOSE_PER_COLUMN", 1), ("FAR", 4)):
            monkeypatch.setattr(simplex_module, name, rows)


OWN_SIZES = pytest.mark.parametrize("sizes", ["balls"], indirect=True)
BOTH_SIZES = pytest.mark.parametrize("sizes", ["balls", "small balls"], indirect=True)


def examples(count):
    return settings(derandomize=True, deadline=None, max_examples=count)


def noiseless(rng, a):
    a -= (a @ rng.dirichlet(np.full(a.shape[1], 0.3)))[:, None]
    return np.where(np.abs(a) < 1e-12, 0.0, a)  # with one support, only rounding would be left


KINDS = {
    "plain": lambda rng, a: a,
    "duplicated rows": lambda rng, a: a[rng.integers(1 + len(a) // 5, size=len(a))],
    "integer": lambda rng, a: np.round(a),
    "zero rows": lambda rng, a: a * (rng.random((len(a), 1)) < 0.5),
    "noiseless": noiseless,
    "collinear supports": lambda rng, a: a[:, rng.integers(min(a.shape[1], 3), size=a.shape[1])],
    "low rank": lambda rng, a: rng.normal(size=(len(a), 2)) @ rng.normal(size=(2, a.shape[1])),
    "one support": lambda rng, a: a[:, :1],
    "all units": lambda rng, a: a * 10.0 ** rng.integers(-4, 5, (len(a), 1)),
}
"""Coefficients (m, n) for which vertices coincide, made of those in general position."""


def worst_cost(rows, n):
    """The largest cost of any w, without a scale."""
    sides = np.stack((rows.above, rows.below))
    return np.abs(rows.a[:, :n]).max(axis=1, initial=0) @ np.where(np.isinf(sides), 0.0, sides).max(axis=0)


def assert_optimal(simplex, groups, n=None, best=None):
    """Assert that the status is OPTIMAL, that the certificate is true, and that HiGHS agrees, whose F `best` may be known."""
    columns = groups[0].a.shape[1]
    n = n or columns
    optimum, rows = simplex.solve(), stack(groups, columns)
    truth = certify(rows, optimum.w, simplex.multipliers(), optimum.scale if columns > n else None)
    assert (optimum.status, truth.status, simplex.certificate().status) == (Status.OPTIMAL,) * 3
    worst = worst_cost(rows, n)
    assert optimum.objective == pytest.approx(truth.objective, rel=1e-9, abs=1e-14 * worst)
    assert optimum.gap == pytest.approx(truth.gap, abs=1e-9 * max(truth.objective, 1e-6 * worst))
    assert optimum.w.min() >= 0
    assert optimum.w.sum() == pytest.approx(1, abs=1e-12)
    assert optimum.scale >= 0
    assert optimum.objective == pytest.approx(highs(rows, n) if best is None else best, rel=1e-7, abs=1e-9 * worst + 1e-12)
    return optimum


def test_a_problem_by_hand():
    # |w0 - w1| + |w0 - 3 w1| with w0 = 1 - w1: 0.5 at w1 = 1/4, 1 at w1 = 1/2
    simplex = filled(Simplex(2), group([1, -1]))
    np.testing.assert_allclose(simplex.solve().w, (0.5, 0.5))
    optimum = solved_with(simplex, group([1, -3]))
    np.testing.assert_allclose(optimum.w, (0.75, 0.25))
    assert optimum.objective == pytest.approx(0.5)
    assert optimum.lower_bound == pytest.approx(0.5)
    # y0 = 1, and A' y = (0.5, 0.5) asks for y1 = -0.5
    np.testing.assert_allclose(simplex.multipliers(), (1, -0.5))


def test_a_one_sided_row_costs_nothing_on_its_other_side():
    # 5 max(0, 1 - 3 w0) + w0
    optimum = filled(Simplex(2), group([[2, -1], [1, 0]], above=(0, 1), below=(5, 0))).solve()
    np.testing.assert_allclose(optimum.w, (1 / 3, 2 / 3))
    assert optimum.objective == pytest.approx(1 / 3)


@BOTH_SIZES
@examples(40)
@given(SEEDS, st.integers(3, 40))
def test_pushes_agree_with_highs_at_every_observation(seed, n):
    groups, _ = pushes(np.random.default_rng(seed), n, 12)
    simplex = Simplex(n)
    for k, rows in enumerate(groups):
        simplex.add(rows)
        assert_optimal(simplex, groups[: k + 1])


@BOTH_SIZES
@pytest.mark.parametrize("kind", KINDS)
@examples(65)
@given(SEEDS, st.integers(1, 12), st.integers(1, 40), st.booleans(), st.booleans())
def test_degenerate_data_agree_with_highs_while_rows_come_and_go(kind, seed, n, m, hard, with_scale):
    rng = np.random.default_rng(seed)
    a = KINDS[kind](rng, rng.normal(size=(m, n)))
    n = a.shape[1]
    above, below = rng.choice((0.0, 0.05, 1.0, 1.0, 3.0), (2, m))
    scale = 0.0
    if with_scale:  # in any unit of force
        scale = 10.0 ** rng.integers(-3, 4)
        a = np.column_stack((a, rng.normal(size=m) * (rng.random(m) < 0.5) / scale))
    if hard:  # such that some w and scale satisfy them all
        residuals = a @ np.append(rng.dirichlet(np.full(n, 0.3)), [scale] * with_scale)
        below[(rng.random(m) < 0.3) & (residuals > 1e-6)] = np.inf
        above[(rng.random(m) < 0.3) & (residuals < -1e-6)] = np.inf
    simplex = Simplex(n, with_scale)
    assert_optimal(simplex, solved_while_rows_come_and_go(simplex, rng, ConstraintRows(a, above, below)), n)


@pytest.mark.parametrize("soft", [(1.0, 0.0), (0.0, 1.0), (0.2, -1.0)])
@pytest.mark.parametrize("order", [(0, 1, 2), (0, 2, 1), (2, 0, 1)])
@pytest.mark.parametrize("every_time", [True, False])
def test_an_equality_holds_after_its_twin_is_removed(soft, order, every_time):
    equal = group((1.0, -1.0), np.inf, np.inf)
    for gone in (order.index(0), order.index(1)):
        simplex = Simplex(2)
        for kind in order:
            simplex.add((equal, equal, group(soft))[kind])
            if every_time:
                simplex.solve()
        simplex.solve()
        simplex.remove(gone)
        assert simplex.solve().w == pytest.approx((0.5, 0.5))
        assert simplex.solve().status is Status.OPTIMAL


@examples(80)
@given(SEEDS, st.integers(1, 8), st.booleans())
def test_equalities_that_say_the_same_agree_with_highs_while_rows_come_and_go(seed, n, with_scale):
    """Hard rows on both sides, many of them multiples of each other, most of which some w satisfies."""
    rng = np.random.default_rng(seed)
    truth = np.append(rng.dirichlet(np.full(n, 0.5)), [1.0] * with_scale)
    pool = rng.normal(size=(4, n + with_scale))
    pool -= np.outer(pool @ truth / (truth @ truth), truth) * (rng.random(4) < 0.95)[:, None]
    pool[np.abs(pool).max(axis=1) < 1e-9] = 0.0  # rounding would be a contradiction
    simplex, present = Simplex(n, with_scale), {}
    for number in range(10):
        if rng.random() < 0.5:
            sides = rng.choice((0.0, 1.0, np.inf, np.inf), 2)
            present[number] = group(pool[rng.integers(4)] * rng.choice((1.0, -1.0, 2.0)), *sides)
        else:
            present[number] = group(rng.normal(size=(2, n + with_scale)), *rng.choice((0.5, 1.0), 2))
        solved_with(simplex, present[number])
        if len(present) > 1 and rng.random() < 0.4:
            gone = int(rng.choice(list(present)))
            simplex.remove(gone)
            del present[gone]
        if (best := highs(stack(list(present.values()), n + with_scale), n)) is None:
            assert simplex.solve().status is Status.INFEASIBLE
        else:
            assert_optimal(simplex, list(present.values()), n, best)


TERMS = {
    "moment": Moment(),
    "frictionless": Frictionless(0.05),
    "cone": Cone(0.4, 0.05),
    "force": SensedForce(0.05),
    "direction": SensedDirection(0.1, 0.05),
    "soft normal force": NormalForce(0.5),
    "normal force": NormalForce(),
}


@BOTH_SIZES
@examples(60)
@given(SEEDS, st.integers(1, 15), st.sets(st.sampled_from(sorted(TERMS)), min_size=1), st.booleans(), st.booleans())
def test_every_constraint_of_the_estimator_agrees_with_highs(seed, n, terms, intervals, collinear):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.05, 0.05, (n, 2)) * (1.0, not collinear)
    w, groups = rng.dirichlet(np.full(n, 0.5)), []
    simplex = Simplex(n, with_scale="force" in terms)
    while len(groups) < 12:
        twist = Twist(*rng.normal(size=2) * 0.05, rng.normal())
        velocities = (twist.vx, twist.vy) + twist.omega * left_of(points)
        force = w @ (velocities / np.hypot(*velocities.T)[:, None])
        angle = np.arctan2(*force[::-1]) + np.pi + rng.uniform(-1, 1)
        observation = Observation(
            contact_point=tuple(rng.uniform(-0.05, 0.05, 2)),
            contact_normal=(np.cos(angle), np.sin(angle)),
            twist=twist,
            half_width=0.005 * intervals,
            force=tuple(8.0 * force + 0.3 * rng.normal(size=2)),
        )
        groups.append(stack([rows_of(TERMS[term], observation, points) for term in sorted(terms)], n + ("force" in terms)))
        optimum = solved_with(simplex, groups[-1])
    rows = stack(groups, n + ("force" in terms))
    best = highs(rows, n)
    if best is None:
        assert optimum.status is Status.INFEASIBLE
        return
    assert_optimal(simplex, groups, n, best)
    for coordinate in points.T:  # p_CF is among those of all optima; usually there is only one
        limit = best + 1e-9 * max(best, worst_cost(rows, n))
        low, high = highs(rows, n, coordinate, limit), highs(rows, n, -coordinate, limit)
        if low is not None and high is not None:
            assert low - 1e-6 <= coordinate @ optimum.w <= -high + 1e-6


@examples(200)
@given(SEEDS, st.integers(1, 12), st.integers(-15, -8))
@example(384, 9, -11)  # descents that tolerate violations go in circles
@example(2919128732, 7, -10)
def test_rows_that_almost_contradict_each_other_end_optimal_or_infeasible(seed, n, exponent):
    rng = np.random.default_rng(seed)
    w, m = rng.dirichlet(np.full(n, 0.5)), 3 * n + 6
    a = rng.normal(size=(m, n))
    tight = rng.random(m) < 0.4
    a[tight] -= (a[tight] @ w)[:, None]
    largest = np.abs(a).max(axis=1, keepdims=True)  # the unit of a violation
    a[tight] += 10.0**exponent * largest[tight] * rng.normal(size=(tight.sum(), 1))
    rows = ConstraintRows(a, np.ones(m), np.where(tight, np.inf, 1.0))
    simplex = Simplex(n)
    for k in range(0, m, 3):
        optimum = solved_with(simplex, ConstraintRows(*(part[k : k + 3] for part in rows)))
        # what remains open is as small as the tolerated violations
        assert optimum.status is not Status.UNCERTIFIED or optimum.gap < HARD_VIOLATION * m
    tolerant = rows._replace(a=a + 10 * HARD_VIOLATION * largest * tight[:, None])
    # a vertex may enlarge the errors of its rows some hundred times
    if n > 1 and highs(tolerant) is not None and 10.0**exponent < HARD_VIOLATION / 500:
        assert optimum.status is Status.OPTIMAL


@examples(120)
@given(SEEDS, st.integers(2, 10))
def test_while_infeasible_w_fits_best_among_those_of_least_violation(seed, n):
    rng = np.random.default_rng(seed)
    m = 3 * n
    hard = ConstraintRows(rng.normal(size=(m, n)), np.zeros(m), np.full(m, np.inf))
    soft = group(rng.normal(size=(m, n)))
    simplex, groups = Simplex(n), []
    for k in range(m):
        groups.append(stack([ConstraintRows(*(part[k : k + 1] for part in rows)) for rows in (hard, soft)], n))
        optimum = solved_with(simplex, groups[-1])
    if optimum.status is not Status.INFEASIBLE:
        assert_optimal(simplex, groups)
        return
    assert simplex.certificate().status is Status.INFEASIBLE
    # violations are measured in rows scaled by powers of two
    scaled = hard.a / np.exp2(np.frexp(np.abs(hard.a).max(axis=1))[1])[:, None]
    least = highs(ConstraintRows(scaled, np.zeros(m), np.ones(m)))
    assert np.maximum(-scaled @ optimum.w, 0).sum() == pytest.approx(least, rel=1e-9)
    weight = 1e6  # of a violation, so large that the fit hardly counts
    both = stack([ConstraintRows(scaled, np.zeros(m), np.full(m, weight)), soft], n)
    assert optimum.objective == pytest.approx(highs(both) - weight * least, rel=1e-4, abs=1e-4)


@examples(40)
@given(SEEDS, st.integers(2, 15))
def test_contradicting_groups_are_named_and_removing_one_helps(seed, n):
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


def test_a_group_may_be_empty():
    simplex = filled(Simplex(2), group(np.zeros((0, 2))), group([1, -1]))
    np.testing.assert_allclose(simplex.solve().w, (0.5, 0.5))
    simplex.remove(0)
    np.testing.assert_allclose(simplex.solve().w, (0.5, 0.5))


def test_the_scale_turns_newtons_into_weights():
    # two supports that push along x and y; the sensor reads 2 N and 6 N against them: 8 N in total
    simplex = Simplex(2, with_scale=True)
    assert simplex.solve().scale == 0
    optimum = solved_with(simplex, group([[1, 0, -2], [0, 1, -6]]))
    np.testing.assert_allclose(optimum.w, (0.25, 0.75))
    assert optimum.scale == pytest.approx(1 / 8)
    assert simplex.certificate().scale == optimum.scale
    simplex.add(group([1, -1, 0]))
    simplex.remove(0)
    assert simplex.solve().scale == 0


def test_a_scale_that_costs_nothing_may_be_anything():
    # only -(w0 + w1) + s >= 0 is required, as a hard row; then w0 = w1
    groups = group([-1, -1, 1], above=0.0, below=3.0), group([1, -1, 0])
    optimum = assert_optimal(filled(Simplex(2, with_scale=True), *groups), groups, 2)
    assert optimum.objective == pytest.approx(0, abs=1e-15)
    assert optimum.scale >= 1


@examples(60)
@given(SEEDS, st.integers(2, 25))
def test_the_order_of_arrival_does_not_matter(seed, n):
    rng = np.random.default_rng(seed)
    groups, _ = pushes(rng, n, 25)
    objectives = []
    for order in (range(25), rng.permutation(25), rng.permutation(25)):
        simplex = Simplex(n)
        for k in order:
            solved_with(simplex, groups[k])
        objectives.append(simplex.solve().objective)
    assert objectives == pytest.approx([objectives[0]] * 3, rel=1e-9)


def test_noiseless_pushes_find_a_perfect_fit(rng):
    groups, truth = pushes(rng, 12, 150, noise=0.0)
    simplex = Simplex(12)
    for rows in groups:
        optimum = solved_with(simplex, rows)
        assert optimum.status is Status.OPTIMAL
        assert optimum.objective < 1e-14
    np.testing.assert_allclose(optimum.w, truth, atol=1e-9)


@OWN_SIZES
@pytest.mark.parametrize("n", [1, 10])
def test_thousands_of_rows_settle_and_the_certificate_stays_true(rng, n):
    groups, _ = pushes(rng, n, 4096)  # two rows each: both balls are sorted several times
    simplex = Simplex(n)
    for k, rows in enumerate(groups):
        optimum = solved_with(simplex, rows)
        assert optimum.status is Status.OPTIMAL
        if k % 256 == 0:
            assert simplex.certificate().objective == pytest.approx(optimum.objective, rel=1e-12)
            assert simplex.certificate().status is Status.OPTIMAL
    assert filled(Simplex(n), stack(groups, n)).solve().objective == pytest.approx(optimum.objective, rel=1e-9)


def test_the_cost_of_a_data_point_does_not_grow_with_their_number(rng, monkeypatch):
    rank, looked_at = pivoting.rank, []
    monkeypatch.setattr(pivoting, "rank", lambda numbers, *others: (looked_at.append(len(numbers)), rank(numbers, *others))[1])
    groups, _ = pushes(rng, 5, 8192)
    simplex, totals = Simplex(5), [0]
    for k, rows in enumerate(groups, 1):
        assert solved_with(simplex, rows).status is Status.OPTIMAL
        if k in (1024, 4096, 8192):
            totals.append(sum(looked_at))
    early, _, late = np.diff(totals) / (1024, 3072, 4096)
    assert late < 3 * early  # rows an observation; with only two balls, ten times as many
    assert simplex.certificate().status is Status.OPTIMAL


@OWN_SIZES
def test_a_walk_does_not_stray_from_its_ball(rng, monkeypatch):
    improve, ends, exchanges = pivoting.improve, [], []

    def watched(state, ball, *arguments):
        x, before = state.conditions.x, state.updates
        near = pivoting.holds(ball, x, 2.0)
        result = improve(state, ball, *arguments)
        exchanges[-1] += state.updates - before
        assert pivoting.holds(ball, x, 2.001) or not near
        assert exchanges[-1] < 500  # one that strays takes a thousand and more to come back
        ends.append(result[0])
        return result

    monkeypatch.setattr(pivoting, "improve", watched)
    groups, _ = pushes(rng, 60, 4000, bearing=60)
    simplex = Simplex(60)
    for rows in groups:
        exchanges.append(0)
        assert solved_with(simplex, rows).status is Status.OPTIMAL
    assert ends.count(False) > 100  # outside of it, or short of leaving it


def test_a_hard_row_that_only_a_larger_scale_meets():
    simplex = filled(Simplex(1, with_scale=True), group([[0.1, -10.0]]))
    assert simplex.solve().scale == pytest.approx(0.01)
    simplex.add(group([[0.3, -3.7], [0.4, -9.9]], above=np.inf, below=0.0))
    # beyond the second of them no row is ahead, and only rounding keeps the violation from having no slope any more
    assert simplex.solve().status is Status.OPTIMAL
    assert simplex.solve().scale == pytest.approx(0.3 / 3.7)


@OWN_SIZES
def test_a_sudden_change_of_the_data_moves_settled_rows(rng):
    before, _ = pushes(rng, 8, 500)
    after, _ = pushes(rng, 8, 1500)
    simplex = Simplex(8)
    for k, rows in enumerate(before + after):
        if solved_with(simplex, rows).status is Status.INFEASIBLE:
            simplex.remove(k)
            assert simplex.solve().status is Status.OPTIMAL
    assert simplex.certificate().status is Status.OPTIMAL


@OWN_SIZES
def test_a_sliding_window_forgets(rng):
    groups, _ = pushes(rng, 10, 16 * CLOSE)
    simplex = Simplex(10)
    for k, rows in enumerate(groups):
        simplex.add(rows)
        if k >= 50:
            simplex.remove(k - 50)
        assert simplex.solve().status is Status.OPTIMAL
    assert len(simplex.multipliers()) == 100
    assert_optimal(simplex, groups[-50:])


@OWN_SIZES
def test_removal_of_settled_rows(rng):
    groups, _ = pushes(rng, 10, 2000)
    simplex = Simplex(10)
    for rows in groups:
        solved_with(simplex, rows)
    for gone in range(0, 2000, 3):
        simplex.remove(gone)
        assert simplex.solve().status is Status.OPTIMAL
    assert_optimal(simplex, [rows for k, rows in enumerate(groups) if k % 3])


def test_weights_of_an_optimum_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        Simplex(2).solve().w[0] = 1


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        (group(np.ones((2, 3))), r"shapes \(m, 2\), \(m,\), \(m,\); got \(2, 3\), \(2,\), \(2,\)"),
        (group([1, np.nan]), "coefficients of the rows must be finite"),
        (group([1, -np.inf]), "coefficients of the rows must be finite"),
        (group([1, 1e200]), "coefficients of the rows must be finite, and at most 1e.150"),
        (group([1, 2], above=1e200), "costs of the rows must not be negative or NaN, and at most 1e.150 or infinite"),
        (group([1, 2], above=-1), "costs of the rows must not be negative"),
        (group([1, 2], below=np.nan), "costs of the rows must not be negative or NaN"),
    ],
)
def test_rows_that_cannot_be_used_change_nothing(rows, text):
    others = [group([3, -1]), group([1, -1])]
    simplex = filled(Simplex(2), others[0])
    before = simplex.solve()
    for bad in (rows, stack([group([2.0, -1.0]), rows], rows.a.shape[1])):
        with pytest.raises(ValueError, match=text.replace("2", r"\d")):
            simplex.add(bad)
    assert simplex.solve() is before
    simplex.add(others[1])
    assert_optimal(simplex, others)


@pytest.mark.parametrize(
    "kind",
    [
        lambda part: part.astype(np.float32),
        lambda part: part.astype(int),
        lambda part: part.astype(object),
        lambda part: np.broadcast_to(part, (2, *part.shape))[0],
        lambda part: np.repeat(part, 2, axis=0)[::2],
        np.asfortranarray,
    ],
)
def test_rows_may_come_in_any_kind_of_array(kind):
    simplex = filled(Simplex(3), ConstraintRows(*map(kind, group([[1, -1, 0], [0, 2, -1]]))))
    np.testing.assert_allclose(simplex.solve().w, (0.25, 0.25, 0.5))


def test_a_row_may_contain_only_the_scale():
    simplex = filled(Simplex(1, with_scale=True), group([[1.0, -1.0]]), group([[1e-200, 1.0]], above=2.0))  # 2 s + |1 - s|
    assert simplex.solve()[1:3] == (0.0, 1.0)


def test_while_nothing_changes_the_optimum_stays_the_same():
    simplex = filled(Simplex(2), group([1, -1]))
    optimum = simplex.solve()
    assert simplex.solve() is optimum
    assert solved_with(simplex, group([1, -3])).objective == pytest.approx(0.5)
    assert optimum.objective == 0
    simplex.remove(1)
    assert simplex.solve().objective == 0
