"""The monitor node: what the command line receives from a running cell."""

import time
from collections.abc import Callable, Collection
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

from pushfric_core.bags.samples import stamp_from_msg
from pushfric_msgs.msg import EstimatorProgress, FrictionEstimate, PlanProgress
from pushfric_ros.node_kit.diagnostics import PERIOD
from pushfric_ros.node_kit.qos import LATCHED, LATCHED_QUEUE, RELIABLE
from pushfric_ros.node_kit.timers import wall_timer
from pushfric_ros.node_kit.visit import SERVING_NOTHING

GONE = 3
"""After this many periods without a report, a node is silent; run.js says the same."""

LOOK_PERIOD = 0.05
"""Time between two looks for the player, in wall time [s]."""


class MonitorNode(Node):
    """Passes on estimates and the plan's progress, and records how far the estimator has come.

    Args:
        on_estimate: called with every friction_estimate.
        on_progress: called with every plan_progress.
        starts_player: resume a paused player once estimates can be received, because discovery may take seconds, and estimates
            during this time would be lost.
        services: that `ask` can call.
    """

    def __init__(
        self,
        on_estimate: Callable[[FrictionEstimate], None],
        on_progress: Callable[[PlanProgress], None],
        starts_player: bool,
        services: Collection[str] = (),
        **kwargs: Any,
    ) -> None:
        super().__init__("monitor", **SERVING_NOTHING, **kwargs)
        self.settled = self.newest = -1  # what the estimator has processed, and its newest observation [ns]
        self.data_points = 0  # of its last estimate
        self.judged = False  # whether it has judged the pushes of all observations
        self._estimates = self.create_subscription(FrictionEstimate, "friction_estimate", on_estimate, LATCHED_QUEUE)
        self.create_subscription(PlanProgress, "plan_progress", on_progress, LATCHED_QUEUE)
        self.create_subscription(EstimatorProgress, "estimator_progress", self._on_estimator_progress, LATCHED)
        self._reported: dict[str, float] = {}  # when each node did last [s of wall time]
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, RELIABLE)
        self._clients_of = {service: self.create_client(Trigger, service) for service in services}
        if starts_player:
            self._pause = self.create_client(SetBool, "player/pause")
            self._look = wall_timer(self, LOOK_PERIOD, self._start_player)

    def ask(self, service: str, on_answer: Callable[[str], None]) -> None:
        """Call one of the services; what it answers, or that nobody is there, goes to `on_answer`."""
        client = self._clients_of[service]
        if not client.service_is_ready():
            on_answer(f"no service {service}: nobody there can do it")
            return

        def answered(future: Future) -> None:
            on_answer(str(future.result().message))

        client.call_async(Trigger.Request()).add_done_callback(answered)

    def silent(self, node: str) -> bool:
        """Whether a node of the cell has reported, and does so no more."""
        then = self._reported.get(f"{self.get_namespace()}/{node}")
        return then is not None and time.monotonic() - then > GONE * PERIOD

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        self._reported |= {status.name: time.monotonic() for status in msg.status}

    def _start_player(self) -> None:
        if self._estimates.get_publisher_count() and self._pause.service_is_ready():
            self._pause.call_async(SetBool.Request(data=False))
            self._look.cancel()

    def _on_estimator_progress(self, msg: EstimatorProgress) -> None:
        self.settled, self.newest = stamp_from_msg(msg.settled_until), stamp_from_msg(msg.header.stamp)
        self.data_points, self.judged = msg.data_points, msg.judged
