"""A robot arm with six axes, simulated, as the driver `twist` sees one: for examples/arm.yaml.

python3 examples/arm.py                                            # is the arm, until Ctrl-C
./pushfric run examples/arm.yaml --simulated-camera                # in another terminal: it pushes a rendered object

It takes what MoveIt Servo takes: velocities of the tool, each good for TIMEOUT. It answers with the tool's pose, on tool_pose
and, if tf2_msgs is installed, on /tf.
"""

import math
import time
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, TransformStamped, TwistStamped
from rclpy.node import Node

from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.qos import RELIABLE
from pushfric_ros.node_kit.transforms import TransformBroadcaster

PERIOD = 0.005  # of the controller [s]
POSES = 2  # every second period has a pose
TIMEOUT = 0.1  # after the last command, the arm stops [s]
LAG = 0.03  # the joints follow a command with this time constant [s]
FASTEST = 2.0  # of a joint [rad/s]
REACH = math.radians(175)  # of a joint, to either side [rad]

AXES = np.array(((0, 0, 1), (0, 1, 0), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 0, 1)), float)  # of the joints, in their links
OFFSETS = np.array(((0, 0, 0.2), (0, 0, 0.1), (0, 0, 0.45), (0, 0, 0.4), (0, 0, 0.05), (0, 0, 0.05)))  # from link to link [m]
FLANGE = np.array((0, 0, 0.05))  # from the last link [m]
TOOL = 0.12  # from the flange to the tip [m]

TABLE = (0.5, 0.1, 0.3)  # x, y [m] and angle [rad] of the table frame, seen from the base; its z axis points up, too
TIP = (0.0, 0.0)  # where the tip stands at first, on the table [m]
ABOVE = 0.002  # the tip, over the table [m]
DOWN = np.diag((1.0, -1.0, -1.0))  # axes of a flange that points down
ELBOW_UP = np.array((0.2, 0.4, 1.6, 1.1, 0.0, 0.0))  # near such a place [rad]


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation matrix (Rodrigues)."""
    x, y, z = axis
    k = np.array(((0, -z, y), (z, 0, -x), (-y, x, 0)))
    return np.eye(3) + math.sin(angle) * k + (1 - math.cos(angle)) * k @ k


def forward(joints: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The flange's place [m] and axes, and the Jacobian (6, 6): its velocity and rotational velocity for that of each joint."""
    place, axes, hinges = np.zeros(3), np.eye(3), []
    for offset, axis, angle in zip(OFFSETS, AXES, joints, strict=True):
        place = place + axes @ offset
        hinges.append((place, axes @ axis))
        axes = axes @ turn(axis, angle)
    place = place + axes @ FLANGE
    return place, axes, np.array([(*np.cross(about, place - at), *about) for at, about in hinges]).T


def backward(place: np.ndarray, axes: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """The joints with the flange at a place, from others that are near (Newton)."""
    for _ in range(100):
        here, now, jacobian = forward(joints)
        off = axes @ now.T
        turned = 0.5 * np.array((off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]))
        joints = joints + np.clip(np.linalg.solve(jacobian, np.array((*(place - here), *turned))), -0.3, 0.3)
    return joints


def at_first() -> np.ndarray:
    """The joints with the tip at TIP."""
    x, y, angle = TABLE
    c, s = math.cos(angle), math.sin(angle)
    place = np.array((x + c * TIP[0] - s * TIP[1], y + s * TIP[0] + c * TIP[1], TOOL + ABOVE))
    return backward(place, DOWN, ELBOW_UP)


class Arm(Node):
    """The arm with its controller."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("arm", **kwargs)
        self.joints, self._speeds = at_first(), np.zeros(6)
        self._wanted, self._good_until = np.zeros(6), 0.0
        self._then, self._count = time.monotonic(), 0
        self._pose_out = self.create_publisher(PoseStamped, "/tool_pose", RELIABLE)
        self._broadcaster = TransformBroadcaster(self, "")
        self.create_subscription(TwistStamped, "/servo_node/delta_twist_cmds", self._on_twist, RELIABLE)
        self.create_timer(PERIOD, self._step)

    def _on_twist(self, msg: TwistStamped) -> None:
        linear, angular = msg.twist.linear, msg.twist.angular
        self._wanted = np.array((linear.x, linear.y, linear.z, angular.x, angular.y, angular.z))
        self._good_until = time.monotonic() + TIMEOUT

    def _step(self) -> None:
        """Follow the last command while it is good."""
        now = time.monotonic()
        seconds, self._then = min(now - self._then, 0.05), now
        wanted = np.zeros(6)
        if now < self._good_until:
            jacobian = forward(self.joints)[2]
            wanted = np.clip(np.linalg.solve(jacobian, self._wanted), -FASTEST, FASTEST)
        self._speeds += (wanted - self._speeds) * (1 - math.exp(-seconds / LAG))
        self.joints = np.clip(self.joints + self._speeds * seconds, -REACH, REACH)
        self._count += 1
        if self._count % POSES == 0:
            self._publish(*forward(self.joints)[:2])

    def _publish(self, place: np.ndarray, axes: np.ndarray) -> None:
        msg = TransformStamped(child_frame_id="tool0")
        msg.header.frame_id, msg.header.stamp = "base_link", self.get_clock().now().to_msg()
        # the flange always points down, more or less: its axes are about those of half a turn about x
        w = 0.5 * math.sqrt(max(0.0, 1 + axes[0, 0] - axes[1, 1] - axes[2, 2]))
        x, y, z = w, (axes[0, 1] + axes[1, 0]) / (4 * w), (axes[0, 2] + axes[2, 0]) / (4 * w)
        rotation, translation = msg.transform.rotation, msg.transform.translation
        rotation.x, rotation.y, rotation.z, rotation.w = x, y, z, (axes[2, 1] - axes[1, 2]) / (4 * w)
        translation.x, translation.y, translation.z = map(float, place)
        pose = PoseStamped(header=msg.header)
        pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = map(float, place)
        pose.pose.orientation = rotation
        self._pose_out.publish(pose)
        self._broadcaster.broadcast(msg)


if __name__ == "__main__":
    run_node(Arm)
