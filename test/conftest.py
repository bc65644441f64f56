"""Fixtures shared by all tests: the real middleware on a domain of its own, seeded randomness, and real pushes if present."""

import contextlib
import gc
import importlib
import os
import pathlib
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "examples")]  # what is in no package: `bench`, and the examples as they are called
REAL_PUSHES = ROOT.parent / "shared/data/zhou2015_triangle"
MIT_PUSHES = ROOT.parent / "shared/data/mit_push"


def own_domain() -> tuple[str, socket.socket]:
    """A ROS domain from 1 to 97 that no other process with tests on this machine has, and what claims it until this one ends.

    Domains above 101 collide with the ephemeral ports; 98 and 99 are those in which tests expect nobody.
    """
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    for number in range(97):
        domain = str(1 + (os.getpid() + number) % 97)
        with contextlib.suppress(OSError):
            claim.bind(f"\0pushfric-tests-{domain}")
            return domain, claim
    raise RuntimeError("other tests have claimed all ROS domains from 1 to 97")


# Set before rclpy is imported, so that the tests neither hear nor disturb another ROS 2 system or test run on this machine.
os.environ["ROS_DOMAIN_ID"], CLAIM = own_domain()
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["OPENBLAS_NUM_THREADS"] = "1"

# A shell starts background jobs with SIGINT ignored, and a child would inherit that: Ctrl-C is tested from there, too.
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--fuzz", type=float, default=0.0, metavar="MINUTES", help="give further mutated input to all parsers for this long"
    )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with whole runs and nodes, which mostly wait, are spread evenly among those that compute: all cores have work."""
    files = dict.fromkeys(item.path for item in items)
    waits = {path: {"system", "nodes"}.isdisjoint(path.parts) for path in files}
    halves = [
        sorted((path for path in files if waits[path] == half), key=lambda path: "system" not in path.parts)
        for half in (False, True)
    ]
    place = {path: number / len(half) for half in halves for number, path in enumerate(half)}
    items.sort(key=lambda item: place[item.path])


@pytest.fixture(autouse=True)
def own_state(tmp_path_factory, monkeypatch) -> None:
    """Keep an actuator's memory of its pusher within the test: neither another test nor the user's own cell finds it."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))


@pytest.fixture(autouse=True)
def own_interrupts() -> Iterator[None]:
    """Commands let SIGINT end their process at once; called in a test, they would leave that to the tests that follow."""
    handler, held = signal.getsignal(signal.SIGINT), signal.pthread_sigmask(signal.SIG_BLOCK, ())
    yield
    signal.signal(signal.SIGINT, handler)
    signal.pthread_sigmask(signal.SIG_SETMASK, held)


@pytest.fixture
def install(tmp_path, monkeypatch) -> Callable[..., None]:
    """A function that installs entry points and folders of modules as pip does, for this test and the processes it starts."""

    def installed(entry_points: str, *folders: pathlib.Path) -> None:
        info = tmp_path / "installed/from_outside-1.0.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: from_outside\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(entry_points)
        paths = [str(info.parent), *map(str, folders)]
        for path in paths:
            monkeypatch.syspath_prepend(path)
        monkeypatch.setenv("PYTHONPATH", os.pathsep.join((*paths, os.environ.get("PYTHONPATH", ""))))
        importlib.invalidate_caches()

    return installed


class Said(NamedTuple):
    """How a call of the command line ended, and what it printed."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def call(monkeypatch, capsys) -> Callable[..., Said]:
    """Calls the command line in this process, because a process of its own spends most of its time on imports."""
    from pushfric_core.commands import cli

    def called(*arguments: object) -> Said:
        monkeypatch.setattr(sys, "argv", ["pushfric", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        return Said(ended.value.code or 0, *capsys.readouterr())

    return called


@pytest.fixture(scope="session")
def script() -> ModuleType:
    """The set-up as a module."""
    return importlib.import_module("set_up")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.fixture
def real_pushes() -> pathlib.Path:
    """Folder of the public data set of real pushes (Zhou et al. 2015)."""
    if not REAL_PUSHES.is_dir():
        pytest.skip(f"the real pushes are not at {REAL_PUSHES}")
    return REAL_PUSHES


@pytest.fixture
def mit_pushes() -> pathlib.Path:
    """Folder of public sets of real pushes (Yu et al. 2016), with two of the original files."""
    if not MIT_PUSHES.is_dir():
        pytest.skip(f"the real pushes are not at {MIT_PUSHES}")
    return MIT_PUSHES


@pytest.fixture
def controller(tmp_path) -> Iterator[Any]:
    """A simulated GRBL controller whose port always appears at tmp_path / "port"."""
    from pushfric_core.simulated.grbl_firmware import SimulatedGrbl

    with SimulatedGrbl(time.monotonic) as controller:
        (tmp_path / "port").symlink_to(controller.port)
        yield controller


class Ros:
    """The rclpy nodes of one test, spun by one background thread."""

    def __init__(self) -> None:
        from pushfric_ros.node_kit.executor import NodeExecutor

        self._executor = NodeExecutor()
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

    def heard(self, node, kind, topic: str, qos) -> list:
        """A list that gets the messages of a topic."""
        messages: list = []
        node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def publisher(self, node, kind, topic: str, qos):
        """A publisher, once somebody subscribes to its topic."""
        out = node.create_publisher(kind, topic, qos)
        self.wait_for(out.get_subscription_count, what=f"a subscriber of {topic}")
        return out

    def result(self, future, what: str):
        """The result of a future, once it has one; `what` names it."""
        self.wait_for(future.done, what=what)
        return future.result()

    def call(self, node, kind, name: str, **fields):
        """The answer of a service to a request with these fields."""
        client = node.create_client(kind, name)
        self.wait_for(client.service_is_ready, what=name)
        return self.result(client.call_async(kind.Request(**fields)), f"the answer of {name}")

    def answer(self, ask: Callable[..., Any], *question: object, what: str):
        """The answer to what an action client or its goal asks; `what` names it.

        They are called in the thread that spins: rclpy loses an answer that comes before it has noted the question.
        """
        return self.result(self.result(self._executor.create_task(ask, *question), f"the question for {what}"), what)

    def end(self, node) -> None:
        """Stop spinning a node, once its present callbacks have ended, and destroy it."""
        self.take_out(node)
        node.destroy_node()

    def take_out(self, node) -> None:
        """Stop spinning a node, once its present callbacks have ended; the test destroys it."""
        self._nodes.remove(node)
        removed = self._executor.create_task(self._executor.remove_node, node)  # in the thread that spins it
        self.result(removed, "the end of the node's callbacks")

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
        for node in self._nodes:
            self._executor.remove_node(node)
            node.destroy_node()
        self._executor.shutdown()
        if self._failure is not None and not isinstance(self._failure, SystemExit):
            raise self._failure


@pytest.fixture(scope="session", autouse=True)
def _room_for_images() -> None:
    """Fast DDS reads a process's settings once, so the first node has those of a process whose nodes send and take images."""
    from pushfric_ros.node_kit.visit import visit

    visit("first", images=True).close()
    gc.collect()
    gc.freeze()  # the modules: for each of the tests, collections that look at them all take a tenth of a second


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
