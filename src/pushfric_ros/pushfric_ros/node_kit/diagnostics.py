"""A node's report of its health and its topics, once a second, on /diagnostics."""

import time
from collections.abc import Callable, Iterable
from enum import Enum
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from pushfric_core.geometry.planar import put_prefix
from pushfric_ros.node_kit.losses import Reception
from pushfric_ros.node_kit.qos import RELIABLE
from pushfric_ros.node_kit.timers import wall_timer

FIRST, PERIOD = 0.1, 1.0
"""Time until a node's first report, and the time between reports that it grows to [s]."""


NO_POSE = "no pose"
"""The figure in which the node that publishes the object's pose says why there is none now; empty: there is one."""


class Level(Enum):
    """How well a node works; the values are those of diagnostic_msgs."""

    OK = DiagnosticStatus.OK
    WARN = DiagnosticStatus.WARN
    ERROR = DiagnosticStatus.ERROR


class Health(NamedTuple):
    """A report: level, a line of text, and figures."""

    level: Level
    message: str
    values: dict[str, Any]


def without_publisher(node: Node) -> list[str]:
    """The topics that a node subscribes to without a matching publisher, except /clock and the like."""
    prefix = node.get_namespace()
    own = (subscription for subscription in node.subscriptions if subscription.topic_name.startswith(prefix))
    return sorted(subscription.topic_name for subscription in own if not subscription.get_publisher_count())


class Awaited:
    """Which nodes of a cell have reported that they are well; those that have also receive the topics they need.

    Args:
        node: the node that waits.
        names: of the nodes it waits for, relative to its namespace.
    Attributes:
        no_pose: why there are no poses of the object, as whichever node of the cell publishes them says; empty if there are.
    """

    def __init__(self, node: Node, names: Iterable[str]) -> None:
        self._prefix = f"{node.get_namespace().rstrip('/')}/"
        self._names = frozenset(self._prefix + name for name in names if name)
        self.no_pose = ""
        self._missing = set(self._names)
        self._at_first = True
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, RELIABLE)

    def renew(self) -> None:
        """Wait for all of them again, as one may have died. Any report will do now: a node that was well has its topics."""
        self._missing, self._at_first = set(self._names), False

    @property
    def missing(self) -> list[str]:
        """The names of those that have not, without the namespace."""
        return sorted(name.rpartition("/")[2] for name in self._missing)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        self._missing -= {status.name for status in msg.status if status.level == DiagnosticStatus.OK or not self._at_first}
        for status in msg.status:
            if status.name.rpartition("/")[0] + "/" == self._prefix:
                self.no_pose = next((figure.value for figure in status.values if figure.key == NO_POSE), self.no_pose)


class Diagnostics:
    """Publishes a node's health at 1 Hz, and more often at first, so that nobody waits long for its first OK.

    It keeps wall time, so it goes on reporting if a simulation clock stands still.

    Topics that are subscribed and advertised through it add their own figures: messages per second of wall time since the last
    report, messages that did not arrive, and the latency, that is the age of the newest message on arrival by the node's
    clock.

    Args:
        node: the node.
        report: makes the node's report.
        frame_prefix: of the cell's frames, put before their names in the messages that the node advertises through this.
    """

    def __init__(self, node: Node, report: Callable[[], Health], frame_prefix: str = "") -> None:
        self._node, self._report, self._prefix = node, report, frame_prefix
        self._inputs: dict[str, Reception] = {}
        self._outputs: dict[str, _CountingPublisher] = {}
        self._counted: dict[str, int] = {}  # number of messages up to the last report
        self._counted_at = time.monotonic()
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", RELIABLE)
        self._timer = wall_timer(node, FIRST, self._on_timer)

    def subscribe(
        self, kind: type, topic: str, callback: Callable[[Any], None], qos: QoSProfile, raw: bool = False
    ) -> Subscription:
        """Make a subscription of the node, as Node.create_subscription does."""
        made = self._inputs[topic] = Reception(self._node, kind, topic, callback, qos, raw)
        return made.subscription

    def advertise(self, kind: type, topic: str, qos: QoSProfile) -> Publisher:
        """Make a publisher of the node, as Node.create_publisher does."""
        made = self._outputs[topic] = self._node.create_publisher(kind, topic, qos, publisher_class=_CountingPublisher)
        made.frame_prefix = self._prefix
        return made

    def publish(self) -> None:
        """Publish a report now, without waiting for the next second."""
        health = self._with_losses(self._report())
        name = self._node.get_fully_qualified_name()
        values = [KeyValue(key=key, value=str(value)) for key, value in (health.values | self._traffic()).items()]
        status = DiagnosticStatus(level=health.level.value, name=name, hardware_id=name, message=health.message, values=values)
        msg = DiagnosticArray(status=[status])
        msg.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(msg)

    def _on_timer(self) -> None:
        self.publish()
        self._timer.timer_period_ns = min(2 * self._timer.timer_period_ns, round(PERIOD * 1e9))

    def _with_losses(self, health: Health) -> Health:
        """The report, with a warning if messages were lost since the last one; the first loss of a topic is logged, too."""
        lost = {}
        for topic, passed in self._inputs.items():
            if new := passed.losses.new():
                lost[topic] = new
                if new == passed.losses.messages:
                    self._node.get_logger().warning(f"{new} messages on {topic} did not arrive")
        if not lost or health.level is not Level.OK:
            return health
        where = ", ".join(f"{number} on {topic}" for topic, number in lost.items())
        return health._replace(level=Level.WARN, message=f"messages did not arrive: {where}")

    def _traffic(self) -> dict[str, Any]:
        before, then = self._counted, self._counted_at
        received = {f"{topic} received [1/s]": passed.count for topic, passed in self._inputs.items()}
        sent = {f"{topic} sent [1/s]": out.sent for topic, out in self._outputs.items()}
        self._counted, self._counted_at = received | sent, time.monotonic()
        seconds = max(self._counted_at - then, 1e-9)
        figures: dict[str, Any] = {
            key: round((count - before.get(key, 0)) / seconds, 1) for key, count in self._counted.items()
        }
        for topic, passed in self._inputs.items():
            figures[f"{topic} lost"] = passed.losses.messages
            if passed.latency is not None:
                figures[f"{topic} latency [s]"] = round(passed.latency, 4)
        return figures


class _CountingPublisher(Publisher):
    sent = 0
    frame_prefix = ""

    def publish(self, msg: Any) -> None:
        put_prefix(msg, self.frame_prefix)
        super().publish(msg)
        self.sent += 1
