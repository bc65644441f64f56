"""Bodies in the messages of other trackers, against rotations that a person can check."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from composition import made
from geometry_msgs.msg import Point, Pose, PoseStamped, PoseWithCovarianceStamped, Quaternion, TransformStamped

from pushfric_core.bags.samples import pose_sample_from_msg
from pushfric_core.cell.mount import Body, MountConfig
from pushfric_core.geometry.planar import Pose as Planar
from pushfric_core.geometry.planar import compose, transform
from pushfric_core.plugins import SOURCES, plugin
from pushfric_ros.adapters.body import FIXED, MOVING, PoseStampedConfig, TransformsConfig
from pushfric_ros.messages.types import message_class
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_QUEUE
from pushfric_ros.nodes.pose_source import PoseSourceNode

POSE = Pose(position=Point(x=0.3, y=-0.2, z=0.1), orientation=Quaternion(z=math.sin(0.4), w=math.cos(0.4)))


def about(axis, angle):
    """The parts x, y, z, w of a quaternion."""
    return (*(math.sin(angle / 2) * np.array(axis, dtype=float)), math.cos(angle / 2))


def transform_msg(parent, child, position, quaternion, stamp=0):
    msg = TransformStamped(child_frame_id=child)
    msg.header.frame_id, msg.header.stamp.sec = parent, stamp
    for name, value in zip("xyz", position, strict=True):
        setattr(msg.transform.translation, name, float(value))
    for name, value in zip("xyzw", quaternion, strict=True):
        setattr(msg.transform.rotation, name, float(value))
    return msg


def tf(*transforms):
    """A TFMessage, whose package need not be installed."""
    return SimpleNamespace(transforms=transforms)


def test_a_pose_is_found_in_its_message():
    msg = PoseStamped(pose=POSE)
    msg.header.stamp.sec, msg.header.stamp.nanosec = 3, 7
    source = PoseStampedConfig("there").open_source()
    ((topic, (type_name, quality)),) = source.topics.items()
    assert (topic, message_class(type_name), quality) == ("there", PoseStamped, "sensor_data")
    body = source.body(topic, msg)
    assert body.stamp == 3_000_000_007
    assert MountConfig().pose(body) == pytest.approx((0.3, -0.2, 0.8))


def test_a_frame_is_followed_through_the_tree():
    source = TransformsConfig(frame="tool", reference="base").open_source()
    assert source.topics == {"/tf_static": ("tf2_msgs/msg/TFMessage", "latched"), "/tf": ("tf2_msgs/msg/TFMessage", "reliable")}
    assert source.body(MOVING, tf(transform_msg("link", "tool", (0, 0, 0.5), about((0, 0, 1), 0.0), 5))) is None
    # base stands next to link's parent in the world, turned by a quarter
    assert source.body(FIXED, tf(transform_msg("world", "base", (1, 0, 0), about((0, 0, 1), math.pi / 2)))) is None
    body = source.body(MOVING, tf(transform_msg("world", "link", (1, 2, 0), about((1, 0, 0), math.pi), 6)))
    assert body.stamp == 6_000_000_000
    assert body.position == pytest.approx((2, 0, -0.5))  # half a turn about x: tool is below link
    assert source.body(MOVING, tf(transform_msg("world", "elsewhere", (0, 0, 0), about((0, 0, 1), 0.0), 7))) is None
    nonsense = transform_msg("world", "elsewhere", (0, 0, 0), (0, 0, 0, 0), 7)  # of a frame that is on no way to the tool
    assert (
        source.body(MOVING, tf(nonsense, transform_msg("world", "link", (1, 2, 0), about((1, 0, 0), math.pi), 7))) is not None
    )
    with pytest.raises(ValueError, match="a quaternion of length 1, got length 0"):
        source.body(MOVING, tf(transform_msg("world", "link", (1, 2, 0), (0, 0, 0, 0), 7)))
    with pytest.raises(ValueError, match="the transforms above the frame 'tool' run in a circle"):
        source.body(MOVING, tf(transform_msg("tool", "world", (0, 0, 0), about((0, 0, 1), 0.0), 8)))


def test_transforms_are_those_of_the_installed_message():
    tf2 = pytest.importorskip("tf2_msgs.msg", reason="tf2_msgs is not installed")
    source = TransformsConfig(frame="tag", reference="table").open_source()
    msg = tf2.TFMessage(transforms=[transform_msg("table", "tag", (0.3, 0.1, 0), about((0, 0, 1), 0.5), 5)])
    assert MountConfig().pose(source.body(MOVING, msg)) == pytest.approx((0.3, 0.1, 0.5))
    assert message_class(source.topics[MOVING][0]) is tf2.TFMessage


def test_a_mount_brings_a_body_to_the_table(rng):
    for _ in range(20):
        table, pose = Planar(*rng.uniform(-1, 1, 3)), Planar(*rng.uniform(-1, 1, 3))
        offset, turn = rng.uniform(-0.1, 0.1, 2), float(rng.uniform(-3, 3))
        # the body is where the object's origin is, less the offset in the body's frame
        seen = compose(table, pose)
        body_pose = compose(seen, compose(Planar(0, 0, -turn), Planar(*-offset, 0.0)))
        q = Quaternion(z=2 * math.sin(body_pose.theta / 2), w=2 * math.cos(body_pose.theta / 2))  # of length 2
        body = Body.of(SimpleNamespace(sec=1, nanosec=0), Point(x=body_pose.x, y=body_pose.y, z=0.3), q)
        mount = MountConfig(origin=(*offset, -0.3), turn=turn, table=tuple(table), time_offset=-0.25)
        assert mount.stamp(body) == 750_000_000
        found = mount.pose(body)
        assert found[:2] == pytest.approx(pose[:2])
        assert math.cos(found.theta - pose.theta) == pytest.approx(1)
        assert mount.point(body) == pytest.approx(transform(pose, (0, 0)))


@pytest.mark.parametrize(
    ("position", "quaternion", "error"),
    [
        ((math.nan, 0, 0), (0, 0, 0, 1), "a pose must be finite"),
        ((0, 0, 0), (0, 0, 0, 0), "a quaternion of length 1, got length 0"),
    ],
)
def test_a_pose_of_no_use_is_refused(position, quaternion, error):
    with pytest.raises(ValueError, match=error):
        Body.of(
            SimpleNamespace(sec=0, nanosec=0),
            *(SimpleNamespace(**dict(zip("xyzw", v, strict=False))) for v in (position, quaternion)),
        )


def test_mounts_are_checked():
    with pytest.raises(ValueError, match=r"origin must be a list of 3 finite numbers, got \[0.0, 1.0\]"):
        MountConfig(origin=(0.0, 1.0))
    with pytest.raises(ValueError, match=r"source must be an entry point of pushfric.sources \(.*transforms\), got 'radar'"):
        plugin(SOURCES, "radar")


def test_transforms_become_poses_of_the_object(ros):
    tf2 = pytest.importorskip("tf2_msgs.msg", reason="tf2_msgs is not installed")
    ros.compose(made(PoseSourceNode, source="transforms", frame="tag36h11:3", reference="table", turn=0.1))
    node = ros.node("detector", namespace="/cell")
    seen = ros.heard(node, PoseWithCovarianceStamped, "object_pose", SENSOR_QUEUE)
    fixed, moving = node.create_publisher(tf2.TFMessage, FIXED, LATCHED), node.create_publisher(tf2.TFMessage, MOVING, RELIABLE)
    down = about((1, 0, 0), math.pi)  # the camera looks down from 1 m
    fixed.publish(tf2.TFMessage(transforms=[transform_msg("table", "camera", (0.2, 0, 1), down)]))
    tag = transform_msg("camera", "tag36h11:3", (0.1, -0.3, 0.97), down, 5)
    ros.wait_for(lambda: moving.publish(tf2.TFMessage(transforms=[tag])) or seen, 60.0, "a pose")
    pose = pose_sample_from_msg(seen[0])
    assert pose.stamp == 5_000_000_000
    assert pose.pose == pytest.approx((0.3, 0.3, 0.1))
