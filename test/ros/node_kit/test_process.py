"""A node's process ends in good order, whenever it is asked to."""

import signal
import subprocess
import sys

import pytest

PRELUDE = """
import ctypes, os, signal
import rclpy
from rclpy.node import Node
from pushfric_ros.node_kit import process

def ask_to_stop():
    os.kill(os.getpid(), signal.SIGTERM)

def make():
    print("made")
    return Node("node")
"""

BEFORE_ROS_IS_THERE = """
init = rclpy.init
rclpy.init = lambda: (ask_to_stop(), init())
process.run_node(make)
"""

WHILE_THE_NODE_IS_MADE = """
class Stopped(Node):
    def __init__(self):
        super().__init__("node")
        ask_to_stop()
        for number in range(100):  # until the signal has ended the context, or all are made
            self.create_guard_condition(lambda: None)

process.run_node(Stopped)
"""

BEFORE_IT_SPINS = """
process.run_node(lambda: (make(), ask_to_stop())[0])
"""


def run(program: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([sys.executable, "-c", PRELUDE + program], capture_output=True, text=True, timeout=60)


def test_a_signal_before_ros_is_there_leaves_the_node_unmade():
    ended = run(BEFORE_ROS_IS_THERE)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")


@pytest.mark.parametrize("program", [WHILE_THE_NODE_IS_MADE, BEFORE_IT_SPINS])
def test_a_signal_while_starting_ends_it_quietly(program):
    ended = run(program)
    assert (ended.returncode, ended.stderr) == (0, "")


HANGS = """
class Hanging(Node):
    def __init__(self):
        super().__init__("node")
        self.create_timer(0.01, ask_to_stop)

    def destroy_node(self):
        ctypes.PyDLL(None).sleep(60)  # and lets no other Python run

process.LAST_RESORT = 1
process.run_node(Hanging)
"""


def test_a_process_that_hangs_at_its_end_is_ended():
    assert run(HANGS).returncode == -signal.SIGALRM
