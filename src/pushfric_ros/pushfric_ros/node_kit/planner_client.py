"""A client of a planner node that loses no answer, however many others ask.

ROS 2 sends each answer of a service to all its clients, which drop those to others. So an answer is lost if more of them come
at once than a client's queue holds, and all clients have work with all answers. A planner offers a service to each client
that asks for one: a name of its own below that of the service.
"""

import uuid
from typing import Any

from rclpy.client import Client
from rclpy.node import Node

from pushfric_msgs.srv import GetLimitSurface, MotionCone, PredictPush, PredictStroke, StablePushes
from pushfric_ros.node_kit.qos import REQUESTS

QUESTIONS = {
    "predict_push": PredictPush,
    "predict_stroke": PredictStroke,
    "motion_cone": MotionCone,
    "stable_pushes": StablePushes,
    "limit_surface": GetLimitSurface,
}
"""Services of a planner, by name."""


def planner_client(node: Node, kind: Any, planner: str = "planner") -> Client:
    """A client of a planner's service that shares it with no other; once it is ready, it may have hundreds of open calls.

    Args:
        node: that asks, in the cell's namespace.
        kind: type of the service, one of QUESTIONS.
        planner: name of the planner's node.
    Raises:
        ValueError: a planner has no such service.
    """
    for name, known in QUESTIONS.items():
        if known is kind:
            return node.create_client(kind, f"{planner}/{name}/client_{uuid.uuid4().hex}", qos_profile=REQUESTS)
    raise ValueError(f"expected one of {', '.join(one.__name__ for one in QUESTIONS.values())}, got {kind}")
