import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from pushfric_core import TABLE_1, SolverFailed, Support, Touch, UninformativePush, named_ellipsoid
from pushfric_core.geometry.contact import friction_cone
from pushfric_core.geometry.planar import Twist, Wrench, cross, rotation, velocity_at
from pushfric_core.mechanics import limit_surface
from pushfric_core.mechanics.limit_surface import LimitSurface
from pushfric_core.mechanics.quasi_static import ContactMode
from pushfric_core.mechanics.simulation import pushed_motion

HALF = 0.05
"""Half the length of the rods of Figure 12 [m]."""

ROD_2 = Support(HALF * np.array(((-1, 0), (1, 0))), np.full(2, 1 / 2))
ROD_3 = Support(HALF * np.array(((-1, 0), (0, 0), (1, 0))), np.full(3, 1 / 3))


def random_support(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 9))
    return Support(rng.uniform(-0.05, 0.05, (n, 2)) + rng.uniform(-0.1, 0.1, 2), rng.dirichlet(np.ones(n)))


def dissipation(support, twist):
    return float(support.weights @ np.linalg.norm(velocity_at(twist, support.points), axis=1))


def along_rod(places):
    """Contacts on the lower side of a rod: points and normals."""
    return np.column_stack((places, np.zeros(len(places)))), np.tile((0.0, -1.0), (len(places), 1))


# the surface


def test_the_wrench_is_what_the_pusher_applies():
    surface = LimitSurface(ROD_2)
    assert surface.wrench(Twist(0.0, 3.0, 0.0)) == pytest.approx((0, 1, 0))
    assert surface.wrench(Twist(0.0, 0.0, 2.0)) == pytest.approx((0, 0, HALF))


@settings(derandomize=True, max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.tuples(st.floats(-1, 1), st.floats(-1, 1)), st.floats(-30, 30), st.floats(0.1, 5))
def test_the_motion_under_the_wrench_of_a_motion_is_that_motion(seed, velocity, omega, load):
    support, twist = random_support(seed), Twist(*velocity, omega)
    assume(dissipation(support, twist) > 1e-3)
    assume(np.linalg.norm(velocity_at(twist, support.points), axis=1).min() > 1e-3 * dissipation(support, twist))
    surface = LimitSurface(support)
    wrench = surface.wrench(twist)
    unit = np.array(twist) / dissipation(support, twist)
    assert surface.twist(Wrench(*(load * np.array(wrench)))) == pytest.approx(unit, abs=1e-4)
    assert surface.load(Wrench(*(load * np.array(wrench)))) == pytest.approx(load)


