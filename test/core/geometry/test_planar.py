import numpy as np
import pytest

from pushfric_core.geometry import planar
from pushfric_core.geometry.planar import Pose, Twist


def random_pose(rng):
    return Pose(*rng.uniform(-1, 1, 2), rng.uniform(-3, 3))


def test_transform_turns_counter_clockwise_and_then_shifts():
    assert np.allclose(planar.transform(Pose(1, 2, np.pi / 2), ((1, 0), (0, 1))), ((1, 3), (0, 2)))


def test_inverse_undoes_a_pose(rng):
    for _ in range(20):
        pose = random_pose(rng)
        assert np.allclose(planar.compose(pose, planar.inverse(pose)), (0, 0, 0))
        assert np.allclose(planar.compose(planar.inverse(pose), pose), (0, 0, 0))


def test_compose_agrees_with_transforming_twice(rng):
    a, b, points = random_pose(rng), random_pose(rng), rng.normal(size=(5, 2))
    assert np.allclose(planar.transform(planar.compose(a, b), points), planar.transform(a, planar.transform(b, points)))


def test_exp_is_the_limit_of_small_steps(rng):
    twist = Twist(*rng.normal(size=3))
    pose = Pose(0, 0, 0)
    for _ in range(20000):
        dx, dy = planar.rotation(pose.theta) @ twist[:2] / 20000
        pose = Pose(pose.x + dx, pose.y + dy, pose.theta + twist.omega / 20000)
    assert np.allclose(planar.exp(twist), pose, atol=1e-4)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 0.3, -3.0, 3.1])
def test_log_is_the_inverse_of_exp(angle):
    twist = Twist(0.3, -0.2, angle)
    assert np.allclose(planar.log(planar.exp(twist)), twist, rtol=1e-9, atol=1e-15)


def test_log_takes_the_shorter_way_round():
    assert planar.log(Pose(0, 0, 2 * np.pi - 0.1)).omega == pytest.approx(-0.1)


def test_velocity_of_a_point_right_of_the_origin_under_rotation_points_up():
    assert np.allclose(planar.velocity_at(Twist(0, 0, 2), (3, 0)), (0, 6))


def test_wrap_keeps_the_direction():
    assert planar.wrap(3 * np.pi / 2) == pytest.approx(-np.pi / 2)
    assert planar.wrap(-7.0) == pytest.approx(2 * np.pi - 7.0)
