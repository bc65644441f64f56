"""The quasi-static model against statics."""

import numpy as np
import pytest

from pushfric_core import TABLE_1, Outline, PushfricError, Twist
from pushfric_core.geometry.planar import cross, left_of, rotation, velocity_at
from pushfric_core.mechanics import quasi_static
from pushfric_core.mechanics.quasi_static import MODES, ContactMode, Motions, holding_margins, motion_cones, motions

TRIANGLE = Outline(np.array(((0, 0), (0.15, 0), (0, 0.15))))
ROD = np.array(((-0.5, 0.0), (0.5, 0.0)))
HALVES = np.array(((0.5, 0.5),))


def random_pushes(outline, count, rng):
    edges = rng.integers(len(outline.vertices), size=count)
    points = outline.vertices[edges] + rng.uniform(0.02, 0.98, count)[:, None] * outline.edges[edges]
    normals = outline.normals[edges]
    velocities = np.array([0.02 * rotation(rng.uniform(-1.3, 1.3)) @ -normal for normal in normals])
    return points, normals, velocities


def cases(rng):
    grid = TRIANGLE.grid(10, 10, 0.0075)
    yield TRIANGLE, np.array(((0.03, 0.03), (0.09, 0.03), (0.03, 0.09))), np.full((1, 3), 1 / 3)
    yield TRIANGLE, grid, rng.dirichlet(np.ones(len(grid)), 3)
    yield TRIANGLE, grid, rng.dirichlet(np.full(len(grid), 0.05), 3)  # a few supports bear nearly all
    for known in TABLE_1.values():
        yield known.outline, known.support.points, known.support.weights[None]


def test_the_support_balances_the_pusher_in_each_motion(rng):
    checked = 0
    for outline, support_points, weights in cases(rng):
        points, normals, velocities = random_pushes(outline, 40, rng)
        mu_c = rng.uniform(0, 1, len(weights))
        found = motions(support_points, weights, mu_c, points, normals, velocities)
        for k, s in np.ndindex(found.modes.shape):
            bearing = weights[s] > 0
            moved = velocity_at(Twist(*found.twists[k, s]), support_points[bearing])
            speeds = np.linalg.norm(moved, axis=1)
            if speeds.min() > 0.005:  # away from the rounded corner of Coulomb's law
                forces = moved / speeds[:, None] * weights[s][bearing, None]
                assert forces.sum(axis=0) == pytest.approx(found.forces[k, s], abs=1e-4)
                assert cross(support_points[bearing] - points[k], forces).sum() == pytest.approx(0, abs=1e-5)
                checked += 1
    assert checked > 150


def test_what_is_computed_together_does_not_change_the_result(rng, monkeypatch):
    points, normals, velocities = random_pushes(TRIANGLE, 30, rng)
    weights = rng.dirichlet(np.ones(3), 4)
    support_points = TRIANGLE.vertices / 2 + 0.02
    mu_c = np.full(4, 0.4)
    whole = motions(support_points, weights, mu_c, points, normals, velocities)
    for k in range(30):
        for s in range(4):
            alone = motions(support_points, weights[[s]], mu_c[[s]], points[[k]], normals[[k]], velocities[[k]])
            assert alone == Motions(*(array[k, s][None, None] for array in whole))
    twists = np.column_stack((velocities, rng.normal(size=30)))
    margins = holding_margins(support_points, weights, mu_c, points, normals, np.full(30, 0.01), twists, 0.05)
    monkeypatch.setattr(quasi_static, "BLOCK", 7)
    assert (holding_margins(support_points, weights, mu_c, points, normals, np.full(30, 0.01), twists, 0.05) == margins).all()


def test_a_tip_that_leaves_the_object_or_stands_still_does_not_move_it():
    found = motions(ROD, HALVES, (0.3,), ((0.0, 0.0),) * 3, ((0.0, -1.0),) * 3, ((0.0, -0.02), (0.01, 0.0), (1e-170, 1e-170)))
    assert not found.twists.any()
    assert not found.forces.any()
    assert [MODES[mode] for mode in found.modes[:, 0]] == [ContactMode.FREE] * 3


def test_all_the_weight_at_the_contact_follows_the_tip_without_turning():
    found = motions(((0.0, 0.0),), ((1.0,),), (0.3,), ((0.0, 0.0),), ((0.0, -1.0),), ((0.001, 0.02),))
    assert found.twists[0, 0] == pytest.approx((0.001, 0.02, 0.0))


@pytest.mark.parametrize("mu_c", [0.05, 0.5])
@pytest.mark.parametrize("beside", [1e-17, 1e-16, 1e-13, 1e-11, 1e-9])
def test_a_contact_a_rounding_error_beside_a_support_is_at_it(mu_c, beside):
    at, velocity, normal = np.array((0.05, -0.03)), [(0.002, 0.02)], [(0.0, -1.0)]
    corners = at * [(1, 1), (1, -1), (-1, 1), (-1, -1)]
    expected, found = (
        motions(corners, np.full((1, 4), 0.25), [mu_c], [point], normal, velocity) for point in (at, at - (beside, 0.0))
    )
    assert found.modes == expected.modes
    np.testing.assert_allclose(found.twists, expected.twists, atol=1e-7)


