"""The computer: ROS 2, the Python packages, the clock and the disk."""

import ctypes
import getpass
import os
import pathlib
import resource
import shutil
import sys
import time

from pushfric_core.commands import dependencies
from pushfric_core.pushers.check import Check, Grade
from pushfric_ros.node_kit.process import URGENT
from pushfric_ros.node_kit.visit import middleware

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
