import math

import numpy as np
import pytest
from geometry_msgs.msg import Pose as PoseMsg
from geometry_msgs.msg import Quaternion
from problems import four_feet
from rclpy.serialization import deserialize_message, serialize_message

from pushfric_core.estimator import Estimator
from pushfric_core.observation import Observation
from pushfric_core.planar import Pose, Twist
from pushfric_msgs.msg import FrictionEstimate, PusherState
from pushfric_ros import conversions


def test_stamps_keep_every_nanosecond():
    for stamp in (0, 1, 1_700_000_000_123_456_789):
        assert conversions.stamp_from_msg(conversions.stamp_to_msg(stamp)) == stamp


def test_poses_survive_the_message(rng):
    for _ in range(50):
        pose = Pose(*rng.normal(size=2), rng.uniform(-math.pi, math.pi))
        assert conversions.pose_from_msg(conversions.pose_to_msg(pose)) == pytest.approx(pose)


def test_a_quaternion_need_not_be_of_unit_length():
    assert conversions.pose_from_msg(PoseMsg(orientation=Quaternion(z=2.0, w=2.0))).theta == pytest.approx(math.pi / 2)


def test_poses_that_are_none_are_refused():
    with pytest.raises(ValueError, match="must be finite"):
        conversions.pose_from_msg(conversions.pose_to_msg(Pose(math.nan, 0, 0)))
    with pytest.raises(ValueError, match="quaternion of length 1"):
        conversions.pose_from_msg(PoseMsg(orientation=Quaternion(w=0.0)))


@pytest.mark.parametrize(("force", "pose"), [(None, Pose(0.25, 0.5, 0.0)), ((1.5, -0.5), None)])
def test_observations_survive_message_and_wire_bit_for_bit(force, pose):
    observation = Observation(
        contact_point=(0.1, 1 / 3),
        contact_normal=(0.6, -0.8),
        twist=Twist(0.01, 1e-9, -0.3),
        push_id=7,
        half_width=0.002,
        duration=1 / 7,
        stamp=123456789123456789,
        pose=pose,
        force=force,
    )
    wire = serialize_message(conversions.observation_to_msg(observation, "box"))
    msg = deserialize_message(wire, type(conversions.observation_to_msg(observation, "box")))
    assert msg.object == "box"
    assert conversions.observation_from_msg(msg) == observation


def state(position=0.02, **changes):
    msg = PusherState(position=position, speed=0.02, tip_radius=0.003, push_id=4)
    msg.direction.x, msg.direction.y = 0.6, 0.8
    msg.tip.x, msg.tip.y = 0.1 + 0.6 * position, -0.2 + 0.8 * position
    for name, value in changes.items():
        setattr(msg, name, value)
    return msg


def test_the_pushing_line_is_the_same_wherever_the_tip_stands():
    lines = {conversions.pusher_sample_from_msg(state(position)).line for position in np.linspace(0, 0.06, 50)}
    assert len(lines) == 1
    assert lines.pop() == ((0.1, -0.2), (0.6, 0.8), 0.003)


def test_no_push_is_none():
    assert conversions.pusher_sample_from_msg(state(push_id=PusherState.NO_PUSH)).push_id is None
    assert conversions.pusher_sample_from_msg(state()).push_id == 4


def test_pusher_states_that_are_none_are_refused():
    with pytest.raises(ValueError, match="pusher state must be finite"):
        conversions.pusher_sample_from_msg(state(speed=math.nan))
    bent = state()
    bent.direction.x = 1.0
    with pytest.raises(ValueError, match="direction of the pushing line must have length 1"):
        conversions.pusher_sample_from_msg(bent)


def test_an_estimate_becomes_a_message_without_loss():
    problem = four_feet()
    estimator = Estimator(problem.truth.points)
    for observation in problem.observations[:9]:
        estimate = estimator.add(observation)
    msg = conversions.estimate_to_msg(estimate, "box")
    assert msg.status == FrictionEstimate.STATUS_OPTIMAL
    assert (msg.data_points, msg.pushes) == (9, 9)
    assert list(msg.support_friction.weights) == list(estimate.w)
    assert [(p.x, p.y) for p in msg.support_friction.support_points] == [tuple(p) for p in estimate.support_points]
    assert (msg.center_of_friction.x, msg.center_of_friction.y) == tuple(estimate.center_of_friction)
    assert (msg.contact_friction.p90, msg.contact_friction.max) == (estimate.mu_c_p90, estimate.mu_c_max)
    assert msg.gap == estimate.solution.gap
