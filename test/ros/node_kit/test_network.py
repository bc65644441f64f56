"""Who reaches a process, and its memory for images; in processes of their own, because Fast DDS reads its settings once."""

import json
import os
import shutil
import socket
import subprocess
import sys
from xml.etree import ElementTree

import pytest
from rclpy.utilities import get_rmw_implementation_identifier

from pushfric_core.cell.node_settings import Discovery
from pushfric_ros.node_kit.network import HERE, asked_for, configured
from pushfric_ros.node_kit.reach import FILE_VARIABLES, RANGE, VARIABLES

pytestmark = pytest.mark.skipif(
    not get_rmw_implementation_identifier().startswith("rmw_fastrtps"), reason="other middlewares have other settings"
)

SERVES = """
import json, os, socket, struct, sys, threading
import rclpy
from std_srvs.srv import Trigger
from pushfric_ros.node_kit.network import configured
with configured():
    rclpy.init()
    node = rclpy.create_node("served")
node.create_service(Trigger, "/asked", lambda _, response: response)
threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()
own = {os.readlink(f"/proc/self/fd/{name}") for name in os.listdir("/proc/self/fd") if os.path.exists(f"/proc/self/fd/{name}")}
lines = [line.split() for line in open("/proc/self/net/udp").readlines()[1:]]
bound = {words[1].split(":")[0] for words in lines if f"socket:[{words[9]}]" in own}
print(json.dumps(sorted(socket.inet_ntoa(struct.pack("=I", int(address, 16))) for address in bound)), flush=True)
sys.stdin.read()
os._exit(0)
"""


@pytest.fixture
def unset(monkeypatch):
    for name in (*VARIABLES, *FILE_VARIABLES, "FASTDDS_BUILTIN_TRANSPORTS", "RMW_IMPLEMENTATION"):
        monkeypatch.delenv(name, raising=False)


def changed(images: bool = False) -> dict[str, str]:
    """The variables that a process gets."""
    before = dict(os.environ)
    with configured(images):
        now = dict(os.environ)
    assert dict(os.environ) == before
    return {name: value for name, value in now.items() if before.get(name) != value}


@pytest.fixture
def served():
    """Starts a process that serves /asked; gives the addresses to which its sockets are bound."""
    processes = []

    def start(**variables: str) -> set[str]:
        process = subprocess.Popen(
            [sys.executable, "-c", SERVES], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=os.environ | variables
        )
        processes.append(process)
        return set(json.loads(process.stdout.readline()))

    yield start
    for process in processes:
        process.communicate(timeout=120)


@pytest.mark.parametrize("variables", [{}, {RANGE: "LOCALHOST"}, {RANGE: ""}, {"ROS_LOCALHOST_ONLY": "1"}])
def test_only_this_machine_reaches_a_process(unset, served, variables):
    """With ROS 2's own LOCALHOST, sockets were bound to every network, and a stranger's process was let in."""
    assert served(**variables) == {"127.0.0.1"}


@pytest.mark.parametrize("variables", [{RANGE: "SUBNET"}, {"ROS_STATIC_PEERS": "192.0.2.7"}])
def test_the_network_reaches_a_process_if_asked_for(unset, served, variables):
    assert "0.0.0.0" in served(**variables)


@pytest.mark.parametrize("range_", ["LOCALHOST", "SUBNET"])
def test_other_programs_of_this_machine_reach_it(unset, served, range_):
    """For example `ros2 topic echo` or RViz, which ROS 2 sets up in its usual way."""
    asks = """
import rclpy, sys
from std_srvs.srv import Trigger
rclpy.init()
node = rclpy.create_node("asks")
client = node.create_client(Trigger, "/asked")
answer = client.call_async(Trigger.Request()) if client.wait_for_service(timeout_sec=100) else sys.exit("nobody serves")
rclpy.spin_until_future_complete(node, answer, timeout_sec=100)
sys.exit(None if answer.done() else "no answer")
"""
    served()
    asked = subprocess.run([sys.executable, "-c", asks], env=os.environ | {RANGE: range_}, timeout=250, capture_output=True)
    assert (asked.returncode, asked.stderr) == (0, b"")


