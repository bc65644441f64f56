import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import pushed_as_planned

from pushfric_core import HalfPlanes, Observation, Outline, Status, Support, Twist, UninformativePush
from pushfric_core.estimation.push_plan import PlannedPush
from pushfric_core.estimation.region import HalfPlane, line_of_force, line_of_motion, line_of_pushing
from pushfric_core.geometry.planar import velocity_at

PLATE = Outline.rectangle(0.12, 0.06)
ELL = Outline(np.array(((0, 0), (0.1, 0), (0.1, 0.04), (0.04, 0.04), (0.04, 0.1), (0, 0.1))))


def depth(half_plane, point):
    return float(np.dot(half_plane.normal, point)) - half_plane.offset


def is_half_plane(half_plane, normal, offset):
    return half_plane.normal == pytest.approx(normal) and half_plane.offset == pytest.approx(offset)


def seen_from_below(twist):
    """A push at (0.02, -0.03) on the lower edge of the plate."""
    return Observation((0.02, -0.03), (0.0, -1.0), twist)


def test_a_turn_to_the_left_has_p_cf_left_of_the_line_of_motion():
    (half_plane,) = line_of_motion(seen_from_below(Twist(0.0, 0.02, 1.0)))  # the contact moves by (0.03, 0.04)
    assert is_half_plane(half_plane, (-0.8, 0.6), -0.034)
    assert depth(half_plane, (0.0, 0.0)) == pytest.approx(0.034)


def test_a_translation_has_p_cf_on_the_line():
    one, other = line_of_motion(seen_from_below(Twist(0.0, 0.02, 0.0)))
    assert is_half_plane(one, (-1.0, 0.0), -0.02)
    assert is_half_plane(other, (1.0, 0.0), 0.02)


def test_the_line_of_a_normal_push_is_the_normal():
    twist = Twist(0.01, 0.02, 0.5)  # sliding along the tip
    (half_plane,) = line_of_pushing(seen_from_below(twist), (0.0, 3.0))
    assert is_half_plane(half_plane, (-1.0, 0.0), -0.02)
    assert line_of_force(seen_from_below(twist), 0.0) == (half_plane,)


@pytest.mark.parametrize("omega", [1.0, -1.0])
def test_the_line_of_force_is_the_edge_of_the_cone_that_bounds_least(omega):
    """For a turn to the left, p_CF lies left of the right edge of the cone, (4, 3) / 5, tilted from (0, 1) by mu_c = 4 / 3."""
    (half_plane,) = line_of_force(seen_from_below(Twist(0.0, 0.02, omega)), 4 / 3)
    assert half_plane.normal == pytest.approx((np.sign(omega) * -0.6, 0.8))
    assert depth(half_plane, (0.02, -0.03)) == pytest.approx(0.0, abs=1e-12)


def test_a_translation_leaves_the_cone():
    half_planes = line_of_force(seen_from_below(Twist(0.0, 0.02, 0.0)), 0.5)
    inside, outside = (0.02 + 0.01, -0.03 + 0.021), (0.02 + 0.01, -0.03 + 0.019)
    assert min(depth(one, inside) for one in half_planes) > 0
    assert min(depth(one, outside) for one in half_planes) < 0


@settings(derandomize=True, max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), mu_c=st.floats(0, 1.5), share=st.floats(-0.95, 0.95))
def test_every_half_plane_contains_the_true_center(seed, mu_c, share):
    """All three rules, for random supports, sticking or sliding: the forward model against Mason's theorems."""
    rng = np.random.default_rng(seed)
    points = PLATE.grid(4, 3)
    support = Support(points, rng.dirichlet(np.full(len(points), 0.3)))
    angle = float(rng.uniform(-1.4, 1.4))
    within = share * float(np.arctan(mu_c))
    for turn in (angle, within, 0.0):
        edge = int(rng.integers(4))
        push = PlannedPush(edge, float(rng.uniform(-0.49, 0.49) * PLATE.lengths[edge]), turn)
        observation, direction = pushed_as_planned(support, PLATE, push, mu_c)
        half_planes = line_of_motion(observation) + line_of_force(observation, mu_c)
        if turn in (within, 0.0):
            half_planes += line_of_pushing(observation, direction)
        for half_plane in half_planes:
            assert depth(half_plane, support.center_of_friction) > -1e-5  # the model rounds the corner of Coulomb's law


