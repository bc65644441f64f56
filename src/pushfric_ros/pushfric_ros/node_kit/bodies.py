"""Subscribes to the topics of a source of bodies."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from pushfric_ros.adapters.body import Body, Source
from pushfric_ros.messages.qos import NAMED
from pushfric_ros.messages.types import message_class
from pushfric_ros.node_kit.diagnostics import Diagnostics
from pushfric_ros.node_kit.qos import profile

QUEUE = 500
"""Number of messages that may wait in the queue."""


def follow(
    topics: Diagnostics, source: Source, on_body: Callable[[Body], None], on_problem: Callable[[ValueError], None]
) -> None:
    """Have a callback called with every body that a source finds.

    Args:
        topics: the node's diagnostics, which make its subscriptions.
        source: of the bodies.
        on_body: called with each body.
        on_problem: called with what is wrong with a message.
    Raises:
        InvalidInput: a message type is not installed.
    """

    def take(topic: str, msg: Any) -> None:
        try:
            body = source.body(topic, msg)
        except ValueError as error:
            on_problem(error)
        else:
            if body is not None:
                on_body(body)

    for topic, (type_name, quality) in source.topics.items():
        qos = profile(replace(NAMED[quality], depth=QUEUE))
        topics.subscribe(message_class(type_name), topic, partial(take, topic), qos)
