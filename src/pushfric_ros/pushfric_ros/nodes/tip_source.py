"""The tip source node: the position of a tip that another robot moves -> pusher_state, with a number for each push."""

import math
import pathlib
from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import Point, PoseWithCovarianceStamped, Vector3
from rclpy.node import Node

from pushfric_core.bags.contents import mcap_file
from pushfric_core.bags.samples import pose_sample_from_msg
from pushfric_core.cell.mount import MountConfig
from pushfric_core.cell.node_settings import FrameConfig, ObjectConfig, TipConfig, TipNodeConfig
from pushfric_core.files.object_file import load_object
from pushfric_core.geometry.planar import TABLE, Array, inverse, transform
from pushfric_core.trajectories.stream import DISORDER
from pushfric_msgs.msg import PusherState
from pushfric_ros.messages.conversions import stamp_to_msg
from pushfric_ros.node_kit.bodies import BodyListener, source_of
from pushfric_ros.node_kit.diagnostics import Diagnostics, Health, Level, without_publisher
from pushfric_ros.node_kit.heartbeat import Heartbeat
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.qos import RELIABLE
from pushfric_ros.node_kit.timers import wall_timer

if TYPE_CHECKING:
    from pushfric_core.bags.resumption import PushCount

COUNT_PERIOD = 0.2
"""Time between two looks into the bag, while a node that was started again counts the pushes in it, in wall time [s]."""


class TipSourceNode(Node):
    """Publishes a state for every message that shows the tip; it cannot move the robot.

    A push lasts from when the tip comes near the object until it is away from it again. A restarted node continues the numbers
    of the run's bag; until the bag holds all of its own messages, no push has a number.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("tip_source", **kwargs)
        prefix = declare(self, FrameConfig).within(self.get_namespace())
        self._mount, self._config = declare(self, MountConfig), declare(self, TipConfig)
        self._object = load_object(declare(self, ObjectConfig).object)
        source = source_of(self, self._mount)
        self._pose: Any = None  # the object's, when it was last seen
        self._last: tuple[int, Array] | None = None  # stamp [ns] and place [m] of the tip
        self._direction = np.array((1.0, 0.0))
        self._pushes, self._near = 0, False
        self._first: int | None = None  # stamp of the first state of this node [ns]
        self._bag = declare(self, TipNodeConfig).bag
        self._before = self._counted()
        topics = Diagnostics(self, self._health, prefix)
        Heartbeat(self)
        self._out = topics.advertise(PusherState, "pusher_state", RELIABLE)
        topics.subscribe(PoseWithCovarianceStamped, "object_pose", self._on_pose, RELIABLE)
        self._listener = BodyListener(self, topics, source, self._on_body, "tip")
        if self._before is not None:
            self.get_logger().warning(f"numbers the pushes on from {self._bag}")
            self._look = wall_timer(self, COUNT_PERIOD, self._count_on)

    def _counted(self) -> "PushCount | None":
        """The pushes that a node before this one has numbered; None if this is the first one of the run."""
        if not self._bag or not mcap_file(pathlib.Path(self._bag)).exists():
            return None
        from pushfric_core.bags.resumption import PushCount  # imported late: few nodes of this kind need to read bags

        before = PushCount(pathlib.Path(self._bag), self.get_namespace())
        return None if before.newest is None else before

    def _count_on(self) -> None:
        """Number the pushes from now on, once all that came before have been counted."""
        assert self._before is not None
        self._before.read_on()
        newest = self._before.newest
        if self._first is not None and newest is not None and newest >= self._first:
            self._pushes, self._before = self._before.pushes, None
            self._look.cancel()

    def _on_pose(self, msg: PoseWithCovarianceStamped) -> None:
        try:
            self._pose = pose_sample_from_msg(msg).pose
        except ValueError as error:
            self._listener.refuse(error)

    def _on_body(self, body: Any) -> None:
        stamp, tip = self._mount.stamp(body), self._mount.point(body)
        speed = 0.0
        if self._last is not None:
            step, moved = stamp - self._last[0], tip - self._last[1]
            if -DISORDER < step <= 0:
                return  # a repetition, or a message that a later one overtook
            length = float(np.hypot(*moved))
            if length > 0 and step > 0:
                self._direction, speed = moved / length, length / step * 1e9
        self._last = stamp, tip
        if self._before is None:
            self._count(tip)
        if self._first is None:
            self._first = stamp
        moving = speed > 0
        msg = PusherState(
            mode=PusherState.MODE_RUNNING if moving else PusherState.MODE_IDLE,
            speed=speed,
            tip=Point(x=float(tip[0]), y=float(tip[1])),
            direction=Vector3(x=float(self._direction[0]), y=float(self._direction[1])),
            tip_radius=self._config.tip_radius,
            push_id=self._pushes - 1 if self._near else PusherState.NO_PUSH,
        )
        msg.header.stamp, msg.header.frame_id = stamp_to_msg(stamp), TABLE
        self._out.publish(msg)

    def _count(self, tip: Array) -> None:
        """Number the pushes: a new push begins when the tip comes near the object again."""
        distance = math.inf
        if self._pose is not None:
            at = transform(inverse(self._pose), tip)
            distance = self._object.outline.nearest(at).distance - self._config.tip_radius
        near = distance < self._config.near
        self._pushes += near and not self._near
        self._near = near

    def _health(self) -> Health:
        values = {"pushes": self._pushes}
        if silent := without_publisher(self):
            return Health(Level.WARN, f"no publisher of {', '.join(silent)}", values)
        if self._listener.problem:
            return Health(Level.ERROR, self._listener.problem, values)
        return Health(Level.OK, "following" if self._last else "waiting for the tip", values)


def main() -> None:
    run_node(TipSourceNode)
