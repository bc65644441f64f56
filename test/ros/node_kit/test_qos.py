"""The qualities of service reach the middleware as they are defined."""

import pytest
from rclpy.qos import QoSCompatibility, qos_check_compatible

from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_DATA, SENSOR_QUEUE


@pytest.mark.parametrize(
    ("offered", "requested", "compatible"),
    [
        (SENSOR_DATA, SENSOR_QUEUE, True),
        (RELIABLE, SENSOR_QUEUE, True),
        (LATCHED, RELIABLE, True),
        (SENSOR_DATA, RELIABLE, False),
        (RELIABLE, LATCHED, False),
    ],
)
def test_compatibility_of_profiles(offered, requested, compatible):
    refused = qos_check_compatible(offered, requested)[0] == QoSCompatibility.ERROR
    assert refused != compatible
