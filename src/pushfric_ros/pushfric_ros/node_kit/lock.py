"""Locks for the cells of a ROS domain and for the nodes: a name that the kernel gives to a single process at a time.

The name is an abstract address of Unix sockets (unix(7)). It holds for all users and environments that share the loopback
interface, that is, exactly where nodes hear each other without a network between them. It needs no file. The name is free again
when the last process that holds its socket has ended, however it ended. `./pushfric` looks before there is an environment, so
this module needs the standard library alone.
"""

import contextlib
import errno
import hashlib
import os
import re
import socket
from collections.abc import Iterator

from pushfric_core.errors import InvalidInput

LAST_DOMAIN = 232
"""The largest ROS_DOMAIN_ID whose ports exist (RTPS 2.5, 9.6.2.3)."""


def domain() -> int:
    """The ROS domain that the environment names.

    Raises:
        InvalidInput: it is none.
    """
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not (text.isascii() and text.isdecimal() and len(text) < 10 and int(text) <= LAST_DOMAIN):
        raise InvalidInput(f"ROS_DOMAIN_ID must be a number from 0 to {LAST_DOMAIN}, got {text[:40]!r}")
    return int(text)


LONGEST = 90  # bytes of an address (unix(7) has room for 107), but for its beginning


def lock(namespace: str) -> contextlib.AbstractContextManager[int]:
    """Claim a cell's name on this machine's ROS domain.

    The context is a file descriptor. The claim ends once all processes that were given it have closed it or ended.

    Raises:
        InvalidInput: on entry, if another run holds the name (two would mistake each other's messages for their own), or
            ROS_DOMAIN_ID is not a domain.
    """
    still = "is already running on ROS domain {}, or its nodes have not ended yet; end it, or set another ROS_DOMAIN_ID"
    return _claim(namespace, f"a cell named {namespace} {still}")


def node_lock(name: str) -> contextlib.AbstractContextManager[int]:
    """Claim the full name of a node on this machine's ROS domain, as `lock` does for a cell.

    The graph would not do: for as long as its lease lasts, 20 s, it shows a node that has died.

    Raises:
        InvalidInput: on entry, if another node holds the name (both would answer its services).
    """
    return _claim(
        f"node {name}", f"a node named {name} is already running on ROS domain {{}}; end it, or give this one another name"
    )


def address(what: str) -> str:
    """The abstract address that stands for a thing on this machine's ROS domain.

    Raises:
        InvalidInput: ROS_DOMAIN_ID is not a domain.
    """
    text = f"{domain()} {what}"
    if len(text.encode()) > LONGEST:
        text = hashlib.sha256(text.encode()).hexdigest()
    return f"\0pushfric {text}"


def who_runs() -> str:
    """The cells that run on this machine, in words; not those with a name that is too long for an address."""
    with open("/proc/net/unix", encoding="utf-8", errors="replace") as table:
        found = sorted(set(re.findall(r"@pushfric (\d+) (/\S*)$", table.read(), re.MULTILINE)))
    if not found:
        return "no cell runs on this machine"
    return "running on this machine: " + ", ".join(f"{name} (ROS domain {number})" for number, name in found)


@contextlib.contextmanager
def _claim(what: str, refusal: str) -> Iterator[int]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as claim:
        try:
            claim.bind(address(what))
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            raise InvalidInput(refusal.format(domain())) from None
        yield claim.fileno()
