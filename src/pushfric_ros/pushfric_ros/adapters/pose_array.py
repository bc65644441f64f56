"""geometry_msgs/PoseArray: motion capture that publishes all its rigid bodies in one message."""

from dataclasses import dataclass
from typing import Any

from pushfric_core.settings import check_ranges, setting
from pushfric_ros.adapters.body import Body, Single, Source


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
