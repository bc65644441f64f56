import numpy as np
import pytest

from pushfric_core.geometry.table_1 import FEET, FLAT, TABLE_1


@pytest.mark.parametrize("name", TABLE_1)
def test_the_objects_of_table_1_have_their_centers_of_friction(name):
    known = TABLE_1[name]
    assert known.support.center_of_friction == pytest.approx((0.007 if name == "delrin_rect_right" else 0.0, 0.0), abs=1e-9)
    assert known.outline.contains(known.support.points).all()
    assert len(known.support_points) == known.grid[0] * known.grid[1]


@pytest.mark.parametrize("name", ["wood_rect4", "rubber_rect4"])
def test_the_feet_are_the_corners_of_the_grid(name):
    known = TABLE_1[name]
    corners = known.support_points[[0, 4, 10, 14]]
    assert np.allclose(np.sort(corners, axis=0), np.sort(known.support.points, axis=0))


@pytest.mark.parametrize("name", ["delrin_rect_center", "delrin_rect_right"])
def test_a_flat_bottom_presses_parabolically_on_an_ellipse(name):
    known = TABLE_1[name]
    shape = np.sum((known.support.points / (0.0415, 0.0255)) ** 2, axis=1)
    assert shape.max() < 1
    # the weight on top adds only a tilt along x
    tilt = known.support.weights / (1 - shape)
    slope, level = np.polyfit(known.support.points[:, 0], tilt, 1)
    assert np.allclose(tilt, level + slope * known.support.points[:, 0])
    assert (slope > 1e-6) == (name == "delrin_rect_right")


def test_the_smallest_objects_have_the_largest_errors():
    assert {name for name, known in TABLE_1.items() if known.noise is FLAT} == {"delrin_rect_center", "delrin_rect_right"}
    assert pytest.approx((1e-4, np.deg2rad(0.12))) == FEET
    assert pytest.approx((3.5e-4, np.deg2rad(0.45))) == FLAT
