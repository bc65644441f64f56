import numpy as np
import pytest

from pushfric_core import Support, Twist, UninformativePush
from pushfric_core.geometry.support import check_points, friction_directions

BAR = Support(np.array(((-1.0, 0.0), (1.0, 0.0))), np.array((0.5, 0.5)))


def test_friction_of_a_translation_acts_through_the_center_of_friction():
    support = Support(np.array(((0, 0), (2, 0), (0, 1))), np.array((0.5, 0.25, 0.25)))
    wrench = support.friction_wrench(Twist(0, -3, 0))
    assert wrench.fx == pytest.approx(0)
    assert wrench.fy == pytest.approx(1)
    assert wrench.m == pytest.approx(support.center_of_friction[0])


def test_friction_of_a_bar_spinning_about_its_middle_is_a_pure_moment():
    assert BAR.friction_wrench(Twist(0, 0, 5)) == pytest.approx((0, 0, -1))


def test_friction_opposes_each_support():
    assert np.allclose(friction_directions(BAR.points, Twist(0, 0, 1)), ((0, 1), (0, -1)))


def test_a_motion_about_a_support_point_has_no_friction_direction_there():
    with pytest.raises(UninformativePush, match=r"rotated exactly about its support point \(1, 0\)"):
        friction_directions(BAR.points, Twist(0, -1, 1))


@pytest.mark.parametrize(
    ("points", "text"),
    [
        (np.zeros((0, 2)), r"shape \(n, 2\) with n >= 1, got \(0, 2\)"),
        (np.zeros((3, 3)), r"got \(3, 3\)"),
        (np.array(((0, np.inf),)), "must be finite"),
    ],
)
def test_bad_support_points_are_refused(points, text):
    with pytest.raises(ValueError, match=text):
        check_points(points)


@pytest.mark.parametrize(
    ("weights", "text"),
    [
        ((0.5, 0.6), "sum of 1.1"),
        ((-0.5, 1.5), "nonnegative"),
        ((1.0,), r"shape \(2,\)"),
    ],
)
def test_bad_weights_are_refused(weights, text):
    with pytest.raises(ValueError, match=text):
        Support(BAR.points, np.array(weights))
