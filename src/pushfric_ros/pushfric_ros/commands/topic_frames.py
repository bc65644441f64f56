"""The frames of a topic, for a camera whose driver is a node."""

import os
import time
from collections.abc import Iterator
from typing import Any, Self

from pushfric_core.bags.samples import stamp_from_msg
from pushfric_core.cell.node_settings import Discovery
from pushfric_core.errors import InvalidInput
from pushfric_core.vision.camera import Image
from pushfric_core.vision.frame_source import TOPICS, Frame, Frames
from pushfric_core.vision.image_messages import image_from_msg
from pushfric_ros.node_kit import network
from pushfric_ros.node_kit.bodies import messages
from pushfric_ros.node_kit.losses import Reception
from pushfric_ros.node_kit.visit import Visit, visit
from pushfric_ros.nodes.tracker import IMAGE_QUEUE, MESSAGES


class TopicFrames(Frames):
    """The frames of a topic.

    Args:
        source: one of `TOPICS`.
        namespace: of the cell.
        discovery: where the nodes of the cell look for each other; None: as the environment says.
    """

    patience = 10.0

    def __init__(self, source: str, namespace: str, discovery: Discovery | None) -> None:
        if discovery is not None:
            os.environ.update(network.asked_for(discovery))
        super().__init__(f"{namespace.rstrip('/')}/{TOPICS[source]}", pictures=False, live=True)
        self._source, self._namespace = source, namespace
        self._problem = ""

    def __enter__(self) -> Self:
        self._here: Visit[Any] = visit("frames", self._namespace, images=True)
        self._received = Reception(self._here.node, MESSAGES[self._source], TOPICS[self._source], self._take, IMAGE_QUEUE)
        return self

    def __exit__(self, *_: object) -> None:
        self.lost, self.publishers = self._received.losses.messages, self._received.subscription.get_publisher_count()
        self._here.close()

    def __iter__(self) -> Iterator[Image]:
        """The frames as they come.

        Raises:
            InvalidInput: no frame comes, or a frame is not a picture.
        """
        yield from super().__iter__()
        raise InvalidInput(f"no frames from {self.name}: does its driver run, in this namespace?")

    def wait(self, seconds: float) -> bool:
        """See Frames. Raises InvalidInput if a frame is not a picture."""
        came = self._here.spin_until(lambda: self.waiting or self._problem, seconds)
        if self._problem:
            raise InvalidInput(f"{self.name}: {self._problem}")
        return came

    def forget(self) -> None:
        super().forget()
        for _ in messages(self._received.subscription):
            pass  # they have waited in the middleware's queue

    def _take(self, msg: Any) -> None:
        arrival = time.time_ns()
        try:
            self.waiting.append(Frame(stamp_from_msg(msg.header.stamp), arrival, image_from_msg(msg)))
        except ValueError as error:
            self._problem = str(error)
