"""One run at a time for each cell of a ROS domain: a name that the kernel gives to one process at a time.

The name is an abstract address of Unix sockets (unix(7)). It holds for all users and environments that share the loopback
interface, that is, exactly where nodes hear each other without a network between them. It needs no file. The name is free again
when the last process that holds its socket has ended, however it ended. `./pushfric` looks before there is an environment, so
this module needs the standard library alone.
"""

import contextlib
import errno
import hashlib
import socket
from collections.abc import Iterator

from pushfric_core.errors import InvalidInput
from pushfric_ros.node_kit.domain import domain


@contextlib.contextmanager
def lock(namespace: str) -> Iterator[int]:
    """Claim a cell's name on this machine's ROS domain.

    Yields:
        A file descriptor. The claim ends once all processes that were given it have closed it or ended.
    Raises:
        InvalidInput: another run holds the name (two would mistake each other's messages for their own), or ROS_DOMAIN_ID is
            not a domain.
    """
    number = domain()
    digest = hashlib.sha256(f"{number} {namespace}".encode()).hexdigest()  # an address is short
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as claim:
        try:
            claim.bind(f"\0pushfric-{digest}")
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            raise InvalidInput(
                f"a cell named {namespace} is already running on ROS domain {number}, or its nodes have not ended yet; "
                "end it, or set another ROS_DOMAIN_ID"
            ) from None
        yield claim.fileno()