def test_the_region_starts_as_the_hull_and_shrinks():
    half_planes = HalfPlanes(ELL)
    assert half_planes.region().area == pytest.approx(0.01 - 0.06**2 / 2)
    region = half_planes.add([HalfPlane((-1.0, 0.0), -0.04)])
    assert region.area == pytest.approx(0.04 * 0.1)
    assert region.center == pytest.approx((0.02, 0.05))
    region = half_planes.add([HalfPlane((0.0, 1.0), 0.05), HalfPlane((0.0, 1.0), 0.03)])
    assert region.area == pytest.approx(0.04 * 0.05)
    assert region.center == pytest.approx((0.02, 0.075))
    assert (region.violation, region.status) == (0.0, Status.OPTIMAL)


def test_contradictions_are_settled_by_the_least_sum_of_violations():
    """x >= 10 mm, x >= 11 mm and x <= 4 mm: two against one."""
    half_planes = HalfPlanes(PLATE)
    half_planes.add([HalfPlane((1.0, 0.0), 0.010)])
    half_planes.add([HalfPlane((-1.0, 0.0), -0.004)])
    region = half_planes.add([HalfPlane((1.0, 0.0), 0.011)])
    assert region.polygon.is_empty
    assert region.area == 0.0
    assert region.status is Status.OPTIMAL
    # at x = 10: 6 mm + 1 mm; further right the first two cost as much as they save
    assert region.violation == pytest.approx(0.007)
    assert 0.010 - 1e-9 <= region.center[0] <= 0.011 + 1e-9
    assert PLATE.contains(region.center[None]).all()
    assert half_planes.add([HalfPlane((0.0, 1.0), 0.0)]).area == 0.0


@settings(derandomize=True, max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_point_of_a_fine_grid_violates_less(seed):
    rng = np.random.default_rng(seed)
    angles, offsets = rng.uniform(-np.pi, np.pi, 12), rng.uniform(-0.01, 0.03, 12)
    sides = [HalfPlane((np.cos(a), np.sin(a)), o) for a, o in zip(angles, offsets, strict=True)]
    half_planes = HalfPlanes(PLATE)
    for side in sides:
        region = half_planes.add([side])
    grid = PLATE.grid(61, 31, inset=0.0)
    tried = sum(np.maximum(side.offset - grid @ side.normal, 0.0) for side in sides)
    own = sum(max(-depth(side, region.center), 0.0) for side in sides)
    assert own == pytest.approx(region.violation, abs=1e-8)
    assert own <= tried.min() + 1e-8
    inside = grid[tried == 0]
    assert shapely.dwithin(region.polygon, shapely.points(inside), 1e-9).all()
    assert len(inside) == 0 or region.area > 0


def test_a_turn_about_the_contact_has_no_line_of_motion():
    twist = Twist(-0.03, -0.02, 1.0)
    assert not velocity_at(twist, (0.02, -0.03)).any()
    with pytest.raises(UninformativePush, match="turned about its contact"):
        line_of_motion(seen_from_below(twist))


@pytest.mark.parametrize("direction", [(0.0, -1.0), (1.0, 0.0), (0.0, 1.0, 0.0), (np.nan, 1.0)])
def test_a_pusher_that_moves_away_is_refused(direction):
    with pytest.raises(ValueError, match=r"direction must be \(2,\) and point into the object"):
        line_of_pushing(seen_from_below(Twist(0.0, 0.02, 1.0)), direction)
