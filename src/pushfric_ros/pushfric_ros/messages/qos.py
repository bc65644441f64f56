"""The qualities of service of the cell's topics, as plain records; `node_kit.qos` turns them into rclpy's profiles."""

from dataclasses import dataclass
from enum import StrEnum


class Reliability(StrEnum):
    """Whether a lost message is sent again."""

    RELIABLE = "reliable"
    BEST_EFFORT = "best_effort"


class Durability(StrEnum):
    """Whether a late subscriber gets messages that were published before it came."""

    VOLATILE = "volatile"
    TRANSIENT_LOCAL = "transient_local"


@dataclass(frozen=True)
class Qos:
    """What a publisher offers or a subscriber requests; the values are spelled as in rosbag2."""

    depth: int  # number of messages kept
    reliability: Reliability = Reliability.RELIABLE
    durability: Durability = Durability.VOLATILE


SENSOR_DATA = Qos(depth=10, reliability=Reliability.BEST_EFFORT)
"""For images and poses: the newest one matters more than all of them."""

SENSOR_QUEUE = Qos(depth=500, reliability=Reliability.BEST_EFFORT)
"""For our own subscribers to sensor data: deep, so that nothing is lost in a busy moment."""

RELIABLE = Qos(depth=500)
"""For topics of which every message counts."""

LATCHED = Qos(depth=1, durability=Durability.TRANSIENT_LOCAL)
"""For topics whose last message a late subscriber gets at once."""

LATCHED_QUEUE = Qos(depth=500, durability=Durability.TRANSIENT_LOCAL)
"""For a subscriber to such a topic that needs every message, not just the last: deep, because they wait in a busy moment."""

QUALITIES = {"sensor_data": SENSOR_DATA, "reliable": RELIABLE, "latched": LATCHED}
"""The qualities that a publisher of the cell may have, as settings name them."""
