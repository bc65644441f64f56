"""Fixtures shared by all tests: the real middleware on a domain of its own, seeded randomness, and real pushes if present."""

import contextlib
import gc
import os
import pathlib
import signal
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
REAL_PUSHES = ROOT.parent / "shared/data/zhou2015_triangle"

# Set before rclpy is imported, so that the tests neither hear nor disturb another ROS 2 system or test run on this machine.
# Domains above 101 collide with the ephemeral ports.
os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["OPENBLAS_NUM_THREADS"] = "1"

# A shell starts background jobs with SIGINT ignored, and a child would inherit that: Ctrl-C is tested from there, too.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def own_state(tmp_path_factory, monkeypatch) -> None:
    """Keep an actuator's memory of its pusher within the test: neither another test nor the user's own cell finds it."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.fixture
def real_pushes() -> pathlib.Path:
    """Folder of the public data set of real pushes (Zhou et al. 2015)."""
    if not REAL_PUSHES.is_dir():
        pytest.skip(f"the real pushes are not at {REAL_PUSHES}")
    return REAL_PUSHES


class Ros:
    """The rclpy nodes of one test, spun by one background thread."""

    def __init__(self) -> None:
        from rclpy.executors import SingleThreadedExecutor

        self._executor = SingleThreadedExecutor()
        self._nodes: list = []
        self._thread = threading.Thread(target=self._spin, name="ros")
        self._stopping = False
        self._failure: BaseException | None = None
        self._thread.start()

    def _spin(self) -> None:
        try:
            while not self._stopping:
                self._executor.spin_once(timeout_sec=0.05)
        except BaseException as error:  # noqa: BLE001 - handed to the test's own thread
            self._failure = error

    def compose(self, *nodes):
        """Make nodes and spin them until the test ends."""
        for node in nodes:
            self._nodes.append(node)
            self._executor.add_node(node)
        return nodes[0] if len(nodes) == 1 else nodes

    def node(self, name: str, **kwargs):
        """A plain node, already spinning."""
        from rclpy.node import Node

        return self.compose(Node(name, **kwargs))

    def take_out(self, node) -> None:
        """Stop spinning a node; the test destroys it."""
        self._executor.remove_node(node)
        self._nodes.remove(node)

    def wait_for(self, predicate: Callable[[], object], timeout: float = 60.0, what: str = "the awaited event") -> None:
        """Wait until `predicate` holds. Fail, naming `what`, after `timeout` [s], or at once if a callback raised."""
        deadline = time.monotonic() + timeout
        while not predicate():
            if self._failure is not None:
                raise self._failure
            assert time.monotonic() < deadline, f"{what} did not happen within {timeout} s"
            time.sleep(0.005)

    def close(self) -> None:
        self._stopping = True
        self._executor.wake()
        self._thread.join()
        self._executor.shutdown()
        for node in self._nodes:
            node.destroy_node()
        if self._failure is not None and not isinstance(self._failure, SystemExit):
            raise self._failure


@pytest.fixture
def ros() -> Iterator[Ros]:
    import rclpy

    from pushfric_ros.node_kit.network import configured

    gc.collect()  # nodes of earlier tests live on in reference cycles, and would be taken for nodes of this one
    with contextlib.ExitStack() as stack:
        with configured():
            rclpy.init()
            stack.callback(rclpy.try_shutdown)
            stack.callback(rclpy.create_node("test").destroy_node)  # with it is made what all nodes of a process share
        ros = Ros()
        stack.callback(ros.close)
        yield ros
