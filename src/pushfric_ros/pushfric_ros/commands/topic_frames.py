"""The frames of a topic, for a camera whose driver is a node."""

import os
import time
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

from pushfric_core.cell.node_settings import Discovery
from pushfric_core.errors import InvalidInput
from pushfric_core.vision.camera import Image
from pushfric_core.vision.frame_source import TOPICS
from pushfric_core.vision.image_messages import image_from_msg
from pushfric_ros.node_kit import network
from pushfric_ros.node_kit.visit import Visit, visit
from pushfric_ros.nodes.tracker import IMAGE_QUEUE, MESSAGES

FRAME_TIMEOUT = 10.0
"""How long to wait for the next frame of a topic [s]."""


class TopicFrames:
    """The frames of a topic; see Frames.

    Args:
        source: one of `TOPICS`.
        namespace: of the cell.
        discovery: where the nodes of the cell look for each other; None: as the environment says.
    """

    pictures, live = False, True
    names: Sequence[str] = ()

    def __init__(self, source: str, namespace: str, discovery: Discovery | None) -> None:
        if discovery is not None:
            os.environ.update(network.asked_for(discovery))
        self.name = f"{namespace.rstrip('/')}/{TOPICS[source]}"
        self._source, self._namespace = source, namespace
        self._frames: deque[Image] = deque()
        self._problem: str | None = None
        self._since = 0  # frames that arrived earlier are left out [ns]
        self._here: Visit[Any] | None = None

    def __enter__(self) -> "TopicFrames":
        self._here = visit("frames", self._namespace, images=True)
        self._here.node.create_subscription(MESSAGES[self._source], TOPICS[self._source], self._take, IMAGE_QUEUE)
        return self

    def __exit__(self, *_: object) -> None:
        assert self._here is not None
        self._here.close()

    def __iter__(self) -> Iterator[Image]:
        """The frames as they come.

        Raises:
            InvalidInput: no frame comes, or a frame is not a picture.
        """
        assert self._here is not None
        deadline = time.monotonic() + FRAME_TIMEOUT
        while time.monotonic() < deadline:
            self._here.spin_once(0.1)
            if self._problem is not None:
                raise InvalidInput(f"{self.name}: {self._problem}")
            if self._frames:
                yield self._frames.popleft()
                deadline = time.monotonic() + FRAME_TIMEOUT
        raise InvalidInput(f"no frames from {self.name}: does its driver run, in this namespace?")

    def forget(self) -> None:
        """See Frames."""
        self._since = time.time_ns()
        self._frames.clear()

    def _take(self, msg: Any, info: dict[str, Any]) -> None:
        if info["received_timestamp"] < self._since:  # it has waited in the middleware's queue
            return
        try:
            self._frames.append(image_from_msg(msg))
        except ValueError as error:
            self._problem = str(error)
