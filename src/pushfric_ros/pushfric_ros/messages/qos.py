"""The qualities of service of the cell's topics."""

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

SENSOR_DATA = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Images and poses: the newest matters more than each."""

SENSOR_QUEUE = QoSProfile(depth=500, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Our subscribers to sensor data: deep, so that a busy moment loses nothing."""

RELIABLE = QoSProfile(depth=500, reliability=ReliabilityPolicy.RELIABLE)
"""Every message counts."""

LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""A late subscriber gets the last message at once."""
