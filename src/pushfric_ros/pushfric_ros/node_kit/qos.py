"""The qualities of service of `messages.qos` as rclpy profiles."""

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from pushfric_ros.messages import qos


def profile(quality: qos.Qos) -> QoSProfile:
    """A quality of service as rclpy takes it."""
    return QoSProfile(
        depth=quality.depth,
        reliability=ReliabilityPolicy[quality.reliability.name],
        durability=DurabilityPolicy[quality.durability.name],
    )


SENSOR_DATA = profile(qos.SENSOR_DATA)
SENSOR_QUEUE = profile(qos.SENSOR_QUEUE)
RELIABLE = profile(qos.RELIABLE)
LATCHED = profile(qos.LATCHED)
