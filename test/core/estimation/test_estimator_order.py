"""What an estimate says depends on the observations and the settings alone: not on order, history, or when somebody asked."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from problems import observations_of, seen_often, square

from pushfric_core import Estimator, EstimatorConfig, Observation, Support, Twist

FEET = Support(0.04 * np.array(((-1, -1), (1, -1), (1, 1), (-1, 1))), np.array((0.1, 0.2, 0.3, 0.4)))
GRID = square().grid(5, 4)
BAD = 5


def noisy(seed, bad=True, pushes=12, each=4):
    """Observations of pushes, `each` of every push, with noise; those of one push tell another motion than its tip allows."""
    rng, data = np.random.default_rng(seed), []
    for one in seen_often(observations_of(square(), FEET, 0.5, pushes, rng), rng, times=each):
        twist = (0.3 if bad and one.push_id == BAD else 1.0) * np.array(one.twist)
        data.append(replace(one, twist=Twist(*twist.tolist()), stamp=len(data) + 1))
    return data


def figures(estimator):
    """Every number that an estimator says, and everything else that it says but whether the object changed."""
    estimate = estimator.estimate()
    verdict = estimate.verdict
    solution, belief, mu_c = estimate.solution, estimate.belief, estimate.mu_c
    numbers = {
        "w": solution.w,
        "fit": (solution.objective, solution.lower_bound),
        "p_CF": estimate.center_of_friction,
        "lower bounds": (estimate.mu_c_p90, estimate.mu_c_max),
        "mu_c": tuple(np.nan if value is None else value for value in mu_c[:3]),
        "belief": (*belief.center_of_friction, belief.confidence, belief.misfit),
        "intervals": belief.intervals,
    }
    words = (
        verdict.rejected,
        verdict.mistakes,
        verdict.notes,
        estimate.lack,
        estimate.status,
        estimate.stamp,
        estimate.data_points,
    )
    return numbers, words


def estimator_of(data, points=GRID, config=None):
    estimator = Estimator(points, config)
    estimator.add(data)
    return estimator


def check_same(one, other, tolerance=1e-9):
    (numbers, words), (others, other_words) = figures(one), figures(other)
    assert words == other_words
    assert numbers.keys() == others.keys()
    for name, values in numbers.items():
        assert np.asarray(values) == pytest.approx(np.asarray(others[name]), abs=tolerance, nan_ok=True), name


def by_push(data, order):
    return [one for push_id in order for one in data if one.push_id == push_id]


CONFIGS = {
    "default": EstimatorConfig(),
    "paper": EstimatorConfig(cor_radius=0.0),
    "cone": EstimatorConfig(terms=("moment", "cone"), mu_bound=0.6),
}


@functools.cache
def in_order(config, seed):
    """The observations and their estimator."""
    data = noisy(seed)
    return data, estimator_of(data, config=CONFIGS[config])


@pytest.mark.parametrize("config", CONFIGS)
@settings(max_examples=5, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(order=st.permutations(range(12)), seed=st.integers(0, 1))
def test_the_order_of_the_pushes_does_not_matter(config, order, seed):
    data, estimator = in_order(config, seed)
    assert BAD in {one.push_id for one in estimator.rejected}
    check_same(estimator, estimator_of(by_push(data, order), config=CONFIGS[config]))


def test_one_at_a_time_or_all_at_once_gives_the_same_bits():
    data = noisy(1)
    asked, once = Estimator(GRID), estimator_of(data)
    for observation in data:
        asked.add(observation)
        if observation.stamp % 9 == 0:
            asked.estimate()
    assert asked.estimate() == once.estimate()
    assert asked.estimate().judgement == once.estimate().judgement


def test_a_push_that_was_excluded_leaves_no_trace():
    data = noisy(2)
    without = [one for one in data if one.push_id != 3]
    estimator = estimator_of(data)
    assert estimator.exclude(3) == estimator_of(without).estimate()
    again = estimator.add([one for one in data if one.push_id == 3])
    assert again == estimator_of(without + [one for one in data if one.push_id == 3]).estimate()
    check_same(estimator, estimator_of(data))


def test_a_setting_that_cannot_act_is_refused():
    for options in ({"solver": "osqp"}, {"loss": "l2"}):
        assert not EstimatorConfig(**options).exact
        for name in ("tie_break", "screening"):
            with pytest.raises(ValueError, match=f"{name} needs the loss l1 and the solver simplex, got .*; leave it to auto"):
                EstimatorConfig(**options, **{name: True})
            assert getattr(EstimatorConfig(**options, **{name: False}), name) is False
    with pytest.raises(ValueError, match="tie_break cannot act with the term force"):
        EstimatorConfig(terms=("force",), tie_break=True)
    with pytest.raises(ValueError, match="asks where p_CF is, but it is given"):
        Estimator(GRID, EstimatorConfig(screening=True), center_of_friction=(0.0, 0.0))


def test_some_observations_are_taken_all_or_none():
    estimator = Estimator(FEET.points, EstimatorConfig(cor_radius=0.0))
    good = noisy(0, pushes=1)
    before = estimator.add(good)
    x, y = FEET.points[1]
    turn = Observation((0.05, 0.0), (0.0, -1.0), Twist(y, -x, 1.0))
    with pytest.raises(ValueError, match="push_id must be one of 0, got 9"):
        estimator.exclude(9)
    with pytest.raises(Exception, match="support point"):
        estimator.add([good[0], turn])
    assert estimator.estimate() == before
