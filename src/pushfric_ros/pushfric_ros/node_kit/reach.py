"""Whom nodes that start in this environment may reach, and whether that is nobody; this needs the standard library alone."""

import contextlib
import os
import pathlib

from pushfric_core.cell.node_settings import Discovery
from pushfric_ros.node_kit.lock import domain

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
VARIABLES = (RANGE, "ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY")
"""Environment variables of ROS 2 by which users say whom their nodes may reach; they override a cell's file."""

FILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Environment variables that name the file of profiles, before and since Fast DDS 3, which warns about the older one."""

FILES = ("DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml")
"""Files of profiles that Fast DDS takes from the working folder."""

FIRST_PORT, PORTS = 7400, 250
"""The UDP ports of a ROS domain (RTPS 2.5, 9.6.2.3): each node has one by which others find it."""

SHARED_MEMORY = pathlib.Path("/dev/shm")


def stays_on_this_machine() -> bool:
    """Whether the environment keeps the nodes' messages on this machine."""
    asked, peers, only = map(os.environ.get, VARIABLES)
    return only == "1" or (not peers and asked in (None, "", Discovery.LOCALHOST.name))


def configured_by_user() -> bool:
    """Whether the user has set Fast DDS up by variables or files of its own."""
    if any(name in os.environ for name in (*FILE_VARIABLES, "FASTDDS_BUILTIN_TRANSPORTS")):
        return True
    return any(pathlib.Path(name).exists() for name in FILES)


def nobody_is_there() -> bool:
    """Whether it is certain that no node would hear one that starts now: no process has a port of the ROS domain.

    The kernel answers at once, but it knows neither other machines nor other middlewares than DDS.

    Raises:
        InvalidInput: ROS_DOMAIN_ID is not a domain.
    """
    first = FIRST_PORT + PORTS * domain()
    known = os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps").startswith("rmw_fastrtps") and not configured_by_user()
    udp, udp6, locks = map(pathlib.Path, ("/proc/net/udp", "/proc/net/udp6", "/proc/locks"))
    if not known or not stays_on_this_machine() or not (udp.exists() and locks.exists()):
        return False
    lines = [line.split() for table in (udp, udp6) if table.exists() for line in table.read_text().splitlines()[1:]]
    taken = {int(line[1].rpartition(":")[2], 16) for line in lines}
    locked = {line.split()[5].rpartition(":")[2] for line in locks.read_text().splitlines()}
    for port in SHARED_MEMORY.glob("fastrtps_port*_el"):  # they outlast processes that were killed
        with contextlib.suppress(FileNotFoundError):  # it has just ended
            if str(port.stat().st_ino) in locked:
                taken.add(int(port.name[len("fastrtps_port") : -len("_el")]))
    return not taken & {*range(first, first + PORTS)}