def test_a_tip_sticks_between_the_edges_of_the_motion_cone(rng):
    for outline, support_points, weights in cases(rng):
        points, normals, _ = random_pushes(outline, 10, rng)
        mu_c = np.full(len(weights), 0.3)
        cones = motion_cones(support_points, weights, mu_c, points, normals)
        at_contact = cones[..., :2] + cones[..., 2:] * left_of(points)[:, None, None]
        assert np.allclose(np.linalg.norm(at_contact, axis=-1), 1)
        middle, beyond = at_contact.sum(axis=2), 1.2 * at_contact[:, :, 1] - 0.2 * at_contact[:, :, 0]
        wide = cross(at_contact[:, :, 1], at_contact[:, :, 0]) > 1e-3  # an edge may be met exactly where a support turns
        normals = np.repeat(normals[:, None], len(weights), axis=1)
        contacts = np.repeat(points[:, None], len(weights), axis=1)
        inside = motions(support_points, weights, mu_c, contacts, normals, middle).modes
        assert (inside[wide] == quasi_static.STICKING).all()
        pushing = wide & (np.sum(beyond * normals, axis=2) < 0)
        outside = motions(support_points, weights, mu_c, contacts, normals, beyond).modes
        assert pushing.any()
        assert (outside[pushing] == quasi_static.SLIDING).all()


def held(center, half_width=0.1, mu_c=0.5, turn=1.0):
    """The margin of pushing the rod with an edge below its middle."""
    x, y = center
    twist = ((turn * y, -turn * x, turn),)
    args = (ROD, HALVES, (mu_c,), ((0.0, 0.0),), ((0.0, -1.0),), (half_width,), twist, 0.5)
    return float(holding_margins(*args)[0, 0])


def test_a_push_straight_ahead_holds_as_far_as_friction_and_width_allow():
    # far to the left the turn is a translation along +y: force 1 along the inward normal, no moment
    assert held((-1e6, 0.0)) == pytest.approx(min(0.5 / np.hypot(1, 0.5), 0.1 / np.hypot(0.5, 0.1)), abs=1e-4)
    assert held((-1e6, 0.0), mu_c=0.0) == pytest.approx(0.0, abs=1e-4)
    assert held((1e6, 0.0)) < 0  # away from the edge
    assert held((1e6, 0.0), turn=-1.0) > 0


def test_a_center_at_a_distance_holds_where_the_moment_fits_the_width():
    # about (-d, 0), |d| > 1/2, both feet move along +y: no moment; closer the left one moves back: force 0, moment 1/2
    assert held((-0.6, 0.0)) > 0
    assert held((-0.4, 0.0)) == pytest.approx(-0.5 / np.hypot(0.5, 0.1), abs=1e-4)


def test_wrong_arguments_are_named(rng):
    with pytest.raises(ValueError, match=r"w must have shape \(s, 2\)"):
        motions(ROD, (0.5, 0.5), (0.3,), ((0, 0),), ((0, -1),), ((0, 1),))
    with pytest.raises(ValueError, match="the sum of each sample 1"):
        motions(ROD, ((0.5, 0.6),), (0.3,), ((0, 0),), ((0, -1),), ((0, 1),))
    with pytest.raises(ValueError, match="mu_c must be at least 0"):
        motions(ROD, HALVES, (-0.1,), ((0, 0),), ((0, -1),), ((0, 1),))
    with pytest.raises(ValueError, match="must have the same length"):
        motions(ROD, HALVES, (0.1,), ((0, 0), (0, 0)), ((0, -1),), ((0, 1),))
    with pytest.raises(ValueError, match="twist of zero"):
        holding_margins(ROD, HALVES, (0.1,), ((0, 0),), ((0, -1),), (0.1,), ((0, 0, 0),), 1.0)
    with pytest.raises(ValueError, match=r"\(k, 2\), \(k, 2\), \(k,\) and \(k, 3\)"):
        holding_margins(ROD, HALVES, (0.1,), ((0, 0),), ((0, -1),), (0.1, 0.2), ((0, 0, 1),), 1.0)
    with pytest.raises(ValueError, match="half-widths at least 0"):
        holding_margins(ROD, HALVES, (0.1,), ((0, 0),), ((0, -1),), (-0.1,), ((0, 0, 1),), 1.0)


def test_searches_that_do_not_converge_say_so(monkeypatch):
    monkeypatch.setattr(quasi_static, "ITERATIONS", 1)
    with pytest.raises(PushfricError, match="did not converge"):
        motions(ROD, HALVES, (0.1,), ((0.3, 0),), ((0, -1),), ((0.5, 1),))
