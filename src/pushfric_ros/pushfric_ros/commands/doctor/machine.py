"""The computer: ROS 2, Python packages, the build of pushfric_msgs, clock, disk, and whether messages reach other processes."""

import contextlib
import ctypes
import getpass
import os
import pathlib
import resource
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

from ament_index_python.packages import get_package_share_directory
from std_srvs.srv import Trigger

from pushfric_core.commands import dependencies
from pushfric_core.errors import InvalidInput
from pushfric_core.pushers.pusher import Check, Grade
from pushfric_ros.faults.processes import end
from pushfric_ros.messages.types import message_class
from pushfric_ros.node_kit.process import URGENT
from pushfric_ros.node_kit.visit import middleware, visit

TRIED_DISTROS, TRIED_RMW = ("jazzy", "kilted"), "rmw_fastrtps_cpp"

BAG_RATE = 10e3
"""Disk space that a recorded cell needs, without images [byte/s]."""

LEAST_SPACE, AMPLE_SPACE = 100e6, 1e9  # [byte]

TIME_ERROR = 5  # what adjtimex returns if nothing disciplines the clock (linux/timex.h)


def check_ros() -> Check:
    """Python, ROS 2 and its middleware."""
    distro, rmw = os.environ.get("ROS_DISTRO", ""), middleware()
    finding = f"Python {sys.version.split()[0]}, ROS 2 {distro or 'of unknown distribution'}, {rmw}"
    if distro not in TRIED_DISTROS or rmw != TRIED_RMW:
        advice = f"it may well work; {' and '.join(TRIED_DISTROS)} with RMW_IMPLEMENTATION={TRIED_RMW} were tested"
        return Check("ROS 2", Grade.WARNING, finding, advice)
    return Check("ROS 2", Grade.OK, finding)


def check_packages() -> Check:
    """The Python packages that pushfric needs."""
    wanted = dependencies.declared()
    if lacking := dependencies.unmet(wanted):
        finding = f"missing or too old: {', '.join(f'{requirement} ({found})' for requirement, found in lacking)}"
        return Check("packages", Grade.FAILED, finding, dependencies.advice(lacking))
    return Check("packages", Grade.OK, f"{len(wanted)} needed, all there")


def check_clock() -> Check:
    """Whether the system clock is later than this file and synchronised."""
    now, written = time.time(), pathlib.Path(__file__).stat().st_mtime
    said = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(now))
    if now < written:
        finding = f"{said}, which was before this program was installed"
        return Check("clock", Grade.FAILED, finding, "set it: sudo timedatectl set-ntp true")
    if clock_state() == TIME_ERROR:
        advice = "nothing to do for a cell on one computer; for more: sudo timedatectl set-ntp true, or chrony"
        return Check("clock", Grade.WARNING, f"{said}, but nothing synchronises it", advice)
    return Check("clock", Grade.OK, f"{said}, synchronised")


def check_priority() -> Check:
    """Whether the actuator may run before other processes of this computer."""
    least = 20 - resource.getrlimit(resource.RLIMIT_NICE)[0]
    if os.geteuid() == 0 or least <= URGENT:
        return Check("priority", Grade.OK, f"the actuator takes niceness {URGENT}")
    advice = f"add `{getpass.getuser()} - nice {URGENT}` to /etc/security/limits.conf, then log in again"
    return Check(
        "priority", Grade.WARNING, "the actuator may not run before other processes: a busy computer ends pushes", advice
    )


def clock_state() -> int:
    """The state of the kernel's clock, as adjtimex(2) returns it."""
    # a struct timex of zeros only asks; this is larger than the struct on any machine
    return int(ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(1024)))


def check_disk(folder: pathlib.Path) -> Check:
    """Whether there is space for bags in a folder, which need not exist yet."""
    there = next(parent for parent in (folder.resolve(), *folder.resolve().parents) if parent.exists())
    free = shutil.disk_usage(there).free
    finding = f"{free / 1e9:.1f} GB free at {there}, {free / BAG_RATE / 3600:.0f} hours of recording"
    if not os.access(there, os.W_OK):
        return Check("disk", Grade.FAILED, f"no permission to write to {there}", "record elsewhere, with --bag")
    if free < AMPLE_SPACE:
        level = Grade.FAILED if free < LEAST_SPACE else Grade.WARNING
        return Check("disk", level, finding, "make room, or record elsewhere, with --bag")
    return Check("disk", Grade.OK, finding)


