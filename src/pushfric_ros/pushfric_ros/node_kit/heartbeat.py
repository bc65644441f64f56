"""Signs of life: what a node publishes while it works, and what an actuator makes of those it hears.

A sign of life is a diagnostic_msgs/KeyValue: the node's full name, and the id of the goal of `push` that it owns, as 32
hexadecimal digits, or nothing. The executor that does the node's work sends it: a node that hangs sends none.
"""

import time

from diagnostic_msgs.msg import KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from pushfric_ros.node_kit.qos import RELIABLE

TOPIC = "heartbeat"
PERIOD = 0.05  # [s] of real time


class Heartbeat:
    """Publishes a node's sign of life from its executor; with the goal that it owns, while it owns one."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._msg = KeyValue(key=node.get_fully_qualified_name())
        self._out = node.create_publisher(KeyValue, TOPIC, RELIABLE)
        self._timer = node.create_timer(PERIOD, self._beat, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def own(self, goal: bytes | None) -> None:
        """Own a goal of `push` from now on, and say so at once: its id, 16 bytes; None to own no goal any longer."""
        self._msg.value = (goal or b"").hex()
        self._beat()

    def end(self) -> None:
        """Show no sign of life any more."""
        self._node.destroy_timer(self._timer)
        self._node.destroy_publisher(self._out)

    def _beat(self) -> None:
        self._out.publish(self._msg)


class Listener:
    """When nodes, and owners of goals, last showed a sign of life."""

    def __init__(self, node: Node) -> None:
        self._nodes: dict[str, float] = {}
        self._goals: dict[str, float] = {}
        self._prefix = node.get_namespace().rstrip("/") + "/"
        node.create_subscription(KeyValue, TOPIC, self._on_heartbeat, RELIABLE)

    def silent(self, name: str) -> float:
        """For how long a node has shown none [s]; its name is relative to the namespace."""
        return time.monotonic() - self._nodes.get(self._prefix + name, float("-inf"))

    def ownerless(self, goal: bytes) -> float:
        """For how long the owner of a goal has shown none [s]."""
        return time.monotonic() - self._goals.get(goal.hex(), float("-inf"))

    def _on_heartbeat(self, msg: KeyValue) -> None:
        now = time.monotonic()
        self._nodes[msg.key] = now
        self._goals = {known: then for known, then in self._goals.items() if now - then < 60.0}
        if msg.value:
            self._goals[msg.value] = now
