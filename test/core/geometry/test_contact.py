import numpy as np

from pushfric_core.geometry.contact import PushingLine, contact_interval, friction_cone
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Pose, transform


def test_the_interval_runs_from_minus_t_to_plus_t():
    low, high = contact_interval((0.05, 0), (1, 0), 0.01)
    assert np.allclose(low, (0.05, -0.01))
    assert np.allclose(high, (0.05, 0.01))


def test_the_cone_opens_inward_by_the_friction_angle():
    low, high = friction_cone((0, -1), 1.0)
    assert np.allclose(low, np.array((-1, 1)) / np.sqrt(2))
    assert np.allclose(high, np.array((1, 1)) / np.sqrt(2))


def test_a_line_touches_the_object_where_the_tip_stands(rng):
    outline = Outline.rectangle(0.1, 0.06)
    line = PushingLine((0.1, -0.2), (0.6, 0.8), 0.004)
    for _ in range(20):
        pose = Pose(0.25 + rng.uniform(-0.01, 0.01), rng.uniform(-0.01, 0.01), rng.uniform(-3, 3))
        touch = line.touch(outline, pose)
        tip = np.array(line.origin) + touch.distance * np.array(line.direction)
        assert np.allclose(transform(pose, touch.point + 0.004 * touch.normal), tip)
