"""How far the estimate can be trusted: how often the ellipse holds the truth, what it depends on, and when there is none."""

import numpy as np
import pytest
from problems import four_feet
from scipy.optimize import linprog

from pushfric_core import ConstraintRows, Estimator, EstimatorConfig, Observation, Twist
from pushfric_core.solvers import empty_program
from pushfric_core.uncertainty.reasons import ReasonCode
from pushfric_core.uncertainty.spread import DIRECTIONS, ELLIPSE, FEWEST_PUSHES

FEET = four_feet()
TRUTH = FEET.truth.center_of_friction
PAPER = EstimatorConfig(cor_radius=0.0, tie_break=False)


def noisy(rng, noise, pushes=16, each=3, choices=None):
    """Observations, `each` of them from every push, with rotations that err by `noise` of themselves."""
    data = []
    for push in range(pushes):
        o = FEET.observations[int(rng.integers(choices or len(FEET.observations)))]
        for _ in range(each):
            vx, vy, omega = np.array(o.twist) * (1 + noise * rng.normal(size=3))
            data.append(Observation(o.contact_point, o.contact_normal, Twist(vx, vy, omega), push_id=push))
    return data


def last(data, config=PAPER, **options):
    estimator = Estimator(FEET.truth.points, config, **options)
    estimate = estimator.add(data)
    return estimator, estimate


def highest(rows, tilt, level):
    """The largest tilt . w with F(w) <= level, from scratch: an independent linear program."""
    m, n = rows.a.shape
    parts, limits = [], []
    for a, above, below in zip(rows.a, rows.above, rows.below, strict=True):
        for sign, cost in ((1, above), (-1, below)):
            parts.append(sign * (a if np.isinf(cost) else cost * a))
            limits.append(not np.isinf(cost))
    errors = np.repeat(np.eye(m), 2, axis=0) * -np.array(limits, dtype=float)[:, None]
    within = np.vstack((np.hstack((parts, errors)), np.concatenate((np.zeros(n), np.ones(m)))))
    bound = np.append(np.zeros(2 * m), level)
    total = np.concatenate((np.ones(n), np.zeros(m)))[None]
    return -linprog(np.concatenate((-tilt, np.zeros(m))), within, bound, total, [1.0], bounds=(0, None)).fun


@pytest.mark.parametrize("seed", range(3))
def test_the_extremes_are_those_of_an_independent_program(seed):
    rng = np.random.default_rng(seed)
    points = FEET.outline.grid(5, 4)
    estimator = Estimator(points, EstimatorConfig(confidence=False))
    for observation in noisy(rng, 0.1):
        estimator.add(observation)
    program = estimator._program
    optimum = program.solve()
    rise = 0.3 * optimum.objective
    tilts = DIRECTIONS @ points.T
    found = program.extremes(tilts, rise)
    for tilt, w in zip(tilts, found, strict=True):
        assert tilt @ w == pytest.approx(highest(program.rows(), tilt, optimum.objective + rise), abs=1e-9)
    assert list(program.solve().w) == list(optimum.w)  # the optimum is left alone


def test_extremes_of_many_data_points_lie_beyond_the_first_ball(monkeypatch):
    # the walks may be as long as there are unsettled rows: they grow with the square root of the number of all
    monkeypatch.setattr("pushfric_core.solvers.simplex.SHORTEST_CAP", 0)
    rng = np.random.default_rng(0)
    program = empty_program(24)
    for _ in range(1200):
        program.add(ConstraintRows(rng.normal(size=(1, 24)), np.ones(1), np.ones(1)))
    optimum = program.solve()
    tilts = rng.normal(size=(2, 24))
    rise = 0.02 * optimum.objective
    for tilt, w in zip(tilts, program.extremes(tilts, rise), strict=True):
        assert tilt @ w == pytest.approx(highest(program.rows(), tilt, optimum.objective + rise), abs=1e-8)


def test_the_ellipse_holds_the_truth_about_as_often_as_it_says():
    rng = np.random.default_rng(0)
    held = []
    for _ in range(60):
        _, estimate = last(noisy(rng, 0.1))
        error = estimate.center_of_friction - TRUTH
        held.append(error @ np.linalg.solve(estimate.spread.covariance, error) <= ELLIPSE)
    assert 0.8 <= np.mean(held) <= 1.0


def test_few_pushes_say_nothing_of_it():
    data = noisy(np.random.default_rng(1), 0.1)
    estimator, estimate = last(data)
    assert estimate.confidence > 0
    for push in range(FEWEST_PUSHES - 1, 16):
        estimate = estimator.exclude(push)
    assert (estimate.pushes, estimate.confidence) == (FEWEST_PUSHES - 1, None)
    assert estimate.lack.code == ReasonCode.FEW_PUSHES
    assert estimate.lack.text.startswith("p_CF rests on 3 pushes, and fewer than 4 cannot tell how far it is off")


def test_the_samples_scatter_as_the_covariance_says_and_are_distributions():
    _, estimate = last(noisy(np.random.default_rng(3), 0.1), EstimatorConfig())
    spread = estimate.spread
    assert spread.samples.sum(axis=1) == pytest.approx(np.ones(8))
    assert (spread.samples >= 0).all()
    assert spread.middle.sum() == pytest.approx(1)
    scatter = np.cov((spread.samples @ FEET.truth.points).T)
    assert 0.3 < np.trace(scatter) / np.trace(spread.covariance) < 1.5


@pytest.mark.parametrize(
    ("config", "options"),
    [
        (EstimatorConfig(confidence=False), {}),
        (EstimatorConfig(solver="osqp"), {}),
        (EstimatorConfig(loss="l2"), {}),
        (EstimatorConfig(nonnegative_force=False), {"center_of_friction": TRUTH}),
    ],
)
def test_it_is_not_computed_where_it_has_no_meaning(config, options):
    _, estimate = last(noisy(np.random.default_rng(4), 0.1, 6, each=1), config, **options)
    assert estimate.confidence is None
