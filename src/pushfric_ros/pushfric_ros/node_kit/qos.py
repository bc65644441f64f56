"""The qualities of service of the cell's topics.

A message is lost if it was published while a subscriber was there, and did not reach it. What a loss means follows from the
quality:

- RELIABLE: every message counts. The middleware sends a lost one again, and both sides keep as many as a run publishes while
  one of its nodes stands still. A loss is a fault: the run has failed.
- SENSOR_DATA, SENSOR_QUEUE: the publisher promises no more than to try. A loss is warned of and counted.
- NEWEST, LATCHED, LATCHED_QUEUE: the newest message replaces all earlier ones, and the publisher keeps no other. There are no
  losses.
"""

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from pushfric_core.cell.node_settings import QUALITIES

SENSOR_DATA = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
"""For images and forces: the newest one matters more than all of them."""

SENSOR_QUEUE = QoSProfile(depth=500, reliability=ReliabilityPolicy.BEST_EFFORT)
"""For our own subscribers to sensor data: deep, so that nothing is lost in a busy moment."""

RELIABLE = QoSProfile(depth=2000)
"""For topics of which every message counts: at 200 messages a second, 10 s, after which a stopped node is ended."""

NEWEST = QoSProfile(depth=1)
"""For heartbeats: an older one says nothing that the newest does not say, and is not sent again."""

NEWEST_OF_MANY = QoSProfile(depth=100)
"""For a subscriber to the heartbeats of all nodes of a cell: with a depth of 1, a node's heartbeat would displace another's."""

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""For topics whose last message a late subscriber gets at once."""

LATCHED_QUEUE = QoSProfile(depth=500, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""For a subscriber to such a topic that needs every message, not just the last: deep, because they wait in a busy moment."""

REQUESTS = QoSProfile(depth=500)
"""For services that many clients call at once: with rclpy's depth of 10, requests are lost in silence."""

NAMED = dict(zip(QUALITIES, (SENSOR_DATA, RELIABLE, LATCHED), strict=True))
"""The qualities that a publisher of the cell may have, by name."""


def deepened(quality: QoSProfile, depth: int) -> QoSProfile:
    """The same quality, with a queue of this many messages."""
    return QoSProfile(depth=depth, reliability=quality.reliability, durability=quality.durability)
