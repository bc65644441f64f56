"""The clocks of timers: a step back of the computer's clock must stop none."""

import pathlib

import pytest
from rclpy.clock import ClockType
from rclpy.parameter import Parameter

import pushfric_ros
from pushfric_ros.node_kit.timers import cell_timer, wall_timer


@pytest.mark.parametrize(("simulated", "clock"), [(False, ClockType.STEADY_TIME), (True, ClockType.ROS_TIME)])
def test_only_a_simulated_clock_drives_timers(ros, simulated, clock):
    node = ros.node("timed", parameter_overrides=[Parameter("use_sim_time", value=simulated)])
    assert wall_timer(node, 1.0, lambda: None).clock.clock_type == ClockType.STEADY_TIME
    assert cell_timer(node, 1.0, lambda: None).clock.clock_type == clock


def test_no_node_makes_a_timer_on_the_computers_clock():
    sources = {path.name: path.read_text() for path in pathlib.Path(pushfric_ros.__file__).parent.rglob("*.py")}
    assert {name for name, text in sources.items() if "create_timer(" in text} == {"timers.py", "player.py"}
    assert sources["player.py"].count("create_timer(") == sources["player.py"].count("clock=self._wall)")
