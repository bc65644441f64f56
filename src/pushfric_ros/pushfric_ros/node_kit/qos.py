"""The qualities of service of `messages.qos` as rclpy profiles."""

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from pushfric_core.bags.offered_qos import INFINITE_NS, OfferedQos
from pushfric_ros.messages import qos


def profile(quality: qos.Qos) -> QoSProfile:
    """A quality of service as an rclpy profile."""
    return QoSProfile(
        depth=quality.depth,
        reliability=ReliabilityPolicy[quality.reliability.name],
        durability=DurabilityPolicy[quality.durability.name],
    )


def offered(found: QoSProfile) -> OfferedQos:
    """The offer of a publisher, as a record for a bag."""

    # for "no limit", a profile made in a program has 0, and one discovered on the network has infinity
    return OfferedQos.of_policies(found, lambda duration: duration.nanoseconds or INFINITE_NS)


SENSOR_DATA = profile(qos.SENSOR_DATA)
SENSOR_QUEUE = profile(qos.SENSOR_QUEUE)
RELIABLE = profile(qos.RELIABLE)
NEWEST = profile(qos.NEWEST)
NEWEST_OF_MANY = profile(qos.NEWEST_OF_MANY)
LATCHED = profile(qos.LATCHED)
LATCHED_QUEUE = profile(qos.LATCHED_QUEUE)
REQUESTS = profile(qos.REQUESTS)
