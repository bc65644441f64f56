import numpy as np
import pytest

from pushfric_core import TABLE_1, Support, Touch, pushed_motion
from pushfric_core.geometry.planar import cross, left_of, rotation, velocity_at
from pushfric_core.mechanics.quasi_static import ContactMode

ROD = Support(np.array(((-0.5, 0.0), (0.5, 0.0))), np.array((0.5, 0.5)))
SIDE = Touch(0.0, np.array((0.0, 0.0)), np.array((0.0, -1.0)), 0)


def random_push(outline, rng):
    edge = int(rng.integers(len(outline.vertices)))
    point = outline.vertices[edge] + rng.uniform(0.02, 0.98) * outline.edges[edge]
    normal = outline.normals[edge]
    return Touch(0.0, point, normal, edge), rotation(rng.uniform(-1.3, 1.3)) @ -normal


def test_a_push_through_the_center_translates():
    motion = pushed_motion(ROD, SIDE, np.array((0.0, 0.02)), 0.3)
    assert motion.mode is ContactMode.STICKING
    assert motion.twist == pytest.approx((0, 0.02, 0), abs=1e-9)
    assert np.allclose(motion.force, (0, 1))


def test_without_friction_an_oblique_push_moves_along_the_normal():
    motion = pushed_motion(ROD, SIDE, np.array((0.02, 0.02)), 0.0)
    assert motion.mode is ContactMode.SLIDING
    assert motion.twist == pytest.approx((0, 0.02, 0), abs=1e-9)


@pytest.mark.parametrize("mu_c", [0.0, 0.1, 0.3, 0.9])
@pytest.mark.parametrize("name", ["rubber_rect4", "delrin_rect_right"])
def test_forces_balance_and_obey_coulomb(name, mu_c, rng):
    known = TABLE_1[name]
    for _ in range(100):
        touch, velocity = random_push(known.outline, rng)
        motion = pushed_motion(known.support, touch, velocity, mu_c)
        contact_velocity = velocity_at(motion.twist, touch.point)
        normal, along = -motion.force @ touch.normal, motion.force @ left_of(touch.normal)
        slip = (velocity - contact_velocity) @ left_of(touch.normal)
        assert contact_velocity @ touch.normal == pytest.approx(velocity @ touch.normal)
        assert normal > 0
        if motion.mode is ContactMode.STICKING:
            assert slip == pytest.approx(0, abs=1e-9)
            assert abs(along) <= mu_c * normal + 1e-9
        else:
            assert abs(along) == pytest.approx(mu_c * normal, abs=1e-4)
            assert slip * along >= -1e-6
        velocities = velocity_at(motion.twist, known.support.points)
        speeds = np.linalg.norm(velocities, axis=1)
        if speeds.min() > 0.01:  # away from the rounded corner of Coulomb's law
            forces = -velocities / speeds[:, None] * known.support.weights[:, None]
            assert np.allclose(-forces.sum(axis=0), motion.force, atol=1e-6)
            assert cross(known.support.points - touch.point, forces).sum() == pytest.approx(0, abs=1e-6)


def test_a_tip_that_leaves_the_object_does_not_push_it():
    with pytest.raises(ValueError, match="must move into the object"):
        pushed_motion(ROD, SIDE, np.array((0.0, -0.02)), 0.3)
