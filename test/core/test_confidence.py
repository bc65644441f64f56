"""The radius about p_CF: how often the truth lies within it, and what it depends on."""

import numpy as np
import pytest
from problems import four_feet

from pushfric_core.confidence import FEWEST_PUSHES
from pushfric_core.estimator import Estimator, EstimatorConfig
from pushfric_core.observation import Observation
from pushfric_core.planar import Twist

FEET = four_feet()
TRUTH = FEET.truth.center_of_friction
PAPER = EstimatorConfig(cor_radius=0.0, tie_break=False)


def noisy(rng, noise, pushes=16, each=3):
    """Data points, `each` of them from every push, whose rotations have a relative error of `noise`."""
    data = []
    for push in range(pushes):
        o = FEET.observations[int(rng.integers(len(FEET.observations)))]
        for _ in range(each):
            vx, vy, omega = np.array(o.twist) * (1 + noise * rng.normal(size=3))
            data.append(Observation(o.contact_point, o.contact_normal, Twist(vx, vy, omega), push_id=push))
    return data


def last(data, config=PAPER, **options):
    estimator = Estimator(FEET.truth.points, config, **options)
    for observation in data:
        estimate = estimator.add(observation)
    return estimator, estimate


def test_the_circle_contains_the_truth_about_as_often_as_promised():
    rng = np.random.default_rng(0)
    held = []
    for _ in range(60):
        _, estimate = last(noisy(rng, 0.1))
        held.append(np.hypot(*(estimate.center_of_friction - TRUTH)) <= estimate.confidence)
    assert 0.8 <= np.mean(held) <= 1.0


def test_it_grows_with_the_noise_and_shrinks_with_the_pushes():
    def median(noise, pushes):
        return np.median([last(noisy(np.random.default_rng(seed), noise, pushes))[1].confidence for seed in range(10)])

    assert median(0.05, 12) < 0.7 * median(0.2, 12)
    assert median(0.1, 40) < 0.7 * median(0.1, 8)


def test_noiseless_data_give_a_radius_near_zero():
    _, estimate = last(list(FEET.observations))
    assert estimate.confidence < 1e-9


def test_few_pushes_give_no_radius():
    data = noisy(np.random.default_rng(1), 0.1, FEWEST_PUSHES, each=2)
    estimator, estimate = last(data)
    assert estimate.confidence > 0
    assert estimator.exclude(FEWEST_PUSHES - 1).confidence is None


def test_an_excluded_push_leaves_no_trace():
    data = noisy(np.random.default_rng(2), 0.1)
    estimator, _ = last(data)
    without = estimator.exclude(15)
    _, never = last([observation for observation in data if observation.push_id != 15])
    assert without.confidence == pytest.approx(never.confidence, rel=1e-9)


@pytest.mark.parametrize("loss", ["l1", "l2"])
def test_either_loss_has_it(loss):
    _, estimate = last(noisy(np.random.default_rng(3), 0.1), EstimatorConfig(loss=loss))
    assert 1e-5 < estimate.confidence < 0.05


@pytest.mark.parametrize(
    ("config", "options"),
    [
        (EstimatorConfig(confidence=False), {}),
        (EstimatorConfig(solver="osqp"), {}),
        (EstimatorConfig(nonnegative_force=False), {"center_of_friction": TRUTH}),
    ],
)
def test_it_is_not_computed_if_it_has_no_meaning(config, options):
    _, estimate = last(noisy(np.random.default_rng(4), 0.1, 6, each=1), config, **options)
    assert estimate.confidence is None
