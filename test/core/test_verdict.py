"""What the verdict says about unusable input, with pushes of the object on four feet; good input is used."""

import math
from dataclasses import replace

import numpy as np
import pytest
from problems import four_feet

from pushfric_core.estimator import Estimator
from pushfric_core.planar import Twist, rotation, velocity_at

FEET = four_feet()


def judged(change, points=FEET.truth.points):
    estimator = Estimator(points)
    for number, observation in enumerate(FEET.observations):
        motion = velocity_at(observation.twist, FEET.truth.center_of_friction)
        force = tuple((5 * motion / np.hypot(*motion)).tolist())
        estimate = estimator.add(change(number, replace(observation, push_id=number, force=force)))
    return estimator.verdict(estimate)


def turned(angle):
    return lambda _, o: replace(o, force=tuple((rotation(angle) @ o.force).tolist()))


def test_good_input_may_be_used():
    verdict = judged(lambda _, o: o)
    assert verdict.use
    assert verdict.reasons == ()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda _, o: replace(o, contact_normal=(-o.contact_normal[0], -o.contact_normal[1])), "the normals point inward in"),
        (turned(math.pi), "the measured forces oppose the motion"),
        (turned(math.pi / 2), "the measured forces are turned by"),
        (turned(-math.pi / 2), "the measured forces are turned by -"),
        (lambda number, o: turned(1.1 * number)(number, o), "the measured forces do not turn with the object"),
        (lambda _, o: replace(o, twist=Twist(o.twist.vx, o.twist.vy, math.degrees(o.twist.omega)), force=None), "radians"),
    ],
)
def test_each_mistake_has_a_sentence(change, reason):
    verdict = judged(change)
    assert not verdict.use
    assert any(reason in sentence for sentence in verdict.reasons), verdict.reasons


def test_supports_whose_hull_misses_the_center_of_friction_are_told():
    x, y = FEET.truth.center_of_friction
    width = np.ptp(FEET.truth.points, axis=0).max()
    aside = np.array(((x + 0.2 * width, y - width), (x + 0.2 * width, y + width), (x + width, y), (x + 0.6 * width, y)))
    verdict = judged(lambda _, o: replace(o, force=None), aside)
    assert any("hull" in sentence or "err by" in sentence for sentence in verdict.reasons), verdict.reasons
