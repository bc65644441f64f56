"""The joints that a URDF names, against the kinematics of examples/arm.py, which are written another way."""

import math

import arm as example
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from pushfric_ros.arms.trajectory import DAMPING, Chain, JointTrajectoryConfig, Trajectories
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE
from pushfric_ros.node_kit.visit import visit

SLIDE = """<robot name="gantry"><link name="base"/><link name="turned"/><link name="carriage"/><link name="tip"/>
<joint name="mount" type="fixed"><parent link="base"/><child link="turned"/><origin rpy="0 0 1.5707963267948966"/></joint>
<joint name="rail" type="{kind}"><parent link="turned"/><child link="carriage"/>
<origin xyz="{place}"/><axis xyz="2 0 0"/>{limit}</joint>
<joint name="wrist" type="continuous"><parent link="carriage"/><child link="tip"/>
<origin xyz="0.5 0 0"/><axis xyz="0 0 1"/></joint>
</robot>"""
RAIL = {"kind": "prismatic", "place": "0 0 0", "limit": '<limit lower="-0.1" upper="0.2" velocity="0.5" effort="1"/>'}


def test_the_jacobian_is_that_of_the_arm(rng):
    chain = Chain.between(example.urdf(), "base_link", "tool0")
    assert chain.names == example.NAMES
    for _ in range(20):
        joints = rng.uniform(-2, 2, 6)
        assert chain.jacobian(joints) == pytest.approx(example.forward(joints)[2], abs=1e-12)


def test_the_joints_move_the_link_and_do_not_turn_it():
    chain, joints = Chain.between(example.urdf(), "base_link", "tool0"), example.at_first()
    speeds = chain.speeds(joints, np.array((0.01, -0.02, 0.005)))
    assert example.forward(joints)[2] @ speeds == pytest.approx((0.01, -0.02, 0.005, 0, 0, 0), abs=1e-4)


def test_no_joint_is_faster_than_it_can():
    chain, joints = Chain.between(example.urdf(), "base_link", "tool0"), example.at_first()
    fast, slow = (chain.speeds(joints, np.array((length, 0.0, 0.0))) for length in (100.0, 0.01))
    assert np.abs(fast).max() == pytest.approx(example.FASTEST)
    assert fast / np.linalg.norm(fast) == pytest.approx(slow / np.linalg.norm(slow))  # the same way, slower


def test_a_singular_arm_moves_slowly():
    """Stretched upwards, no joint can raise the tool."""
    chain = Chain.between(example.urdf(), "base_link", "tool0")
    assert np.abs(chain.speeds(np.zeros(6), np.array((0.0, 0.0, 0.01)))).max() < 0.01 / (2 * DAMPING)


def test_slides_and_endless_joints():
    chain = Chain.between(SLIDE.format(**RAIL), "base", "tip")
    assert chain.names == ["rail", "wrist"]
    assert chain.jacobian(np.array((0.3, 1.0))) == pytest.approx(
        np.array(((0, 1, 0, 0, 0, 0), (0, 0, 0, 0, 0, 1))).T, abs=1e-12
    )  # the mount turns x to y
    assert chain.within(np.array((9.0, -50.0))) == pytest.approx((0.2, -50.0))


@pytest.mark.parametrize(
    ("changes", "frames", "error"),
    [
        ({}, ("tip", "base"), "no joints lead from 'tip' to 'base'"),
        ({}, ("base", "turned"), "no joint moves the frame"),
        ({"kind": "floating"}, ("base", "tip"), "joint 'rail' must turn or slide by itself, got floating"),
        ({"limit": '<mimic joint="wrist"/>'}, ("base", "tip"), "joint 'rail' must turn or slide by itself, got mimic"),
        ({"place": "1 2"}, ("base", "tip"), "xyz must be three numbers, got '1 2'"),
        ({"place": "1 2 nan"}, ("base", "tip"), "xyz must be three numbers, got '1 2 nan'"),
        ({"place": "1 2 \\"}, ("base", "tip"), "xyz must be three numbers"),
        ({"place": "<"}, ("base", "tip"), "is not XML: not well-formed"),
    ],
)
def test_a_wrong_urdf_is_one_line(changes, frames, error):
    with pytest.raises(ValueError, match=error) as refusal:
        Chain.between(SLIDE.format(**RAIL | changes), *frames)
    assert "\n" not in str(refusal.value)


def test_joints_are_not_moved_from_where_nobody_knows_that_they_are(ros):
    """Their positions came too long ago, or are none."""
    topics = {"command": "/gantry/commands", "joint_states": "/gantry/joints", "description": "/gantry/urdf"}
    config = JointTrajectoryConfig(frame="tip", reference="base", silence=2.0, **topics)
    gantry = ros.node("gantry")
    sent = ros.heard(gantry, JointTrajectory, config.command, RELIABLE)
    gantry.create_publisher(String, config.description, LATCHED).publish(String(data=SLIDE.format(**RAIL)))
    joints = gantry.create_publisher(JointState, config.joint_states, RELIABLE)

    def lacks(rail):
        joints.publish(JointState(name=["rail", "wrist"], position=[rail, 0.0]))
        return moves.lacks

    with visit("driver") as driver:  # takes what came, and is not spun
        moves = Trajectories(driver.node, config)
        ros.wait_for(lambda: lacks(math.nan) == "no positions of rail on /gantry/joints", what="the joints")
        ros.wait_for(lambda: lacks(0.1) is None, what="the rail")
        ros.wait_for(lambda: moves.lacks, what="silence")  # nothing is published meanwhile
        moves.send(np.array((0.0, 0.01, 0.0)), 10**9)
        ros.wait_for(lambda: lacks(0.1) is None, what="the rail again")
        moves.send(np.array((0.0, 0.01, 0.0)), 2 * 10**9)
        ros.wait_for(lambda: sent, what="a trajectory")
    assert [msg.header.stamp.sec for msg in sent] == [2]
