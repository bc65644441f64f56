"""The qualities of service of the cell's topics, as plain records; `node_kit.qos` turns them into rclpy's profiles.

A message is lost if it was published while a subscriber was there, and did not reach it. What a loss means follows from the
quality:

- RELIABLE: every message counts. The middleware sends a lost one again, and both sides keep as many as a run publishes while
  one of its nodes stands still. A loss is a fault: the run has failed.
- SENSOR_DATA, SENSOR_QUEUE: the publisher promises no more than to try. A loss is warned of and counted.
- NEWEST, LATCHED, LATCHED_QUEUE: the newest message replaces all earlier ones, and the publisher keeps no other. There are no
  losses.
"""

from dataclasses import dataclass
from enum import StrEnum

from pushfric_core.cell.node_settings import QUALITIES


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
    """The quality of service of a publisher or subscriber; the values are spelled as in rosbag2."""

    depth: int  # number of messages kept
    reliability: Reliability = Reliability.RELIABLE
    durability: Durability = Durability.VOLATILE


SENSOR_DATA = Qos(depth=10, reliability=Reliability.BEST_EFFORT)
"""For images and forces: the newest one matters more than all of them."""

SENSOR_QUEUE = Qos(depth=500, reliability=Reliability.BEST_EFFORT)
"""For our own subscribers to sensor data: deep, so that nothing is lost in a busy moment."""

RELIABLE = Qos(depth=2000)
"""For topics of which every message counts: at 200 messages a second, 10 s, after which a stopped node is ended."""

NEWEST = Qos(depth=1)
"""For heartbeats: an older one says nothing that the newest does not say, and is not sent again."""

NEWEST_OF_MANY = Qos(depth=100)
"""For a subscriber to the heartbeats of all nodes of a cell: with a depth of 1, a node's heartbeat would displace another's."""

LATCHED = Qos(depth=1, durability=Durability.TRANSIENT_LOCAL)
"""For topics whose last message a late subscriber gets at once."""

LATCHED_QUEUE = Qos(depth=500, durability=Durability.TRANSIENT_LOCAL)
"""For a subscriber to such a topic that needs every message, not just the last: deep, because they wait in a busy moment."""

REQUESTS = Qos(depth=500)
"""For services that many clients call at once: with rclpy's depth of 10, requests are lost in silence."""

NAMED = dict(zip(QUALITIES, (SENSOR_DATA, RELIABLE, LATCHED), strict=True))
"""The qualities that a publisher of the cell may have, by name."""
