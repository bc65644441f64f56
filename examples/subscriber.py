"""A subscriber: prints where the pushed object's centre of friction is, and how far that can be trusted.

python3 examples/subscriber.py          while ./pushfric demo runs
"""

import contextlib
import math
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from pushfric_msgs.msg import FrictionEstimate

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""With this quality of service, the last estimate comes at once, however late the node starts."""


class Subscriber(Node):
    """Prints each estimate that may be used."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("subscriber", **kwargs)
        self.create_subscription(FrictionEstimate, "friction_estimate", self._on_estimate, LATCHED)

    def _on_estimate(self, msg: FrictionEstimate) -> None:
        if msg.status != msg.STATUS_OPTIMAL:
            return  # nothing is known, or the pushes contradict each other
        known = not math.isnan(msg.confidence)
        center = msg.spread.center_of_friction if known else msg.center_of_friction
        x, y = 1e3 * center.x, 1e3 * center.y
        trust = f", off by at most {1e3 * msg.confidence:.1f} mm with 90 %" if known else ""
        print(f"{msg.object}: p_CF ({x:.1f}, {y:.1f}) mm from {msg.pushes} pushes{trust}", flush=True)


def main() -> None:
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Subscriber(namespace="/cell"))


if __name__ == "__main__":
    main()
