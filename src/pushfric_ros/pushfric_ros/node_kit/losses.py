"""The messages of a topic that were published but did not arrive: counted here for every node that must not miss any.

`qos` says on which topics messages can be lost, and what follows.
"""

import time
from collections.abc import Callable, Iterator
from typing import Any

from rclpy.event_handler import QoSMessageLostInfo, QoSRequestedIncompatibleQoSInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from pushfric_core.bags.samples import stamp_from_msg


class Losses:
    """Counts what one subscription misses.

    The middleware reports what it lost on the way, but not what a full queue dropped while this process was busy or stopped.
    The publisher's numbers show both, but only if there is a single publisher.

    Args:
        quality: what the subscription asks for.
    Attributes:
        promised: every message is to arrive, so that a loss is a fault.
    """

    def __init__(self, quality: QoSProfile) -> None:
        self._counted = quality.durability != DurabilityPolicy.TRANSIENT_LOCAL
        self.promised = quality.reliability == ReliabilityPolicy.RELIABLE
        self._reported = self._told = 0
        self._missing = 0  # from the publisher's numbers
        self._last: int | None = None
        self._last_ns = 0  # when the last message came
        self.first_ns: int | None = None  # before the first loss, by the clock that `count` is given
        self.until_ns = 0  # after the last one

    @property
    def messages(self) -> int:
        """Number of messages lost so far."""
        return max(self._reported, self._missing)

    def new(self) -> int:
        """Number of messages lost since this was last asked."""
        before, self._told = self._told, self.messages
        return self._told - before

    def reported(self, event: QoSMessageLostInfo) -> None:
        """Take the middleware's report; the callback for its event `message_lost`."""
        if self._counted:
            self._reported += event.total_count_change
            self._note(self._last_ns)

    def count(self, number: int | None, publishers: Callable[[], int], now_ns: int = 0) -> None:
        """Take the publisher's number of a message that came; None if the middleware has no numbers."""
        # numbers that start again come from a restarted publisher
        if self._counted and number is not None and self._last is not None and number > self._last + 1 and publishers() == 1:
            self._missing += number - self._last - 1
            self._note(now_ns)
        self._last, self._last_ns = number, now_ns

    def _note(self, now_ns: int) -> None:
        self.first_ns = self._last_ns if self.first_ns is None else self.first_ns
        self.until_ns = now_ns


class Reception:
    """A subscription whose messages and losses are counted.

    It asks for `quality`. If a publisher offers only best effort, it accepts that, and says so.

    Args:
        node: the node.
        kind: of the messages.
        topic: their topic.
        callback: called with each message.
        quality: the quality of service that it asks for.
        raw: call back with the bytes of the messages.
    Attributes:
        count: number of messages that came.
        came: when the newest one did, by the node's clock [ns].
        latency: age of the newest one on arrival, by the node's clock [s]; None: none came, or they have no stamp.
    """

    def __init__(
        self, node: Node, kind: type, topic: str, callback: Callable[[Any], None], quality: QoSProfile, raw: bool = False
    ) -> None:
        self._node, self._kind, self._topic, self._callback, self._raw = node, kind, topic, callback, raw
        self._stamped = not raw and "header" in kind.get_fields_and_field_types()  # type: ignore[attr-defined]
        self.count = self.came = 0
        self.latency: float | None = None
        self.losses = Losses(quality)
        self._quality = quality
        self.subscription = self._subscribed()

    def drain(self) -> None:
        """Call back with the messages that have arrived and still wait, although the node is no longer spun."""
        for taken in waiting(self.subscription, self._raw):
            self._on_message(*taken)

    def _subscribed(self) -> Subscription:
        events = SubscriptionEventCallbacks(message_lost=self.losses.reported, incompatible_qos=self._on_incompatible)
        return self._node.create_subscription(
            self._kind, self._topic, self._on_message, self._quality, raw=self._raw, event_callbacks=events
        )

    def _on_message(self, msg: Any, info: dict[str, Any]) -> None:
        now = self.came = self._node.get_clock().now().nanoseconds
        self.count += 1
        if self._stamped:
            self.latency = (now - stamp_from_msg(msg.header.stamp)) / 1e9
        self._callback(msg)
        self.losses.count(info["publication_sequence_number"], self.subscription.get_publisher_count, now)

    def _on_incompatible(self, event: QoSRequestedIncompatibleQoSInfo) -> None:
        name = self.subscription.topic_name
        if event.last_policy_kind != QoSPolicyKind.RELIABILITY or not self.losses.promised:
            self._node.get_logger().error(
                f"{name} is not received: its publisher does not offer the {event.last_policy_kind.name.lower()} asked for"
            )
            return
        self._node.get_logger().warning(f"{name} is offered only with best effort: messages that are lost on the way stay lost")
        self._node.destroy_subscription(self.subscription)
        quality = self._quality
        self._quality = QoSProfile(
            depth=quality.depth, reliability=ReliabilityPolicy.BEST_EFFORT, durability=quality.durability
        )
        self.losses = Losses(self._quality)
        self.subscription = self._subscribed()


def waiting(subscription: Subscription, raw: bool = False) -> Iterator[tuple[Any, dict[str, Any]]]:
    """The messages that wait in a subscription's queue, or their bytes, each with what the middleware says of it."""
    with subscription.handle:
        for _ in range(subscription.qos_profile.depth):
            if (taken := subscription.handle.take_message(subscription.msg_type, raw)) is None:
                return
            yield taken


def waited(info: dict[str, Any]) -> float:
    """How long a message lay in its queue, by what the middleware says of it [s]."""
    received: int = info["received_timestamp"]
    return max((time.time_ns() - received) / 1e9, 0.0) if received else 0.0
