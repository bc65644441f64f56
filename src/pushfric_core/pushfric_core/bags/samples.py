"""Samples and observations from messages, of a bag or live, and back; any object with the fields will do."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pushfric_core.bags.constants import constants
from pushfric_core.geometry.contact import PushingLine
from pushfric_core.geometry.planar import OBJECT, TABLE, Pose, Twist, is_frame
from pushfric_core.plausible import FARTHEST, STRONGEST, check_within
from pushfric_core.trajectories.ledger import OBSERVATIONS, POSES, STATES, WRENCHES
from pushfric_core.trajectories.observation import Observation
from pushfric_core.trajectories.observation_maker import ForceSample
from pushfric_core.trajectories.samples import PoseSample, PusherSample

New = Callable[..., Any]
"""Makes a message, given the name of its type and some of its fields."""

NO_PUSH = constants("PusherState")["NO_PUSH"]

QUATERNION_LENGTHS = (1e-3, 1e3)
"""A quaternion should have length 1. One with a length in this range is taken for one of length 1; any other is refused."""


def stamp_from_msg(stamp: Any) -> int:
    """The time of a message [ns]."""
    return int(stamp.sec * 10**9 + stamp.nanosec)


def quaternion_length(position: Sequence[float], q: Any) -> float:
    """The length of a pose's quaternion, which should be 1: whoever needs it to be divides by this.

    Raises:
        ValueError: a coordinate of the position or the quaternion is not finite, or the length is not in QUATERNION_LENGTHS.
    """
    values = (*position, q.x, q.y, q.z, q.w)
    if not all(map(math.isfinite, values)):
        raise ValueError(f"a pose must be finite, got {values}")
    length = math.hypot(q.x, q.y, q.z, q.w)
    if not QUATERNION_LENGTHS[0] <= length <= QUATERNION_LENGTHS[1]:
        raise ValueError(f"a pose needs a quaternion of length 1, got length {length:g}")
    return length


def pose_from_msg(msg: Any) -> Pose:
    """The planar part of a pose: its position and its rotation about z, with theta in (-pi, pi].

    Raises:
        ValueError: a value is not finite, a position is beyond FARTHEST, or the quaternion's length is far from 1.
    """
    q, at = msg.orientation, (msg.position.x, msg.position.y)
    quaternion_length(at, q)
    check_within("a position", at, FARTHEST, "m")
    theta = math.atan2(2 * (q.w * q.z + q.x * q.y), q.w**2 + q.x**2 - q.y**2 - q.z**2)
    return Pose(msg.position.x, msg.position.y, theta)


def _check_frame(what: str, name: str) -> None:
    if not is_frame(name, TABLE):
        raise ValueError(f"{what} must have frame_id {TABLE!r}, got {name!r}")


def pose_sample_from_msg(msg: Any) -> PoseSample:
    """The stamp [ns] and the planar pose in a message.

    Raises:
        ValueError: as for `pose_from_msg`, or the pose is in another frame than the table's.
    """
    _check_frame("a pose", msg.header.frame_id or TABLE)
    return PoseSample(stamp_from_msg(msg.header.stamp), pose_from_msg(msg.pose.pose))


def pusher_sample_from_msg(msg: Any) -> PusherSample:
    """The state of a pusher; its line runs through the reported tip, and its origin is at stroke position 0.

    Raises:
        ValueError: a value is not finite, the direction is not a unit vector, the frame is not the table's, or as for
            `PushingLine`.
    """
    _check_frame("a pusher state", msg.header.frame_id or TABLE)
    direction = (msg.direction.x, msg.direction.y)
    numbers = (msg.position, msg.speed, msg.tip.x, msg.tip.y, *direction, msg.tip_radius)
    check_within("a pusher state", numbers, FARTHEST, "m or m/s")
    if msg.push_id < NO_PUSH:
        raise ValueError(f"a push id must be at least 0, got {msg.push_id}")
    if abs(math.hypot(*direction) - 1) > 1e-6:
        raise ValueError(f"the direction of the pushing line must have length 1, got {direction}")
    # rounded to a nanometre, so that the line is the same in every state, whatever the position
    origin = tuple(round(tip - msg.position * along, 9) for tip, along in zip((msg.tip.x, msg.tip.y), direction, strict=True))
    line = PushingLine((origin[0], origin[1]), direction, msg.tip_radius)
    push_id = None if msg.push_id == NO_PUSH else msg.push_id
    return PusherSample(stamp_from_msg(msg.header.stamp), msg.position, msg.speed, line, push_id)


def force_sample_from_msg(msg: Any) -> ForceSample:
    """The planar part of the pusher's force on the object.

    Raises:
        ValueError: the force is not finite, or not in the table frame.
    """
    _check_frame("a wrench", msg.header.frame_id)
    force = (msg.wrench.force.x, msg.wrench.force.y)
    check_within("a force", force, STRONGEST, "N")
    return ForceSample(stamp_from_msg(msg.header.stamp), force)


def observation_from_msg(msg: Any) -> Observation:
    """An observation.

    Raises:
        ValueError, UninformativePush: the message is not an observation, as for `Observation`.
    """
    at, turn = msg.pose.position, msg.pose.orientation
    seen = _known(at.x, at.y, turn.x, turn.y, turn.z, turn.w) is not None
    return Observation(
        contact_point=(msg.contact_point.x, msg.contact_point.y),
        contact_normal=(msg.contact_normal.x, msg.contact_normal.y),
        twist=Twist(msg.twist.linear.x, msg.twist.linear.y, msg.twist.angular.z),
        push_id=msg.push_id,
        half_width=msg.half_width,
        duration=None if math.isnan(msg.duration) else msg.duration,
        stamp=stamp_from_msg(msg.header.stamp),
        pose=pose_from_msg(msg.pose) if seen else None,
        force=_known(msg.force.x, msg.force.y),
        tip_velocity=_known(msg.tip_velocity.x, msg.tip_velocity.y),
        depth=None if math.isnan(msg.depth) else msg.depth,
    )


INPUTS: Mapping[str, tuple[str, Callable[[Any], PoseSample | PusherSample | ForceSample | Observation]]] = {
    "object_pose": (POSES, pose_sample_from_msg),
    "pusher_state": (STATES, pusher_sample_from_msg),
    "wrench": (WRENCHES, force_sample_from_msg),
    "observation": (OBSERVATIONS, observation_from_msg),
}
"""The topics from which observations come, by relative name: the kind of their messages in the ledger, and what reads one."""


def _known(*numbers: float) -> Any:
    """The numbers of a field; None if they are all NaN: then the field is not known."""
    return None if all(map(math.isnan, numbers)) else numbers


def pose_to_msg(pose: Pose, new: New) -> Any:
    """A planar pose as a message, at z = 0."""
    half = pose.theta / 2
    return new(
        "geometry_msgs/msg/Pose",
        position=new("geometry_msgs/msg/Point", x=pose.x, y=pose.y),
        orientation=new("geometry_msgs/msg/Quaternion", z=math.sin(half), w=math.cos(half)),
    )


def unknown_pose(new: New) -> Any:
    """A pose that is not known, as a message: NaN in all its numbers."""
    position, orientation = dict.fromkeys("xyz", math.nan), dict.fromkeys("xyzw", math.nan)
    return new(
        "geometry_msgs/msg/Pose",
        position=new("geometry_msgs/msg/Point", **position),
        orientation=new("geometry_msgs/msg/Quaternion", **orientation),
    )


def observation_to_msg(observation: Observation, object_name: str, new: New) -> Any:
    """An observation as a message for the topic `observation`."""

    def vector(xy: Sequence[float] | None) -> Any:
        x, y, z = (math.nan, math.nan, math.nan) if xy is None else (float(xy[0]), float(xy[1]), 0.0)
        return new("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    msg = new("pushfric_msgs/msg/Observation", object=object_name, push_id=observation.push_id)
    msg.header.stamp.sec, msg.header.stamp.nanosec = divmod(observation.stamp, 10**9)
    msg.header.frame_id = OBJECT
    msg.contact_point.x, msg.contact_point.y = map(float, observation.contact_point)
    msg.contact_normal = vector(observation.contact_normal)
    msg.half_width = observation.half_width
    msg.duration, msg.depth = (math.nan if one is None else one for one in (observation.duration, observation.depth))
    msg.twist.linear.x, msg.twist.linear.y, msg.twist.angular.z = observation.twist
    msg.pose = unknown_pose(new) if observation.pose is None else pose_to_msg(observation.pose, new)
    msg.force, msg.tip_velocity = vector(observation.force), vector(observation.tip_velocity)
    return msg
