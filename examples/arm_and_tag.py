"""An arm that pushes an object along curves, and a detector of the tag on it: both simulated, for examples/arm_and_tag.yaml.

python3 examples/arm_and_tag.py
"""

import contextlib
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import Point, PoseStamped, Quaternion
from geometry_msgs.msg import Pose as PoseMsg
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import Header

from pushfric_core import TABLE_1, Pose, PushedObject, PushingLine
from pushfric_core.estimation.push_plan import PlannedPush, planned_contact
from pushfric_core.geometry.planar import compose, transform
from pushfric_ros.messages.conversions import pose_to_msg, stamp_to_msg

NAME = "wood_rect4"
RATE = 30.0  # frames of the detector, and three times as many poses of the tool [Hz]
TIP_RADIUS = 0.005
NOISE = np.array((1e-4, 1e-4, 1e-3))  # of the detector [m, m, rad]
BASE = Pose(0.5, 0.1, 0.3)  # the table, seen from the base of the arm and from the detector
TAG = Pose(-0.01, -0.02, math.pi / 2)  # the tag, seen from the object; it lies on top, 30 mm above the middle
TOOL = 0.12  # from the flange to the tip, which points down [m]
PUSHES = ((0, -0.03), (0, 0.02), (1, 0.01), (2, 0.03), (2, -0.02), (3, -0.01))  # edge, and offset from its middle [m]


def motion(seed: int) -> Iterator[tuple[bool, Pose, np.ndarray]]:
    """At three times RATE: whether the detector takes a frame, the object's pose, and the tip's place on the table (2,) [m]."""
    rng, known = np.random.default_rng(seed), TABLE_1[NAME]
    for edge, offset in PUSHES:
        bend, speed = rng.uniform(-0.6, 0.6), rng.uniform(0.01, 0.03)  # of the path [rad], [m/s]
        pushed = PushedObject(known.outline, known.support, known.mu_c, Pose(0.05, 0.02, rng.uniform(-1, 1)))
        contact, inward = planned_contact(known.outline, PlannedPush(edge, offset))
        tip = transform(pushed.pose, contact - (TIP_RADIUS + 0.02) * inward)
        heading = pushed.pose.theta + math.atan2(inward[1], inward[0])
        step = speed / (3 * RATE)
        for count in range(math.ceil(0.07 / step)):
            heading += bend * step / 0.07
            direction = (math.cos(heading), math.sin(heading))
            pushed.push(PushingLine((float(tip[0]), float(tip[1])), direction, TIP_RADIUS), step)
            tip = tip + step * np.array(direction)
            yield count % 3 == 0, Pose(*np.add(pushed.pose, NOISE * rng.normal(size=3)).tolist()), tip
        for _ in range(30):  # up and away
            tip = tip - 0.002 * np.array(direction)
            yield False, pushed.pose, tip


class ArmAndTag(Node):
    """Publishes tool_pose and tag_pose, and ends when the pushes are done."""

    def __init__(self, seed: int = 0, **kwargs: Any) -> None:
        super().__init__("arm_and_tag", **kwargs)
        self._tool, self._tag = (self.create_publisher(PoseStamped, name, 10) for name in ("tool_pose", "tag_pose"))
        self._motion = motion(seed)
        self._stamp = self.get_clock().now().nanoseconds
        self.timer = self.create_timer(1 / (3 * RATE), self._spin)

    def _spin(self) -> None:
        if not self.move():
            raise SystemExit

    def move(self) -> bool:
        """Take a step once somebody subscribes; return whether a step was left."""
        if not (self._tool.get_subscription_count() and self._tag.get_subscription_count()):
            return True
        step = next(self._motion, None)
        if step is None:
            return False
        frame, pose, tip = step
        self._stamp += round(1e9 / (3 * RATE))
        x, y = transform(BASE, tip).tolist()
        # the tool points down: half a turn about x
        self._publish(self._tool, PoseMsg(position=Point(x=x, y=y, z=TOOL), orientation=Quaternion(x=1.0, w=0.0)))
        if frame:
            tag = pose_to_msg(compose(BASE, compose(pose, TAG)))
            tag.position.z = 0.03
            self._publish(self._tag, tag)
        return True

    def _publish(self, out: Any, pose: PoseMsg) -> None:
        out.publish(PoseStamped(header=Header(frame_id="base_link", stamp=stamp_to_msg(self._stamp)), pose=pose))


if __name__ == "__main__":
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(ArmAndTag(namespace="/cell"))
