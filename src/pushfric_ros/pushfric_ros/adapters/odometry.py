"""nav_msgs/Odometry: mobile robots, and trackers with a filter of their own."""

from dataclasses import dataclass

from pushfric_core.settings import setting
from pushfric_ros.adapters.body import Body, Single, Source


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