INTERFACE_PARTS = {"msg": (), "srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}
PRIMITIVES = {"bool": "boolean", "float32": "float", "float64": "double", "byte": "octet", "char": "uint8"}
"""Names of types in interface files -> names that rosidl uses."""


def check_build() -> Check:
    """Whether the interfaces are built from their present source."""
    if stale := stale_interfaces(pathlib.Path(get_package_share_directory("pushfric_msgs"))):
        finding = f"older than the source, or not built: {', '.join(stale)}"
        return Check("build", Grade.FAILED, finding, "build the workspace again: ./pushfric setup, or colcon build")
    return Check("build", Grade.OK, "pushfric_msgs is built from its present source")


def stale_interfaces(share: pathlib.Path) -> list[str]:
    """Interfaces of pushfric_msgs that are not built, or whose fields differ from their source files.

    Args:
        share: where they are installed; links lead to the source.
    """
    stale = []
    for kind, parts in INTERFACE_PARTS.items():
        folders = {path.resolve().parent for path in (share / kind).glob(f"*.{kind}")}
        for source in sorted(source for folder in folders for source in folder.glob(f"*.{kind}")):
            wanted = [_fields(text) for text in source.read_text(encoding="utf-8").split("\n---\n")]
            try:
                built = message_class(f"pushfric_msgs/{kind}/{source.stem}")
            except InvalidInput:
                stale.append(source.name)
                continue
            classes: list[Any] = [getattr(built, part) for part in parts] or [built]
            if [made.get_fields_and_field_types() for made in classes] != wanted:
                stale.append(source.name)
    return stale


def _fields(text: str) -> dict[str, str]:
    """Names and types of the fields that an interface file defines, as rosidl calls them."""
    fields = {}
    for line in text.splitlines():
        words = line.partition("#")[0].split()
        if len(words) < 2 or "=" in "".join(words[1:]):  # blank, or a constant
            continue
        base, bracket, size = words[0].rstrip("]").partition("[")
        base = PRIMITIVES.get(base, f"pushfric_msgs/{base}" if base[0].isupper() else base)
        if size.isdecimal():
            base = f"{base}[{size}]"
        elif bracket:
            base = f"sequence<{base}{size.replace('<=', ', ')}>"
        fields[words[1]] = base
    return fields


CHECKS = (check_ros, check_packages, check_build, check_clock, check_priority)
"""Those that need no more."""

LAST_DOMAIN = 101
"""Higher ROS domains use ephemeral ports, which Linux may give to any program."""

ANSWER_TIMEOUT = 5.0
"""How long to wait for another process [s]."""

DDS_GROUP = "239.255.0.1"
"""Group and port at which DDS participants announce themselves (RTPS 2.5, 9.6.1.4)."""

CALL_AGAIN = 1.0
"""A call without an answer is repeated after this long [s]."""


def check_discovery() -> Check:
    """Whether a message reaches another process on this machine, and the answer comes back."""
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not text.isdecimal() or int(text) > LAST_DOMAIN:
        finding, advice = f"ROS_DOMAIN_ID is {text!r}", f"set it to a number from 0 to {LAST_DOMAIN}, the same in all terminals"
        return Check("discovery", Grade.FAILED, finding, advice)
    seconds = round_trip(ANSWER_TIMEOUT)
    where = f"on domain {int(text)}, discovery range {os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')}"
    if seconds is None:
        advice = "check ROS_AUTOMATIC_DISCOVERY_RANGE (not OFF) and firewall rules for UDP 7400 and up"
        return Check("discovery", Grade.FAILED, f"another process did not answer within {ANSWER_TIMEOUT:g} s {where}", advice)
    return Check("discovery", Grade.OK, f"another process answered after {seconds:.1f} s {where}")


def check_multicast() -> Check:
    """Whether multicast works, by which other machines are found."""
    if os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET") != "SUBNET":
        return Check("multicast", Grade.OK, "not needed: only this machine is looked for")
    if (fault := multicast(1.0)) is not None:
        advice = "other machines will not be found; for this one alone set discovery: localhost in the cell's file"
        return Check("multicast", Grade.WARNING, f"does not work: {fault}", advice)
    return Check("multicast", Grade.OK, "works")


def round_trip(patience: float) -> float | None:
    """Have a child process answer a call; return how long discovery and the call took [s], or None without an answer.

    Args:
        patience: how long to wait, not counting the start of the child [s].
    """
    name = f"pushfric_echo_{os.getpid()}"
    # doctor's first node, which decides whether it can take the camera's images later
    with visit(f"{name}_caller", images=True) as here, _echo(name):
        client = here.node.create_client(Trigger, f"{name}/answer")
        begin = time.monotonic()
        if not client.wait_for_service(timeout_sec=patience):
            return None
        while time.monotonic() - begin < 2 * patience:  # on a busy machine, the child may not know its caller yet
            if here.spin_until(client.call_async(Trigger.Request()).done, CALL_AGAIN):
                return time.monotonic() - begin
        return None


@contextlib.contextmanager
def _echo(name: str) -> Iterator[None]:
    """A child process that answers calls."""
    command = [sys.executable, "-m", "pushfric_ros.nodes.echo", "--ros-args", "-r", f"__node:={name}"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        try:
            assert child.stdout is not None
            child.stdout.readline()  # "ready"
            yield
        finally:
            end(child)


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
