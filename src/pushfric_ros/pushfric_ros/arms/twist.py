"""Velocities of the tip, as MoveIt Servo and Cartesian velocity controllers take them: the entry point `twist`."""

from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import TwistStamped

from pushfric_core.geometry.planar import Array
from pushfric_core.settings import setting
from pushfric_ros.arms.arm import ArmConfig, Command
from pushfric_ros.messages.conversions import stamp_to_msg
from pushfric_ros.node_kit.qos import NEWEST


@dataclass(frozen=True)
class TwistConfig(ArmConfig):
    """An arm that follows velocities while they come, and stops by itself when they end.

    That it stops is the other side's: `incoming_command_timeout` of Servo, which must not be 0, nor more than 0.25 s.
    """

    command: str = setting("/servo_node/delta_twist_cmds", "topic of the velocities, geometry_msgs/TwistStamped")

    def open_command(self, node: Any) -> Command:
        """Velocities on the topic."""
        return Velocities(node, self.command, self.reference)


class Velocities:
    """A stream of TwistStamped."""

    def __init__(self, node: Any, topic: str, frame: str) -> None:
        self.topic, self._frame = topic, frame
        # an older command must neither wait for a busy subscriber nor outlive this process
        self._out = node.create_publisher(TwistStamped, topic, NEWEST)

    @property
    def lacks(self) -> str | None:
        return None if self._out.get_subscription_count() else f"nobody listens to {self.topic}"

    def send(self, velocity: Array, stamp: int) -> None:
        msg = TwistStamped()
        msg.header.frame_id = self._frame
        msg.header.stamp = stamp_to_msg(stamp)
        msg.twist.linear.x, msg.twist.linear.y, msg.twist.linear.z = map(float, velocity)
        self._out.publish(msg)
