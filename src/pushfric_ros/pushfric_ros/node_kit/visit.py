"""A node in a process that is not its own, such as the command line."""

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Generic, TypeVar

import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.utilities import get_rmw_implementation_identifier

from pushfric_ros.node_kit.executor import NodeExecutor
from pushfric_ros.node_kit.network import configured


@contextlib.contextmanager
def held_back() -> Iterator[None]:
    """Let a SIGINT that comes within the block take effect at its end. Threads other than the main one get none anyway.

    A KeyboardInterrupt in the middle of the conversion of a message would be taken for a failure of the conversion.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    handler = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
    if came and callable(handler):
        handler(came[0], None)


COMMAND_LINE = "command_line"
"""Last part of the enclave of the commands that watch, stop and reset a running cell."""

AnyNode = TypeVar("AnyNode", bound=Node)

SERVING_NOTHING: dict[str, Any] = {
    "start_parameter_services": False,
    "parameter_overrides": [Parameter("start_type_description_service", value=False)],
}
"""Arguments of a node that only visits a cell: SROS 2 forbids services that its policy does not name."""


class Visit(contextlib.AbstractContextManager["Visit[AnyNode]"], Generic[AnyNode]):
    """A node in a context of its own, which takes no signals and is spun by hand.

    Args:
        make: makes the node; called with the keyword argument `context`.
        enclave: where SROS 2 finds the keys of this process, if it is switched on.
        images: see `network.configured`.
    """

    def __init__(self, make: Callable[..., AnyNode], enclave: str = "/", images: bool = False) -> None:
        self._context = rclpy.Context()
        try:
            with configured(images):
                rclpy.init(context=self._context, args=["--ros-args", "--enclave", enclave])
                self.node = make(context=self._context)
            self._executor = NodeExecutor(self._context)
            self._executor.add_node(self.node)
        except BaseException:
            rclpy.try_shutdown(context=self._context)
            raise

    def spin_once(self, seconds: float) -> None:
        """Let the node do what is due; wait at most this long [s] for something."""
        with held_back():
            self._executor.spin_once(timeout_sec=seconds)

    def spin_until(self, condition: Callable[[], object], seconds: float) -> bool:
        """Spin until a condition holds, but no longer than this [s]; returns whether it holds."""
        deadline = time.monotonic() + seconds
        while not (holds := bool(condition())) and time.monotonic() < deadline:
            self.spin_once(0.05)
        return holds

    def close(self) -> None:
        """Destroy the node and leave the graph."""
        self._executor.remove_node(self.node)
        self.node.destroy_node()
        self._executor.shutdown()
        rclpy.try_shutdown(context=self._context)

    def __exit__(self, *_: Any) -> None:
        self.close()


def enclave(namespace: str, name: str) -> str:
    """Where SROS 2 finds the keys and permissions of a node, if it is switched on."""
    return f"{namespace}/{name}"


def visit(name: str, namespace: str = "", images: bool = False) -> Visit[Node]:
    """A visit by a node with nothing of its own, which may take `images` if this is the first visit of its process."""
    return Visit(partial(Node, name, namespace=namespace), images=images)


def middleware() -> str:
    """Name of the RMW implementation in use."""
    return get_rmw_implementation_identifier()
