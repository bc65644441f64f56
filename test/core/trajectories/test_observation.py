import dataclasses
import math

import numpy as np
import pytest

from pushfric_core import Observation, Twist, UninformativePush

GOOD = Observation((0.05, 0.0), (1.0, 0.0), Twist(-0.02, 0.0, 0.1))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"contact_point": (math.nan, 0.0)}, "contact_point must be finite"),
        ({"contact_point": (0.0, 0.0, 0.0)}, r"contact_point must be two numbers, got \(0.0, 0.0, 0.0\)"),
        ({"contact_point": "12"}, "contact_point must be two numbers, got '12'"),
        ({"depth": "1"}, "depth must be a finite number, got '1'"),
        ({"twist": (0.0, 0.02, 0.1)}, r"twist must be a Twist\(vx, vy, omega\), got \(0.0, 0.02, 0.1\)"),
        ({"pose": (0.0, 0.0, 0.0)}, r"pose must be a Pose\(x, y, theta\) or None, got \(0.0, 0.0, 0.0\)"),
        ({"push_id": 1.5}, "push_id must be an integer, got 1.5"),
        ({"contact_normal": (0.9, 0.0)}, r"contact_normal must have length 1, got \(0.9, 0.0\) of length 0.9"),
        ({"twist": Twist(0.0, math.inf, 0.0)}, "twist must be finite"),
        ({"half_width": -0.001}, "half_width must be at least 0"),
        ({"duration": -1.0}, "duration must be at least 0"),
    ],
)
def test_bad_data_points_are_refused(change, text):
    with pytest.raises(ValueError, match=text):
        dataclasses.replace(GOOD, **change)


def test_a_data_point_needs_a_motion():
    with pytest.raises(UninformativePush, match="must not be zero"):
        dataclasses.replace(GOOD, twist=Twist(0.0, 0.0, 0.0))


def test_data_points_compare_by_value():
    assert dataclasses.replace(GOOD) == GOOD
    assert dataclasses.replace(GOOD, push_id=1) != GOOD
    assert dataclasses.replace(GOOD, contact_point=np.array(GOOD.contact_point)) == GOOD


def test_a_depth_of_exactly_zero_is_known():
    assert GOOD.depth is None
    assert dataclasses.replace(GOOD, depth=0.0).depth == 0.0
