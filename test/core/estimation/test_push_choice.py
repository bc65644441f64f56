import numpy as np
import pytest
import shapely

from pushfric_core import FrictionModel, HalfPlanes, Outline, PushingLine, Support, next_pushes, predict, slip_pushes
from pushfric_core.estimation.push_choice import LIKELY_MU, planned_pushes
from pushfric_core.estimation.push_plan import PlannedPush, even_pushes, placement, planned_contact
from pushfric_core.estimation.region import HalfPlane
from pushfric_core.geometry.planar import rotation
from pushfric_core.mechanics.quasi_static import ContactMode

PLATE = Outline.rectangle(0.12, 0.06)
ELL = Outline(np.array(((0, 0), (0.1, 0), (0.1, 0.04), (0.04, 0.04), (0.04, 0.1), (0, 0.1))))


def test_a_plan_predicts_the_mean_area_it_leaves(rng):
    """The prediction is compared with the regions that noiseless outcomes leave for p_CF at many places."""
    plan = planned_pushes(HalfPlanes(ELL, margin=0.003), 5)
    hull = HalfPlanes(ELL).region().polygon
    places = [place for place in rng.uniform(0, 0.1, (3000, 2)) if shapely.contains_xy(hull, *place)]
    areas = []
    for place in places:
        left = hull
        for push, _ in plan:
            normal, along = ELL.normals[push.edge], ELL.edges[push.edge] / ELL.lengths[push.edge]
            contact = ELL.vertices[push.edge] + ELL.edges[push.edge] / 2 + push.offset * along
            side = np.sign((place - contact) @ along) * along
            x, y = contact - 0.003 * side - 0.5 * normal
            far = 1.0 * side
            strip = [
                (x, y),
                (x + normal[0], y + normal[1]),
                (x + normal[0] + far[0], y + normal[1] + far[1]),
                (x + far[0], y + far[1]),
            ]
            left = left.intersection(shapely.Polygon(strip))
        areas.append(left.area)
    assert np.mean(areas) == pytest.approx(plan[-1].expected_area, rel=0.05)


def test_a_collapsed_region_has_no_next_push():
    half_planes = HalfPlanes(PLATE)
    half_planes.add([HalfPlane((0.0, 1.0), 0.1)])
    assert next_pushes(half_planes) == []
    assert planned_pushes(half_planes, 3) == []


@pytest.mark.parametrize(("outline", "center"), [(PLATE, (0.0, 0.0)), (PLATE, (0.02, -0.01)), (ELL, (0.035, 0.035))])
def test_a_slip_push_slips_and_hardly_turns_the_object(outline, center):
    pushes = slip_pushes(outline, center)
    assert {(push.edge, np.sign(push.angle)) for push in pushes[:4]} >= {(pushes[0].edge, np.sign(pushes[0].angle))}
    points = np.asarray(center) + np.array(((-0.03, -0.02), (0.03, -0.02), (0.0, 0.04)))
    model = FrictionModel.of(Support(points, np.full(3, 1 / 3)), LIKELY_MU)
    contacts, directions = map(np.array, zip(*(planned_contact(outline, push) for push in pushes[:3]), strict=True))
    normals = np.array([outline.normals[push.edge] for push in pushes[:3]])
    found = predict(model, contacts, normals, directions)
    assert set(found.modes) == {ContactMode.SLIDING}
    for vx, vy, omega in found.twists:
        velocity = np.array((vx, vy)) + omega * np.array((-center[1], center[0]))
        assert np.linalg.norm(velocity) > 0.1 * abs(omega)  # the centre of rotation is 100 mm away at least


OUTLINE = Outline(np.array(((0, 0), (0.15, 0), (0, 0.15))))
LINE = PushingLine((0.02, -0.05), (0.0, 1.0), 0.003)


def test_even_pushes_split_each_edge_equally():
    pushes = even_pushes(Outline.rectangle(0.08, 0.04), (3, 0, 1, 0))
    assert [push.edge for push in pushes] == [0, 0, 0, 2]
    assert [push.offset for push in pushes] == pytest.approx([-0.02, 0.0, 0.02, 0.0])


def test_the_middle_of_an_edge_has_no_sign():
    assert [str(push.offset) for push, _ in next_pushes(HalfPlanes(Outline.rectangle(0.1, 0.1)))] == ["0.0"] * 4


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
