"""The pose source node: the object's pose from another tracker -> object_pose."""

from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node

from pushfric_core.cell.mount import MountConfig
from pushfric_core.cell.node_settings import FrameConfig, RequiredSubscribersConfig
from pushfric_core.geometry.planar import TABLE
from pushfric_ros.messages.conversions import pose_to_msg, stamp_to_msg
from pushfric_ros.node_kit.bodies import BodyListener, source_of
from pushfric_ros.node_kit.diagnostics import NO_POSE, Diagnostics, Health, Level, without_publisher
from pushfric_ros.node_kit.heartbeat import Heartbeat
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.qos import RELIABLE
from pushfric_ros.node_kit.required_subscribers import RequiredSubscribers


class PoseSourceNode(Node):
    """Publishes the object's pose for every message that shows it."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("pose_source", **kwargs)
        prefix = declare(self, FrameConfig).within(self.get_namespace())
        self._mount = declare(self, MountConfig)
        source = source_of(self, self._mount)
        self._poses = 0
        topics = Diagnostics(self, self._health, prefix)
        Heartbeat(self)
        self._out = topics.advertise(PoseWithCovarianceStamped, "object_pose", RELIABLE)
        self._required_subscribers = RequiredSubscribers(self, self._out, declare(self, RequiredSubscribersConfig).heard_by)
        self._listener = BodyListener(self, topics, source, self._on_body, "pose")

    def _on_body(self, body: Any) -> None:
        msg = PoseWithCovarianceStamped()
        msg.header.stamp, msg.header.frame_id = stamp_to_msg(self._mount.stamp(body)), TABLE
        msg.pose.pose = pose_to_msg(self._mount.pose(body))
        if not self._required_subscribers.missing:
            self._out.publish(msg)
            self._poses += 1

    def _health(self) -> Health:
        why = self._without_pose()
        values = {"poses": self._poses, NO_POSE: why}
        if why:
            return Health(Level.ERROR if why == self._listener.problem else Level.WARN, why, values)
        return Health(Level.OK, "following" if self._poses else "waiting for a pose", values)

    def _without_pose(self) -> str:
        """Why no pose is published; empty if nothing is known against one."""
        if silent := without_publisher(self):
            return f"no publisher of {', '.join(silent)}"
        missing = self._required_subscribers.missing
        return self._listener.problem or (f"waiting for {', '.join(missing)} to receive the poses" if missing else "")


def main() -> None:
    run_node(PoseSourceNode)
