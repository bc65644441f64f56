import numpy as np
import pytest

from pushfric_core import Outline, PushingLine
from pushfric_core.estimation.push_plan import (
    PlannedPush,
    even_pushes,
    placement,
    planned_contact,
)
from pushfric_core.geometry.planar import rotation

OUTLINE = Outline(np.array(((0, 0), (0.15, 0), (0, 0.15))))
LINE = PushingLine((0.02, -0.05), (0.0, 1.0), 0.003)


def test_even_pushes_split_each_edge_equally():
    pushes = even_pushes(Outline.rectangle(0.08, 0.04), (3, 0, 1, 0))
    assert [push.edge for push in pushes] == [0, 0, 0, 2]
    assert [push.offset for push in pushes] == pytest.approx([-0.02, 0.0, 0.02, 0.0])


def test_a_planned_contact_lies_on_its_edge_and_the_push_goes_inward():
    """A slanting edge from (150, 0) to (0, 150) mm, pushed a quarter of its length beyond its middle, 45 degrees left."""
    point, direction = planned_contact(OUTLINE, PlannedPush(1, 0.15 * np.sqrt(2) / 4, np.pi / 4))
    assert point == pytest.approx((0.0375, 0.1125))
    assert direction == pytest.approx((0.0, -1.0))


@pytest.mark.parametrize("push", [PlannedPush(0, 0.03), PlannedPush(1, -0.05, 0.4), PlannedPush(2, 0.06, -0.7)])
def test_the_tip_touches_the_placed_object_as_planned(push):
    pose = placement(OUTLINE, push, LINE, position=0.01)
    touch = LINE.touch(OUTLINE, pose)
    assert touch.edge == push.edge
    assert touch.distance == pytest.approx(0.01)
    middle = OUTLINE.vertices[push.edge] + OUTLINE.edges[push.edge] / 2
    assert (touch.point - middle) @ OUTLINE.edges[push.edge] == pytest.approx(push.offset * OUTLINE.lengths[push.edge])
    direction = rotation(-pose.theta) @ LINE.direction
    assert np.allclose(direction, rotation(push.angle) @ -OUTLINE.normals[push.edge])
