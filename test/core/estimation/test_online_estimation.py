from dataclasses import replace

import numpy as np
import pytest
from problems import narrowed, observations_of

from pushfric_core import Estimator, EstimatorConfig, Hypothesis, Observation, Outline, Recognizer, Support, UninformativePush
from pushfric_core.estimation.online_estimation import OnlineEstimation
from pushfric_core.geometry.planar import Twist, velocity_at
from pushfric_core.steps import finished

BAR = Outline.rectangle(0.12, 0.06)
TRUTH = Support([(-0.05, -0.02), (0.05, -0.02), (0.05, 0.02), (-0.05, 0.02)], [0.1, 0.2, 0.3, 0.4])
POINTS = BAR.grid(5, 3)
DATA = [
    replace(one, push_id=number // 20)
    for number, one in enumerate(observations_of(BAR, TRUTH, 0.3, 40, np.random.default_rng(0)))
]
HERE, THERE = [Hypothesis(name, POINTS, TRUTH.center_of_friction + offset) for name, offset in (("here", 0.0), ("there", 0.01))]


def started(refuse=pytest.fail, **config):
    estimator = Estimator(POINTS, EstimatorConfig(**config))
    return OnlineEstimation(BAR, estimator, 0.001, Recognizer([THERE, HERE]), refuse)


def corners(data):
    return narrowed(BAR, 0.001, data).region().corners


def test_each_step_gives_what_its_part_gives_alone():
    online, estimator, recognizer = started(), Estimator(POINTS), Recognizer([THERE, HERE])
    for observation in DATA:
        assert online.take(observation)
        online.narrow(observation)
        assert online.recognize(observation)
        assert online.estimate == estimator.add(observation)
        assert online.ranking == recognizer.add(observation)
    assert online.usable
    assert online.observations == tuple(DATA)
    assert online.newest == DATA[-1]
    assert online.ranking.best == "here"
    np.testing.assert_array_equal(online.region().corners, corners(DATA))
    assert online.next_pushes()


def test_a_push_that_is_taken_out_leaves_everything():
    online = started()
    for observation in DATA:
        online.learn(observation)
    left = online.exclude(1)
    rest = DATA[:20]
    assert left is online.estimate
    assert online.observations == tuple(rest)
    assert online.ranking.data_points == 20
    np.testing.assert_array_equal(online.region().corners, corners(rest))
    assert online.exclude(0).data_points == 0
    assert online.estimate is None
    assert not online.usable
    with pytest.raises(ValueError, match="push_id"):
        online.exclude(0)


def test_what_cannot_be_used_is_told_and_changes_nothing():
    refused = []
    online = started(lambda what, error: refused.append((what, type(error))), cor_radius=0.0)
    online.learn(DATA[0])
    before = online.estimate
    about_a_support = Twist(*(0.1 * np.array((POINTS[0][1], -POINTS[0][0]))), 0.1)
    online.learn(Observation(DATA[0].contact_point, DATA[0].contact_normal, about_a_support, 0))
    assert refused == [("observation", UninformativePush)]
    assert online.estimate is before
    assert online.observations == (DATA[0],)


def test_a_push_that_is_left_out_by_itself_is_left_out_of_everything_until_it_is_kept():
    pushes = observations_of(BAR, TRUTH, 0.3, 9, np.random.default_rng(6))
    tips = [velocity_at(one.twist, np.asarray(one.contact_point)) for one in pushes]
    data = [
        replace(one, push_id=number, tip_velocity=tuple((tip * (3 if number == 2 else 1)).tolist()))
        for number, (one, tip) in enumerate(zip(pushes, tips, strict=True))
    ]
    online, rest = started(), [one for one in data if one.push_id != 2]
    for observation in data:
        online.learn(observation)
    assert online.ranking.data_points == len(data)
    finished(online.settling())
    assert sorted(one.push_id for one in online.observations) == [one.push_id for one in rest]
    assert [one.push_id for one in online.verdict().rejected] == [2]
    alone = Recognizer([THERE, HERE])
    for observation in rest:
        ranking = alone.add(observation)
    assert fits(online.ranking) == fits(ranking)
    np.testing.assert_allclose(online.region().corners, corners(rest))
    online.keep(2)
    assert fits(online.ranking) == fits(alone.add(data[2]))
    online.exclude(2)
    assert fits(online.ranking) == fits(ranking)


def fits(ranking):
    return [(one.name, pytest.approx(one.fit_error, abs=1e-9)) for one in ranking.hypotheses]
