"""Opens a source of bodies, and subscribes to its topics."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from pushfric_core.cell.mount import MountConfig
from pushfric_core.errors import blaming
from pushfric_core.plugins import SOURCES, plugin
from pushfric_ros.adapters.body import Body, Source
from pushfric_ros.messages.types import message_class
from pushfric_ros.node_kit.diagnostics import Diagnostics
from pushfric_ros.node_kit.losses import waiting
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.qos import NAMED, deepened

QUEUE = 500
"""Number of messages that may wait in the queue."""


def source_of(node: Node, mount: MountConfig) -> Source:
    """The source that a node's parameters describe.

    Raises:
        InvalidInput: there is no such source, or its parameters are wrong.
    """
    with blaming(node.get_fully_qualified_name()):
        return declare(node, plugin(SOURCES, mount.source)).open_source()


class BodyListener:
    """Has a callback of a node called with every body that a source finds.

    Args:
        node: the node.
        topics: its diagnostics, which make its subscriptions.
        source: of the bodies.
        on_body: called with each body; a ValueError says that no use can be made of it.
        what: the node makes of a body, for the log.
    Attributes:
        problem: what is wrong with a message, until one is good again; empty: nothing.
    Raises:
        InvalidInput: a message type is not installed.
    """

    def __init__(self, node: Node, topics: Diagnostics, source: Source, on_body: Callable[[Body], None], what: str) -> None:
        self._log, self._source, self._on_body, self._what = node.get_logger(), source, on_body, what
        self.problem = ""
        for topic, kind, qos in _wanted(source):
            topics.subscribe(kind, topic, partial(self._take, topic), qos)

    def refuse(self, error: ValueError) -> None:
        """Log what is wrong with a message, once."""
        if not self.problem:
            self._log.error(f"no {self._what}: {error}")
        self.problem = str(error)

    def _take(self, topic: str, msg: Any) -> None:
        try:
            if (body := self._source.body(topic, msg)) is not None:
                self._on_body(body)
                self.problem = ""
        except ValueError as error:
            self.refuse(error)


def taken(node: Node, source: Source) -> Callable[[], Iterator[Body]]:
    """A function that returns every body that has come since it was last called; no executor needs to spin the node.

    Args:
        node: makes the subscriptions.
        source: of the bodies.
    Raises:
        InvalidInput: a message type is not installed.
        ValueError: from the function: a message is not valid.
    """
    made = {topic: node.create_subscription(kind, topic, lambda _: None, qos) for topic, kind, qos in _wanted(source)}

    def take() -> Iterator[Body]:
        for topic, subscription in made.items():
            for msg in messages(subscription):
                if (body := source.body(topic, msg)) is not None:
                    yield body

    return take


def messages(subscription: Subscription) -> Iterator[Any]:
    """All messages that wait in a subscription's queue."""
    return (msg for msg, _ in waiting(subscription))


def _wanted(source: Source) -> Iterator[tuple[str, type, QoSProfile]]:
    for topic, (type_name, quality) in source.topics.items():
        yield topic, message_class(type_name), deepened(NAMED[quality], QUEUE)
