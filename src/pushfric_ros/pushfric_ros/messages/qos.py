"""The qualities of service of the cell's topics, as plain records; `node_kit.qos` turns them into rclpy's profiles."""

from dataclasses import dataclass
from enum import StrEnum


class Reliability(StrEnum):
    """Whether a lost message is sent again."""

    RELIABLE = "reliable"
    BEST_EFFORT = "best_effort"


class Durability(StrEnum):
    """Whether a late subscriber gets what was published before it came."""

    VOLATILE = "volatile"
    TRANSIENT_LOCAL = "transient_local"


@dataclass(frozen=True)
class Qos:
    """What a publisher offers or a subscriber requests; the values are spelled as rosbag2 spells them."""

    depth: int  # messages kept
    reliability: Reliability = Reliability.RELIABLE
    durability: Durability = Durability.VOLATILE


SENSOR_DATA = Qos(depth=10, reliability=Reliability.BEST_EFFORT)
"""Images and poses: the newest matters more than each."""

SENSOR_QUEUE = Qos(depth=500, reliability=Reliability.BEST_EFFORT)
"""Our subscribers to sensor data: deep, so that a busy moment loses nothing."""

RELIABLE = Qos(depth=500)
"""Every message counts."""

LATCHED = Qos(depth=1, durability=Durability.TRANSIENT_LOCAL)
"""A late subscriber gets the last message at once."""

QUALITIES = {"sensor_data": SENSOR_DATA, "reliable": RELIABLE, "latched": LATCHED}
"""Those a publisher of the cell may have, as settings name them."""
