"""Timers that go on when the computer's clock is set back, which would stop those of rclpy for as long."""

from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.timer import Timer


def wall_timer(node: Node, period: float, callback: Callable[[], Any]) -> Timer:
    """A timer in real time, whatever the cell's clock; the period in [s]."""
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


def cell_timer(node: Node, period: float, callback: Callable[[], Any], group: CallbackGroup | None = None) -> Timer:
    """A timer by the cell's clock where that is simulated, else in real time; the period in [s]."""
    simulated = node.get_parameter("use_sim_time").value
    return node.create_timer(period, callback, group, None if simulated else Clock(clock_type=ClockType.STEADY_TIME))
