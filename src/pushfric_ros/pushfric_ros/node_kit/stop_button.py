"""A stop that needs no middleware: the actuator of a cell listens at an abstract address of Unix sockets (unix(7)).

A command that stops the pusher must not wait until a node has found the graph. The address holds on this machine and for all
its users, as the lock of the cell does. `./pushfric` presses the button before anything is loaded, so this module needs the
standard library alone.
"""

import contextlib
import socket

from pushfric_core.cell.node_settings import NAMESPACE
from pushfric_core.errors import PushfricError
from pushfric_ros.node_kit.lock import address, who_runs
from pushfric_ros.node_kit.reach import nobody_is_there

ANSWER_TIMEOUT = 0.5
"""An actuator that does not answer within this time [s] is stopped by way of the graph."""

LONGEST = 200  # characters of an answer


class StopButton:
    """The button of one cell. A node that is made, and never looks at it, takes nobody's button.

    Args:
        namespace: of the cell.
    """

    def __init__(self, namespace: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._address = _address(namespace)

    def pressed(self) -> str | bytes | None:
        """Who has pressed it since the last call; None: nobody. Raises OSError if somebody else listens there."""
        if not self._socket.getsockname():
            self._socket.bind(self._address)
        with contextlib.suppress(BlockingIOError):
            return self._socket.recvfrom(1)[1] or b""
        return None

    def answer(self, who: str | bytes, text: str) -> None:
        """Tell whoever pressed it what happened."""
        with contextlib.suppress(OSError):  # they may have gone
            self._socket.sendto(text.encode()[:LONGEST], who)

    def close(self) -> None:
        """Listen no more."""
        self._socket.close()


class Unheard(PushfricError):
    """Nobody can hear a stop."""


def press(namespace: str) -> str | None:
    """Press the button of a cell on this machine; return what its actuator answers, or None if nobody answers in time.

    Raises:
        InvalidInput: ROS_DOMAIN_ID is not a domain.
        Unheard: no node of any kind is there that could hear a stop in another way.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as button:
        button.bind("")  # the kernel chooses an address for the answer
        button.settimeout(ANSWER_TIMEOUT)
        try:
            button.sendto(b"!", _address(namespace))
            return button.recv(LONGEST).decode(errors="replace")
        except OSError:
            if nobody_is_there():
                raise Unheard(f"nobody listens to /{namespace.strip('/')}/stop; {who_runs()}") from None
            return None


def press_as_asked(arguments: list[str]) -> str | None:
    """Press the button that the arguments of the command `stop` name; None if nobody answers, or if they are not so simple.

    Raises:
        InvalidInput, Unheard: as `press`.
    """
    match arguments:
        case []:
            return press(NAMESPACE)
        case ["--namespace", namespace]:
            return press(namespace)
    return None


def _address(namespace: str) -> str:
    return address(f"stop /{namespace.strip('/')}")
