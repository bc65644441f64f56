"""Timers that go on when the computer's clock is set back, which would stop those of rclpy for as long."""

from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.timer import Timer


def wall_timer(node: Node, period: float, callback: Callable[[], Any], group: CallbackGroup | None = None) -> Timer:
    """A timer in real time, whatever the cell's clock; the period in [s]."""
    return node.create_timer(period, callback, group, Clock(clock_type=ClockType.STEADY_TIME))


def cell_timer(node: Node, period: float, callback: Callable[[], Any], group: CallbackGroup | None = None) -> Timer:
    """A timer by the cell's clock where that is simulated, else in real time; the period in [s]."""
    make = node.create_timer if node.get_parameter("use_sim_time").value else partial(wall_timer, node)
    return make(period, callback, group)