@settings(derandomize=True, max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_motions_obey_the_principle_of_maximal_dissipation(seed):
    """No wrench that the support can resist does more work on the motion. A wrench between two others is on or inside the
    surface, because the surface is convex."""
    support, rng = random_support(seed), np.random.default_rng(seed)
    surface = LimitSurface(support)
    scale = np.array((1.0, 1.0, 0.05))
    for direction in rng.normal(size=(3, 3)) * scale:
        twist = surface.twist(Wrench(*direction))
        wrench = direction / surface.load(Wrench(*direction))
        assert dissipation(support, twist) == pytest.approx(1)
        assert wrench @ twist == pytest.approx(1)
        others = [np.array(surface.wrench(Twist(*v))) for v in rng.normal(size=(20, 3)) / scale]
        assert max(np.array(others) @ twist) <= 1 + 1e-9
        assert max(surface.load(Wrench(*((wrench + other) / 2))) for other in others[:5]) <= 1 + 1e-9


@pytest.mark.parametrize("name", ["delrin_square3", "delrin_rect_right"])
def test_sliding_pushes_follow_the_edge_of_the_friction_cone(name, rng):
    """The forward model finds the same motions with another algorithm."""
    known = TABLE_1[name]
    surface = LimitSurface(known.support)
    compared = 0
    while compared < 20:
        edge = int(rng.integers(4))
        point = known.outline.vertices[edge] + rng.uniform(0.1, 0.9) * known.outline.edges[edge]
        normal = known.outline.normals[edge]
        velocity = rotation(rng.choice((-1.2, 1.2))) @ -normal
        motion = pushed_motion(known.support, Touch(0.0, point, normal, edge), velocity, known.mu_c)
        if motion.mode is not ContactMode.SLIDING:
            continue
        force = max(friction_cone(normal, known.mu_c), key=lambda one: one @ motion.force)
        twist = np.array(surface.twist(Wrench(*force, float(cross(point, force)))))
        unit = np.array(motion.twist) / dissipation(known.support, motion.twist)
        assert twist == pytest.approx(unit, rel=1e-3, abs=2e-3)  # the model rounds the corner of Coulomb's law
        compared += 1


def test_supports_at_one_place_count_as_one():
    double = Support(np.repeat(ROD_2.points, 2, axis=0), np.array((0.2, 0.3, 0.1, 0.4)))
    with_idle = Support(np.vstack((ROD_2.points, (0.3, 0.3))), np.array((0.5, 0.5, 0.0)))
    for same in (double, with_idle):
        assert [facet.radius for facet in LimitSurface(same).facets] == pytest.approx([0.5, 0.5])


# facets


def test_a_turn_about_a_support_has_a_facet():
    """Three equal feet, one at the origin: in a turn about it, the other two resist with 1/3 each."""
    surface = LimitSurface(Support(np.array(((0.0, 0.0), (0.03, 0.0), (0.0, 0.06))), np.full(3, 1 / 3)))
    facet = next(one for one in surface.facets if not one.point.any())
    assert facet.center == pytest.approx((-1 / 3, 1 / 3, 0.03))
    assert facet.radius == pytest.approx(1 / 3)
    assert facet.twist == pytest.approx((0, 0, 1 / 0.03))
    for u in ((0.0, 0.0), (0.3, 0.0), (-0.1, 0.2)):
        wrench = Wrench(-1 / 3 + u[0], 1 / 3 + u[1], 0.03)
        assert surface.twist(wrench) == pytest.approx(facet.twist)
        assert surface.load(wrench) == pytest.approx(1)
        assert surface.twist(Wrench(*(-np.array(wrench)))) == pytest.approx(tuple(-np.array(facet.twist)))
    assert np.abs(np.array(surface.twist(Wrench(-1 / 3 + 0.34, 1 / 3, 0.03))) - facet.twist).max() > 1e-3
    with pytest.raises(UninformativePush):
        surface.wrench(facet.twist)


@settings(derandomize=True, max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), angle=st.floats(0, 6.3), share=st.floats(0, 0.999))
def test_facets_are_limits_of_the_surface(seed, angle, share):
    """The wrenches of motions about points near a support approach the rim of its facet; all of its inside has one motion."""
    surface = LimitSurface(random_support(seed))
    facet = surface.facets[0]
    u = facet.radius * np.array((np.cos(angle), np.sin(angle)))
    inside = np.array(facet.center) + share * np.append(u, cross(facet.point, u))
    assert surface.twist(Wrench(*inside)) == pytest.approx(facet.twist)
    assert surface.load(Wrench(*inside)) == pytest.approx(1)
    # moving the centre of rotation by d turns the support's own force against d
    vx, vy = velocity_at(facet.twist, (0.0, 0.0)) + 1e-6 * u / facet.radius
    rim = np.array(facet.center) + np.append(u, cross(facet.point, u))
    assert surface.wrench(Twist(float(vx), float(vy), facet.twist.omega)) == pytest.approx(rim, abs=1e-3)


