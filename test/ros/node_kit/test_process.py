"""A node's process ends cleanly, whenever it is asked to."""

import os
import pathlib
import re
import signal
import subprocess
import sys
from contextlib import AbstractContextManager

import pytest
from calls import but_the_middleware, killed_at_the_end

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
rclpy.init = lambda **options: (ask_to_stop(), init(**options))
process.run_node(make)
"""

WHILE_THE_NODE_IS_MADE = """
class Stopped(Node):
    def __init__(self):
        ask_to_stop()
        ctypes.CDLL(None).usleep(200_000)  # time for the signal to end the context
        super().__init__("node")
        self.create_guard_condition(lambda: None)

process.run_node(Stopped)
"""

BEFORE_IT_SPINS = """
process.run_node(lambda: (make(), ask_to_stop())[0])
"""


def run(program: str, **variables: str) -> "subprocess.CompletedProcess[str]":
    command, environment = [sys.executable, "-c", PRELUDE + program], os.environ | variables
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
    ended.stderr = but_the_middleware(ended.stderr)
    return ended


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
        {hangs}

process.{limit} = 1.0
process.run_node(Hanging)
"""


@pytest.mark.parametrize(
    ("hangs", "limit", "number"),
    [
        ("while True: pass", "LAST_RESORT", signal.SIGPROF),
        ("ctypes.PyDLL(None).sleep(300)  # and lets no other Python run", "LAST_RESORT_IDLE", signal.SIGALRM),
    ],
)
def test_a_process_that_hangs_at_its_end_is_ended(hangs, limit, number):
    assert run(HANGS.format(hangs=hangs, limit=limit)).returncode == -number


HANGS_BEFORE_ITS_END = """
class Hanging(Node):
    def __init__(self):
        super().__init__("node")
        WHEN

    def hang(self):
        print("hangs", flush=True)
        HOW

process.HUNG = 2
process.run_node(Hanging)
"""


@pytest.mark.parametrize("when", ["self.hang()", "self.create_timer(1.5, self.hang)"])
@pytest.mark.parametrize("how", ["ctypes.PyDLL(None).sleep(600)", "while True: pass"])
def test_a_node_that_hangs_dies_whoever_started_it(how, when):
    """This holds while it is made, and for compiled code that lets no other Python run, too."""
    ended = run(HANGS_BEFORE_ITS_END.replace("HOW", how).replace("WHEN", when))
    assert (ended.returncode, ended.stdout) == (-signal.SIGALRM, "hangs\n")
    assert " in hang\n" in ended.stderr  # it says where


@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM"])
def test_a_signal_while_the_node_is_loading_ends_it_quietly(number):
    program = f"""
import os, signal, sys

class Interrupts:
    def find_spec(self, name, *_):
        if name == "pushfric_ros.nodes.recorder":
            os.kill(os.getpid(), signal.{number})

sys.meta_path.insert(0, Interrupts())
sys.argv = ["/somewhere/recorder_node"]
from pushfric_ros.node_kit.executable import main
main()
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")


TWIN = """
import sys
sys.argv[1:] = ["--ros-args", "-r", "__ns:=/twins", "-r", "__node:=NAME"]
process.run_node(make)
"""


def test_a_node_whose_name_is_taken_refuses_to_start_until_the_other_one_has_died():
    """However it died: the graph still shows a killed node when the next one starts."""
    program = [sys.executable, "-c", PRELUDE.replace('print("made")', 'print("made", flush=True)')]

    def started(name: str) -> AbstractContextManager[subprocess.Popen]:
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        return killed_at_the_end([*program[:2], program[2] + TWIN.replace("NAME", name)], **pipes)

    for _ in range(2):
        with started("one") as first, started("another") as other:
            assert [first.stdout.readline(), other.stdout.readline()] == ["made\n", "made\n"]
            with started("one") as second:
                said, error = second.communicate(timeout=120)
            assert (second.returncode, said) == (2, "")
            assert re.fullmatch(
                r"error: a node named /twins/one is already running on ROS domain \d+; end it, or .*\n",
                but_the_middleware(error),
            )
            assert first.poll() is None


LEAVES_NOTHING = """
import atexit, re, sys

class Leaving(Node):
    def __init__(self):
        super().__init__("node")
        self.create_timer(0.2, self.leave)

    def leave(self):
        names = set(re.findall("/dev/shm/fastrtps_[0-9a-f]{16}", open("/proc/self/maps").read()))
        print(*names)  # into a pipe: buffered until the end
        raise SystemExit(3)

atexit.register(print, "exit functions have run")
process.run_node(Leaving, images=True)
"""


def test_a_process_that_leaves_flushes_what_it_said_and_gives_back_its_shared_memory():
    ended = run(LEAVES_NOTHING, ROS_AUTOMATIC_DISCOVERY_RANGE="OFF")  # it would map what other processes have made, too
    assert (ended.returncode, ended.stderr) == (3, "")
    segments, last = ended.stdout.splitlines()
    assert last == "exit functions have run"
    assert segments.split()
    assert not [name for name in segments.split() if pathlib.Path(name).exists()]
