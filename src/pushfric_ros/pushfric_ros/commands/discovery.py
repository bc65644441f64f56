"""Whether messages reach others: a service call to a child process and back, a datagram to a multicast group."""

import contextlib
import os
import socket
import subprocess
import sys
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from pushfric_ros.node_kit.process import run_node

DDS_GROUP = "239.255.0.1"
"""Where DDS participants announce themselves (RTPS 2.5, 9.6.1.4)."""


def round_trip(patience: float) -> float | None:
    """Have a child process answer a call; returns how long discovery and the call took [s], None without an answer.

    Args:
        patience: how long to wait, beside the start of the child [s].
    """
    name = f"pushfric_echo_{os.getpid()}"
    context = rclpy.Context()
    rclpy.init(context=context, args=[])
    node = Node(f"{name}_caller", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    child = subprocess.Popen([sys.executable, "-m", __name__, name], stdout=subprocess.PIPE, text=True)
    try:
        assert child.stdout is not None
        child.stdout.readline()  # "ready"
        client = node.create_client(Trigger, f"{name}/answer")
        begin = time.monotonic()
        if not client.wait_for_service(timeout_sec=patience):
            return None
        answer = client.call_async(Trigger.Request())
        executor.spin_until_future_complete(answer, timeout_sec=patience)
        return time.monotonic() - begin if answer.done() else None
    finally:
        child.terminate()
        try:
            child.communicate(timeout=patience)
        except subprocess.TimeoutExpired:
            child.kill()
            child.communicate()
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def multicast(patience: float) -> str | None:
    """Send a datagram to the group that DDS uses, and hear it; what is amiss, None if nothing.

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


class Answerer(Node):
    """The child: answers calls until SIGTERM."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.create_service(Trigger, "~/answer", lambda _, response: response)
        # rclpy can miss a signal that comes just before it waits; it looks again after this
        self.create_timer(0.1, lambda: None)
        print("ready", flush=True)


if __name__ == "__main__":
    run_node(lambda: Answerer(sys.argv[1]))
