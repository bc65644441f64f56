"""geometry_msgs/PoseStamped: most motion capture drivers, visual trackers, and the poses of an arm's tool."""

from dataclasses import dataclass

from pushfric_core.settings import setting
from pushfric_ros.adapters.body import Body, Single, Source


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
