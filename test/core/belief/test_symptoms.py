"""Whether tips off the outline are told: pushes of the object on four feet, four observations each, with a camera's noise."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from problems import four_feet, observations_of, seen_often, square

from pushfric_core.belief.symptoms import normals_inward, tip_off
from pushfric_core.estimation.estimator import Estimator, EstimatorConfig
from pushfric_core.geometry.planar import Twist

FEET = four_feet()
POINTS = square().grid(4, 4, 0.01)


def pushes(seed, noise=0.005, count=16):
    """The tip sticks and touches; each motion is seen four times, with errors of this share of the speed."""
    rng = np.random.default_rng(seed)
    seen = seen_often(observations_of(square(), FEET.truth, 0.5, count, rng), rng, noise)
    return [replace(one, depth=0.02 * noise * float(rng.normal())) for one in seen]


def deeper(depth, x=0.0, y=0.0):
    return lambda one: replace(one, depth=one.depth + depth + float(np.dot(one.contact_normal, (x, y))))


def found(data):
    off = tip_off(data)
    return [] if off is None else [off.reason]


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("noise", [0.0, 0.005, 0.03])
def test_nothing_is_said_of_good_pushes(seed, noise):
    assert found(pushes(seed, noise)) == []


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("change", "code", "text"),
    [
        (deeper(0.002), "tip_off_across", r"the tip seems to be (1\.9|2\.0) mm inside the outline"),
        (deeper(-0.002), "tip_off_across", r"the tip seems to be (1\.9|2\.0) mm away from the outline"),
        (deeper(0.0, 0.0, 0.002), "outline_shifted", r"outline seems to be shifted by \(-?0\.0, (1\.8|1\.9|2\.0)\) mm"),
    ],
)
def test_each_misplacement_is_told_with_its_size(seed, change, code, text):
    (told,) = found([change(one) for one in pushes(seed, count=60)])
    assert told.code == code
    assert re.search(text, told.text), told


def test_three_pushes_tell_nothing():
    assert found([deeper(0.005)(one) for one in pushes(0, count=2)]) == []


def test_a_single_bad_push_is_no_misplacement():
    data = pushes(1)
    bad = [deeper(0.02)(one) if one.push_id == 5 else one for one in data]
    assert found(bad) == []


def test_late_stamps_that_make_single_data_points_deep_are_no_misplacement():
    rng = np.random.default_rng(0)
    assert found([deeper(float(rng.exponential(0.002)))(one) for one in pushes(0)]) == []


def judged(data):
    estimator = Estimator(POINTS, EstimatorConfig(screening=False))  # a push that contradicts the others stays
    estimate = estimator.add(data)
    return estimate, estimate.verdict


def test_an_estimate_may_be_used_where_it_knows_less_than_what_is_off():
    _, good = judged(pushes(2))
    assert (good.use, good.notes) == (True, ())
    estimate, verdict = judged([deeper(0.003)(one) for one in pushes(2)])
    assert verdict.use
    assert "inside the outline" in verdict.notes[0].text
    assert math.dist(estimate.center_of_friction, FEET.truth.center_of_friction) < estimate.confidence


def test_where_pushes_contradict_each_other_a_misplacement_is_told_as_the_cause():
    turned = [replace(one, twist=Twist(*(-np.array(one.twist)).tolist())) for one in pushes(2)[:4]]
    _, verdict = judged(turned + pushes(2)[4:])
    assert verdict.reasons[0].code == "contradiction"
    _, verdict = judged([deeper(0.003)(one) for one in turned + pushes(2)[4:]])
    assert not verdict.use
    assert [one.code for one in verdict.reasons] == ["tip_off_across"]


@pytest.mark.parametrize("every", [1, 3])
def test_normals_that_point_inward_are_named_if_all_do_or_some(every):
    wrong = [
        replace(one, contact_normal=tuple((-np.array(one.contact_normal)).tolist())) if one.push_id % every == 0 else one
        for one in pushes(2)
    ]
    (reason,) = Estimator(POINTS).add(wrong).verdict.reasons
    assert reason.code == "normals_inward"
    assert normals_inward(POINTS, pushes(2)) is None
