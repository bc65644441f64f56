"""Whether messages reach other processes: a service call to a child process, and a datagram to a multicast group."""

import contextlib
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator

from std_srvs.srv import Trigger

from pushfric_core.pushers.pusher import Check, Grade
from pushfric_ros.node_kit.visit import visit

LAST_DOMAIN = 101
"""Higher ROS domains use ephemeral ports, which Linux may give to any program."""

ANSWER_TIMEOUT = 5.0
"""How long to wait for another process [s]."""

DDS_GROUP = "239.255.0.1"
"""Group and port at which DDS participants announce themselves (RTPS 2.5, 9.6.1.4)."""

CALL_AGAIN = 1.0
"""A call without an answer is repeated after this long [s]."""

LAST_WAIT = 5.0
"""How long to wait for the child to end [s]."""


def check_discovery() -> Check:
    """Whether a message reaches another process on this machine, and the answer comes back."""
    text = os.environ.get("ROS_DOMAIN_ID", "0")
    if not text.isdecimal() or int(text) > LAST_DOMAIN:
        finding, advice = f"ROS_DOMAIN_ID is {text!r}", f"set it to a number from 0 to {LAST_DOMAIN}, the same in all terminals"
        return Check("discovery", Grade.FAILED, finding, advice)
    seconds = round_trip(ANSWER_TIMEOUT)
    where = f"on domain {int(text)}, discovery range {os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')}"
    if seconds is None:
        advice = "check ROS_AUTOMATIC_DISCOVERY_RANGE (not OFF), firewall rules for UDP 7400 and up, and free space in /dev/shm"
        return Check("discovery", Grade.FAILED, f"another process did not answer within {ANSWER_TIMEOUT:g} s {where}", advice)
    return Check("discovery", Grade.OK, f"another process answered after {seconds:.1f} s {where}")


def check_multicast() -> Check:
    """Whether multicast works, by which other machines are found."""
    if os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET") != "SUBNET":
        return Check("multicast", Grade.OK, "not needed: only this machine is looked for")
    fault = multicast(1.0)
    if fault is not None:
        advice = "other machines will not be found; for this one alone set discovery: localhost in the cell's file"
        return Check("multicast", Grade.WARNING, f"does not work: {fault}", advice)
    return Check("multicast", Grade.OK, "works")


def round_trip(patience: float) -> float | None:
    """Have a child process answer a call; return how long discovery and the call took [s], or None without an answer.

    Args:
        patience: how long to wait, not counting the start of the child [s].
    """
    name = f"pushfric_echo_{os.getpid()}"
    with visit(f"{name}_caller") as here, _echo(name):
        client = here.node.create_client(Trigger, f"{name}/answer")
        begin = time.monotonic()
        if not client.wait_for_service(timeout_sec=patience):
            return None
        while time.monotonic() - begin < 2 * patience:  # on a busy machine, the child may not know its caller yet
            if here.spin_until(client.call_async(Trigger.Request()), CALL_AGAIN):
                return time.monotonic() - begin
        return None


@contextlib.contextmanager
def _echo(name: str) -> Iterator[None]:
    """A child process that answers calls."""
    child = subprocess.Popen([sys.executable, "-m", "pushfric_ros.nodes.echo", name], stdout=subprocess.PIPE, text=True)
    try:
        assert child.stdout is not None
        child.stdout.readline()  # "ready"
        yield
    finally:
        child.terminate()
        try:
            child.communicate(timeout=LAST_WAIT)
        except subprocess.TimeoutExpired:
            child.kill()
            child.communicate()


def multicast(patience: float) -> str | None:
    """Send a datagram to the group that DDS uses, and receive it; return what went wrong, or None.

    Args:
        patience: how long to wait [s].
    """
    try:
        with contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as heard:
            heard.bind(("", 0))
            group = socket.inet_aton(DDS_GROUP) + socket.inet_aton("0.0.0.0")
            heard.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
            heard.settimeout(patience)
            heard.sendto(b"pushfric", (DDS_GROUP, heard.getsockname()[1]))
            heard.recv(64)
    except OSError as error:
        return str(error)
    return None
