"""Every node of the graph ends with exit code 0, however it is told to and however busy the machine is."""

import contextlib
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import time

import pytest
from calls import killed_at_the_end
from diagnostic_msgs.msg import DiagnosticArray

from pushfric_core.bags.bag import Bag
from pushfric_ros.commands.demo import demo_cell
from pushfric_ros.graph import graph
from pushfric_ros.graph.supervisor import command
from pushfric_ros.node_kit.qos import RELIABLE

PATIENCE = 240.0
"""How long the nodes may take to appear, and to end [s]; far more than they need."""


@pytest.fixture
def processes(tmp_path):
    started = {}
    with tempfile.TemporaryDirectory(prefix="pushfric-") as folder, contextlib.ExitStack() as leaving:
        for spec in graph.simulated_cell(demo_cell("rubber_rect4", tmp_path), str(tmp_path / "bag"), seed=0, speed=5.0):
            arguments = command(spec, graph.NAMESPACE, pathlib.Path(folder))
            with (tmp_path / spec.name).open("w") as output:
                process = killed_at_the_end(arguments, stdout=output, stderr=subprocess.STDOUT)
                started[spec.name] = leaving.enter_context(process)
        yield started


@pytest.fixture
def load():
    """Starts processes that keep every core busy that the tests may use."""
    with contextlib.ExitStack() as leaving:

        def start():
            for _ in range(2 * len(os.sched_getaffinity(0))):
                leaving.enter_context(killed_at_the_end([sys.executable, "-c", "while True: pass"]))

        yield start


def test_all_nodes_end_with_0_and_the_bag_is_whole(ros, processes, load, tmp_path):
    """Half of them by SIGTERM, as `ros2 launch` ends them at last; half by SIGINT, and a second one while they end."""
    up = set()
    seen = lambda msg: up.update(status.name.rpartition("/")[2] for status in msg.status)  # noqa: E731
    ros.node("peer").create_subscription(DiagnosticArray, "/diagnostics", seen, RELIABLE)
    ros.wait_for(lambda: up >= processes.keys(), PATIENCE, "a report of every node")
    load()
    signals = [(signal.SIGTERM,), (signal.SIGINT, signal.SIGINT)]
    for turn in range(2):  # at once, as a terminal does
        for number, process in enumerate(processes.values()):
            for one in signals[number % 2][turn : turn + 1]:
                process.send_signal(one)
        time.sleep(0.02)
    assert {name: process.wait(PATIENCE) for name, process in processes.items()} == dict.fromkeys(processes, 0)
    assert not [name for name in processes if "Traceback" in (tmp_path / name).read_text()]
    assert Bag(tmp_path / "bag").damage is None
    assert not (tmp_path / "pusher").is_symlink()
