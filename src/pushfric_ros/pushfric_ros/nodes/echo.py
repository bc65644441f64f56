"""The echo node: answers calls, so that the doctor can see whether messages reach another process."""

from typing import Any

from rclpy.node import Node
from std_srvs.srv import Trigger

from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.timers import wall_timer


class EchoNode(Node):
    """Serves ~/answer until it is asked to stop; prints a line once it does."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("echo", **kwargs)
        self.create_service(Trigger, "~/answer", lambda _, response: response)
        # rclpy can miss a signal that comes just before it waits; it looks again after this
        wall_timer(self, 0.1, lambda: None)
        print("ready", flush=True)


if __name__ == "__main__":
    run_node(EchoNode)