def test_processes_of_a_crowd_find_each_other(unset, served):
    """A planner may have fifty clients; Fast DDS looks for the first few participants of a machine."""
    crowd = """
import sys
import rclpy
from std_srvs.srv import Trigger
from pushfric_ros.node_kit.network import configured
with configured():
    nodes = []
    for number in range(40):
        context = rclpy.Context()
        context.init()
        nodes.append(rclpy.create_node(f"of_the_crowd_{number}", context=context, enable_rosout=False))
client = nodes[-1].create_client(Trigger, "/asked")
print(flush=True)
sys.exit(None if client.wait_for_service(timeout_sec=100) else "nobody serves")
"""
    with subprocess.Popen([sys.executable, "-c", crowd], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        process.stdout.readline()
        served()
        _, said = process.communicate(timeout=200)
    assert process.returncode == 0, said


def test_a_burst_of_messages_finds_room(unset):
    """200 requests of 100 pushes each are 1 MB at once. What finds a full buffer is lost, and sent again only after 3 s."""
    program = """
import contextlib, os, socket
import rclpy
from pushfric_ros.node_kit.network import configured
with configured():
    rclpy.init()
    node = rclpy.create_node("busy")
most = 0
for file in os.listdir("/proc/self/fd"):
    with contextlib.suppress(OSError), socket.socket(fileno=os.dup(int(file))) as found:
        if found.type == socket.SOCK_DGRAM:
            most = max(most, found.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF))
print(most, flush=True)
os._exit(0)
"""
    most = subprocess.run([sys.executable, "-c", program], timeout=100, capture_output=True, check=True).stdout
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plain:
        plain.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 * 2**20)
        assert int(most) == plain.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)  # as much as this kernel allows


APART = ["unshare", "--map-root-user", "--mount", "sh", "-c", 'mount -t tmpfs tmpfs /dev/shm && exec "$@"', "sh"]
"""Runs a program with shared memory of its own."""


@pytest.mark.skipif(
    not shutil.which("unshare") or subprocess.run([*APART, "true"], capture_output=True).returncode != 0,
    reason="no namespace of mounts of its own",
)
@pytest.mark.timeout(120)
@pytest.mark.parametrize("range_", ["LOCALHOST", "SUBNET"])
def test_what_the_middleware_says_is_not_among_a_programs_output(unset, range_):
    """Something holds what Fast DDS locks to take one of its ports, as do processes that start together."""
    program = """
import fcntl, sys
import rclpy
from pushfric_ros.node_kit.network import configured
print("its output")
held = [open(f"/dev/shm/fastrtps_port{number}_el", "w") for number in range(7000, 7020)]
for file in held:
    fcntl.flock(file, fcntl.LOCK_EX)
with configured(images=True):
    rclpy.init()
    node = rclpy.create_node("speaks")
sys.stdin.read()  # a thread of the middleware writes it, some time
"""
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    command = [*APART, sys.executable, "-c", program]
    with subprocess.Popen(command, env=os.environ | {RANGE: range_}, text=True, **pipes) as speaks:
        assert any("Failed init_port" in line for line in speaks.stderr)
        said, _ = speaks.communicate()
    assert (speaks.returncode, said) == (0, "its output\n")


def test_no_process_writes_elsewhere_what_the_middleware_says():
    where = {ElementTree.tostring(ElementTree.parse(file).find("{*}log")) for file in HERE.glob("*.xml")}
    assert len(where) == 1


@pytest.mark.parametrize("range_", ["LOCALHOST", "SUBNET"])
@pytest.mark.parametrize("images", [False, True])
def test_only_a_process_with_images_uses_shared_memory(unset, range_, images):
    program = f"""
import rclpy
from pushfric_ros.node_kit.network import configured
with configured(images={images}):
    rclpy.init()
    node = rclpy.create_node("uses")
print("/dev/shm/fastrtps_port" in open("/proc/self/maps").read())
"""
    uses = subprocess.run([sys.executable, "-c", program], env=os.environ | {RANGE: range_}, capture_output=True, text=True)
    assert (uses.returncode, uses.stdout) == (0, f"{images}\n")


def test_a_cell_asks_for_its_range_unless_the_user_does(unset, monkeypatch):
    assert asked_for(Discovery.SUBNET) == {RANGE: "SUBNET"}
    for name in VARIABLES:
        with monkeypatch.context() as patch:
            patch.setenv(name, "1")
            assert asked_for(Discovery.SUBNET) == {}


@pytest.mark.parametrize(("distro", "number"), [("jazzy", 0), ("kilted", 1)])
def test_fast_dds_is_told_by_the_variable_that_it_knows(unset, monkeypatch, distro, number):
    """Kilted warns about the other variable."""
    monkeypatch.setenv("ROS_DISTRO", distro)
    assert [name in changed() for name in FILE_VARIABLES] == [number == 0, number == 1]


@pytest.mark.parametrize(
    "name", ["FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS"]
)
def test_the_configuration_of_the_user_is_kept(unset, monkeypatch, name):
    monkeypatch.setenv(name, "UDPv4")
    assert changed(images=True) == {RANGE: "LOCALHOST"}
