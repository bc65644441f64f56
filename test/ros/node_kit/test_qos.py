"""The qualities of service reach the middleware as they are defined."""

import pytest
from rclpy.qos import QoSCompatibility, qos_check_compatible

from pushfric_ros.messages import qos
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_DATA, SENSOR_QUEUE, profile


@pytest.mark.parametrize("reliability", qos.Reliability)
@pytest.mark.parametrize("durability", qos.Durability)
def test_a_profile_says_what_its_record_says(reliability, durability):
    made = profile(qos.Qos(7, reliability, durability))
    assert (made.depth, made.reliability.name.lower(), made.durability.name.lower()) == (7, reliability, durability)


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
