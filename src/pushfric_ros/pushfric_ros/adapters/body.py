"""Tracked bodies in the messages of other systems.

PoseStamped comes from most motion capture drivers, visual trackers, and as the pose of an arm's tool.
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from pushfric_core.cell.mount import Body
from pushfric_core.settings import setting


class Source(Protocol):
    """Finds one body in the messages of some topics."""

    @property
    def topics(self) -> Mapping[str, tuple[str, str]]:
        """Name of each topic -> its type (package/msg/Type) and its quality of service, one of `node_settings.QUALITIES`."""

    def body(self, topic: str, msg: Any) -> Body | None:
        """The body in a message of a topic; None if it says nothing new about it.

        Raises:
            ValueError: the message is not valid.
        """


class SourceDriver(Protocol):
    """The settings of one kind of source: a frozen dataclass of `pushfric_core.settings.setting` fields.

    The class is an entry point of the group `pushfric.sources`; its name there is the setting `source` of MountConfig. Its
    settings stand next to those of MountConfig: no name may occur twice.
    """

    def open_source(self) -> Source:
        """The source."""


class Poses:
    """The body in a topic of geometry_msgs/PoseStamped.

    Args:
        topic: its name.
    """

    def __init__(self, topic: str) -> None:
        self.topics = {topic: ("geometry_msgs/msg/PoseStamped", "sensor_data")}

    def body(self, topic: str, msg: Any) -> Body | None:
        """The body in a message."""
        return Body.of(msg.header.stamp, msg.pose.position, msg.pose.orientation)


@dataclass(frozen=True)
class PoseStampedConfig:
    """A topic of poses."""

    topic: str = setting("pose", "name of the topic, geometry_msgs/PoseStamped")

    def open_source(self) -> Source:
        """The source."""
        return Poses(self.topic)


MOVING, FIXED = "/tf", "/tf_static"
TYPE = "tf2_msgs/msg/TFMessage"
DEEPEST = 100
"""Largest number of transforms between two frames; more mean that they run in a circle."""


@dataclass(frozen=True)
class TransformsConfig:
    """A frame of the tree of transforms."""

    frame: str = setting("tool0", "frame of the body, such as the last link of an arm or a tag")
    reference: str = setting("base_link", "frame in which the body is wanted, with its z axis up")

    def open_source(self) -> Source:
        """The source."""
        return Transforms(self.frame, self.reference)


class Transforms:
    """A frame seen from another one, whenever a transform between them moves.

    The newest transform of each pair of frames is used, even if their stamps differ. The body has the newest of these stamps.
    """

    def __init__(self, frame: str, reference: str) -> None:
        self.topics = {FIXED: (TYPE, "latched"), MOVING: (TYPE, "reliable")}
        self._frame, self._reference = frame, reference
        self._parents: dict[str, tuple[str, Any, bool]] = {}  # of each frame: its parent, its transform, whether it is fixed

    def body(self, topic: str, msg: Any) -> Body | None:
        """The frame after a message; None if the message does not move it, or the way to it is not known yet."""
        moved = set()
        for each in msg.transforms:
            parent, child = each.header.frame_id.lstrip("/"), each.child_frame_id.lstrip("/")
            self._parents[child] = parent, each, topic == FIXED
            moved.add(child)
        down, up = self._ancestry(self._frame), self._ancestry(self._reference)
        common = next((name for name in down if name in up), None)
        if common is None:
            return None
        below, above = down[: down.index(common)], up[: up.index(common)]
        if topic == FIXED or not moved & {*below, *above}:
            return None
        path = [self._place(name).inverted() for name in above]
        path += [self._place(name) for name in reversed(below)]
        return functools.reduce(Body.before, path)  # each is in the frame of the one before

    def _place(self, name: str) -> Body:
        """A frame in its parent."""
        _, each, fixed = self._parents[name]
        body = Body.of(each.header.stamp, each.transform.translation, each.transform.rotation)
        return body._replace(stamp=0) if fixed else body

    def _ancestry(self, name: str) -> list[str]:
        """A frame, its parent, the parent of that, and so on."""
        names = [name]
        while names[-1] in self._parents:
            names.append(self._parents[names[-1]][0])
            if len(names) > DEEPEST:
                raise ValueError(f"the transforms above the frame {name!r} run in a circle")
        return names