def test_the_rods_have_the_same_reachable_parts():
    """Figure 12: forces across a rod, at points along its length, meet both surfaces at the same wrenches and motions."""
    places = np.linspace(-HALF, HALF, 41)
    one, other = (LimitSurface(rod).reachable(*along_rod(places), mu_c=0.0) for rod in (ROD_2, ROD_3))
    assert one.wrenches == pytest.approx(other.wrenches, abs=1e-9)
    assert one.twists == pytest.approx(other.twists, abs=1e-9)
    fx, fy, m = one.wrenches[:, 0].T
    assert fx == pytest.approx(np.zeros(41))
    # the bold edges: down to m = fy / 2 in units of half the length
    assert fy == pytest.approx(1 / (1 + np.abs(places) / HALF))
    assert m == pytest.approx(places * fy)


# ellipsoids


def test_the_ellipsoid_has_the_largest_force_and_the_moment_of_a_turn_about_p_cf():
    support = TABLE_1["delrin_rect_right"].support
    center = support.center_of_friction
    form, surface = named_ellipsoid(support).form, LimitSurface(support)

    def wrench(twist):
        along = np.linalg.solve(form, twist)
        return Wrench(*(along / np.sqrt(along @ twist)))

    assert wrench(Twist(0.0, 2.0, 0.0)) == pytest.approx((0, 1, center[0]))
    assert surface.wrench(Twist(0.0, 2.0, 0.0)) == pytest.approx((0, 1, center[0]))
    turn = wrench(Twist(center[1], -center[0], 1.0))
    assert turn[:2] == pytest.approx((0, 0), abs=1e-12)
    # at p_CF the support itself leaves a small force
    fx, fy, m = surface.wrench(Twist(center[1] + 1e-9, -center[0], 1.0))
    assert turn.m == pytest.approx(m - cross(center, (fx, fy)), rel=1e-6)


# what pushes reach, and which objects they tell apart


def test_reachable_wrenches_lie_in_the_friction_cone_of_their_contact():
    known = TABLE_1["delrin_square3"]
    middles = known.outline.vertices + known.outline.edges / 3
    reachable = LimitSurface(known.support).reachable(middles, known.outline.normals, 0.4)
    for point, normal, wrenches in zip(middles, known.outline.normals, reachable.wrenches, strict=True):
        assert np.allclose(wrenches[:, 2] - cross(point, wrenches[:, :2]), 0, rtol=0, atol=1e-12)
        forces = wrenches[:, :2] / np.linalg.norm(wrenches[:, :2], axis=1)[:, None]
        assert forces[[0, -1]] == pytest.approx(np.array(friction_cone(normal, 0.4)))
        assert (forces @ -normal).min() == pytest.approx(1 / np.hypot(1, 0.4))
    assert np.sum(reachable.wrenches * reachable.twists, axis=2) == pytest.approx(np.ones(reachable.twists.shape[:2]))


# what is refused


def test_a_motion_that_is_not_found_is_an_error(monkeypatch):
    monkeypatch.setattr(limit_surface, "STEPS", 1)
    with pytest.raises(SolverFailed, match="the motion did not converge; most steps allowed: 1"):
        LimitSurface(TABLE_1["wood_rect4"].support).twist(Wrench(0.3, 0.9, 0.01))


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: LimitSurface(Support([(0, 0), (0, 0), (1, 1)], [0.5, 0.5, 0])), "weight at two places or more, got all of it"),
        (lambda: LimitSurface(ROD_2).twist(Wrench(0, 0, 0)), "wrench must be three finite numbers, not all zero"),
        (lambda: LimitSurface(ROD_2).load(Wrench(np.nan, 0, 0)), "wrench must be three finite numbers, not all zero"),
        (lambda: LimitSurface(ROD_2).reachable(np.zeros(2), np.zeros(2), 0.1), r"must both be \(k, 2\)"),
        (lambda: LimitSurface(ROD_2).reachable(*along_rod(np.zeros(1)), -0.1), "mu_c must be at least 0 and finite, got -0.1"),
    ],
)
def test_wrong_arguments_are_named(call, text):
    with pytest.raises(ValueError, match=text):
        call()
