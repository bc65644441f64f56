"""What a node says of its own health, once a second on /diagnostics."""

from collections.abc import Callable
from enum import Enum
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from pushfric_ros.qos import RELIABLE


class Level(Enum):
    """How a node is; the values are diagnostic_msgs' own."""

    OK = DiagnosticStatus.OK
    WARN = DiagnosticStatus.WARN
    ERROR = DiagnosticStatus.ERROR


class Health(NamedTuple):
    """One report: level, a line for people, and figures."""

    level: Level
    message: str
    values: dict[str, Any]


def without_publisher(node: Node) -> list[str]:
    """The topics that a node subscribes to but that have no publisher matched with it; /clock and the like aside."""
    prefix = node.get_namespace()
    own = (subscription for subscription in node.subscriptions if subscription.topic_name.startswith(prefix))
    return sorted(subscription.topic_name for subscription in own if not subscription.get_publisher_count())


class Diagnostics:
    """Publishes a node's health at 1 Hz of wall time, so that a stopped simulation clock shows too."""

    def __init__(self, node: Node, report: Callable[[], Health]) -> None:
        self._node, self._report = node, report
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", RELIABLE)
        node.create_timer(1.0, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def publish(self) -> None:
        """Publish now, without waiting for the next second."""
        health = self._report()
        name = self._node.get_fully_qualified_name()
        values = [KeyValue(key=key, value=str(value)) for key, value in health.values.items()]
        status = DiagnosticStatus(level=health.level.value, name=name, hardware_id=name, message=health.message, values=values)
        msg = DiagnosticArray(status=[status])
        msg.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(msg)
