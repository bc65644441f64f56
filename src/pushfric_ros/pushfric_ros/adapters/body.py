"""Tracked bodies in the messages of other systems, and the sources of a single topic.

PoseStamped comes from most motion capture drivers, visual trackers, and as the pose of an arm's tool; Odometry from mobile
robots, and trackers with a filter of their own; PoseArray from motion capture that publishes all its bodies in one message.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from pushfric_core.cell.mount import Body
from pushfric_core.settings import check_ranges, setting


class Source(Protocol):
    """Finds one body in the messages of some topics."""

    @property
    def topics(self) -> Mapping[str, tuple[str, str]]:
        """Name of each topic -> its type (package/msg/Type) and its quality of service, one of `messages.qos.QUALITIES`."""

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


class Single:
    """A source with a single topic.

    Args:
        topic: name of the topic.
        type_name: package/msg/Type.
        quality: one of `messages.qos.QUALITIES`.
        found: the body in a message.
    """

    def __init__(self, topic: str, type_name: str, quality: str, found: Any) -> None:
        self.topics = {topic: (type_name, quality)}
        self._found = found

    def body(self, topic: str, msg: Any) -> Body | None:
        """The body in a message."""
        found: Body | None = self._found(msg)
        return found


def chain(path: Sequence[Body]) -> Body:
    """The last of some bodies, each in the frame of the one before."""
    whole = path[0]
    for inner in path[1:]:
        whole = whole.before(inner)
    return whole


@dataclass(frozen=True)
class PoseStampedConfig:
    """A topic of poses."""

    topic: str = setting("pose", "name of the topic, geometry_msgs/PoseStamped")

    def open_source(self) -> Source:
        """The source."""
        return Single(
            self.topic,
            "geometry_msgs/msg/PoseStamped",
            "sensor_data",
            lambda msg: Body.of(msg.header.stamp, msg.pose.position, msg.pose.orientation),
        )


@dataclass(frozen=True)
class PoseArrayConfig:
    """A body among several on a topic."""

    topic: str = setting("poses", "name of the topic, geometry_msgs/PoseArray")
    index: int = setting(0, "place of the body in the array, from 0", 0, 10_000)

    def __post_init__(self) -> None:
        check_ranges(self)

    def open_source(self) -> Source:
        """The source."""
        return Single(self.topic, "geometry_msgs/msg/PoseArray", "sensor_data", self._found)

    def _found(self, msg: Any) -> Body | None:
        if self.index >= len(msg.poses):
            raise ValueError(f"a message has {len(msg.poses)} poses, none with the index {self.index}")
        pose = msg.poses[self.index]
        return Body.of(msg.header.stamp, pose.position, pose.orientation)


@dataclass(frozen=True)
class OdometryConfig:
    """A topic of odometry, whose pose is used."""

    topic: str = setting("odom", "name of the topic, nav_msgs/Odometry")

    def open_source(self) -> Source:
        """The source."""
        return Single(
            self.topic,
            "nav_msgs/msg/Odometry",
            "sensor_data",
            lambda msg: Body.of(msg.header.stamp, msg.pose.pose.position, msg.pose.pose.orientation),
        )


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
        self._parents: dict[str, tuple[str, Body]] = {}

    def body(self, topic: str, msg: Any) -> Body | None:
        """The frame after a message; None if the message does not move it, or the way to it is not known yet."""
        moved = set()
        for each in msg.transforms:
            parent, child = each.header.frame_id.lstrip("/"), each.child_frame_id.lstrip("/")
            body = Body.of(each.header.stamp, each.transform.translation, each.transform.rotation)
            if topic == FIXED:
                body = body._replace(stamp=0)
            self._parents[child] = parent, body
            moved.add(child)
        down, up = self._ancestry(self._frame), self._ancestry(self._reference)
        common = next((name for name in down if name in up), None)
        if common is None:
            return None
        below, above = down[: down.index(common)], up[: up.index(common)]
        if topic == FIXED or not moved & {*below, *above}:
            return None
        path = [self._parents[name][1].inverted() for name in above]
        path += [self._parents[name][1] for name in reversed(below)]
        return chain(path)

    def _ancestry(self, name: str) -> list[str]:
        """A frame, its parent, the parent of that, and so on."""
        names = [name]
        while names[-1] in self._parents:
            names.append(self._parents[names[-1]][0])
            if len(names) > DEEPEST:
                raise ValueError(f"the transforms above the frame {name!r} run in a circle")
        return names
