"""The posterior of the support friction: its chains keep to the priors, and it finds what was simulated."""

import math

import numpy as np
import pytest

from bench.paper.pushes import filmed, moved, objects
from pushfric_core import Estimator, Observation, Twist
from pushfric_core.estimation.push_plan import even_pushes
from pushfric_core.geometry.table_1 import FEET, FLAT, TABLE_1
from pushfric_core.uncertainty import posterior as posterior_module
from pushfric_core.uncertainty import support_chain
from pushfric_core.uncertainty.posterior import Sampling


@pytest.fixture(scope="module")
def studied():
    return objects()["triangle"]


def seen(studied, noise, seed=3):
    rng = np.random.default_rng(seed)
    return filmed(studied.outline, moved(studied, even_pushes(studied.outline, studied.plans["all"]), rng), noise, rng)


@pytest.fixture(scope="module")
def observations(studied):
    return seen(studied, FEET)


def uniform(points):
    return np.full(len(points), 1 / len(points))


def test_without_data_the_chain_samples_the_prior(studied, observations):
    # at the power 0 of the likelihood, whatever the data are; a wrong ratio of any move shows in these shares
    chain = Sampling(observations[:5], studied.support_points, uniform(studied.support_points))._chains[0]
    rng = np.random.default_rng(1)
    counts, masses, at_points, areas, scales, moments = [], [], [], [], [], []
    for _ in range(12_000):
        support_chain.walk(chain, 20, 0.0, rng.random(1200))
        counts.append(chain.count)
        _, feet, _ = chain.weights()
        masses += np.asarray(chain.mass)[1 : chain.count + 1].tolist()
        middle = studied.support_points.mean(axis=0)
        at_points += [bool(np.any(np.all(foot == studied.support_points - middle, axis=1))) for foot in feet]
        areas.append(math.log(chain.mass[0]))
        scales.append(np.array(chain.scales))
        moments.append(np.array(chain.moments))
    shares = np.bincount(counts, minlength=4)[:4] / len(counts)
    even, more = posterior_module.NO_FEET, posterior_module.MORE
    assert shares == pytest.approx([even, *((1 - even) * (1 - more) * more**k for k in range(3))], rel=0.15)
    assert np.mean(masses) == pytest.approx(1.0, rel=0.1)
    assert np.mean(at_points) == pytest.approx(0.5, abs=0.05)
    assert np.std(areas) == pytest.approx(math.log(1e5) / math.sqrt(12), rel=0.1)
    assert np.std(scales, axis=0) == pytest.approx(np.asarray(chain.priors)[:, 1], rel=0.2)
    assert np.mean(scales, axis=0) == pytest.approx(np.asarray(chain.priors)[:, 0], abs=0.35)
    assert np.std(moments, axis=0) == pytest.approx(np.ones(5), rel=0.15)


def test_it_finds_feet_that_are_no_support_points(studied, observations):
    found = Sampling(observations, studied.support_points, uniform(studied.support_points)).finish()
    error = found.center_of_friction - studied.support.center_of_friction
    assert np.hypot(*error) < 1e-3
    assert found.area < 0.2
    assert error @ np.linalg.solve(found.covariance, error) < 9.2  # 99 %
    assert found.w.sum() == pytest.approx(1.0)
    assert found.samples.sum(axis=1) == pytest.approx(np.ones(len(found.samples)))
    assert found.w @ studied.support_points == pytest.approx(found.center_of_friction, abs=1e-6)
    assert found.data_points == len(observations)


def test_it_finds_an_area():
    known = TABLE_1["delrin_rect_center"]
    studied = objects()["delrin_rect_right"]._replace(support=known.support)
    found = Sampling(seen(studied, FLAT), studied.support_points, uniform(studied.support_points)).finish()
    assert np.hypot(*(found.center_of_friction - known.support.center_of_friction)) < 1e-3


def test_it_is_a_function_of_the_data(studied, observations):
    one = Sampling(observations[:40], studied.support_points, uniform(studied.support_points)).finish()
    other = Sampling(observations[:40][::-1], studied.support_points, uniform(studied.support_points)).finish()
    assert one.center_of_friction.tobytes() == other.center_of_friction.tobytes()
    assert one.samples.tobytes() == other.samples.tobytes()


@pytest.mark.parametrize(
    "points", [[(0.01, 0.02)], [(-0.05, 0.0), (0.05, 0.0)], [(-0.05, 0.0), (0.0, 0.0), (0.05, 0.0)]], ids=["one", "two", "line"]
)
def test_feet_stay_at_support_points_that_span_no_area(points):
    data = [
        Observation((0.01 * (k - 2), -0.03), (0.0, -1.0), Twist(0.0, 0.02, 0.1 * (k - 2)), push_id=k, stamp=k) for k in range(5)
    ]
    found = Sampling(data, np.array(points), uniform(points)).finish()
    assert np.isfinite(found.center_of_friction).all()
    assert found.w.sum() == pytest.approx(1.0)


def test_an_estimate_has_a_posterior_where_it_has_a_spread(studied, observations):
    estimator = Estimator(studied.support_points)
    assert estimator.estimate().posterior is None
    first = [one for one in observations if one.push_id == observations[0].push_id]
    assert estimator.add(first).posterior is None
    estimate = estimator.add([one for one in observations if one.push_id != first[0].push_id])
    assert estimate.posterior is not None
    assert estimate.posterior is estimate.posterior
    given = Estimator(studied.support_points, center_of_friction=studied.support.center_of_friction).add(observations)
    assert given.posterior is None
