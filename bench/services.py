"""How a planner's questions delay estimates, and how soon they are answered, measured in one run of the live graph.

A client asks `estimator/predict_push` at RATE during every second push. So estimates with and without questions come from the
same run, under the same load. An estimate's delay runs from the publication of the last message that it needs (the newest pose
of its window, or the pusher state) to its own; all are times at which the middleware published. An answer's delay is what the
client sees: from its call until the answer is there.
"""

import time
from bisect import bisect_left
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, PoseWithCovarianceStamped, Vector3
from rclpy.node import Node
from rclpy.task import Future

from bench import pipeline
from bench.verdict import Verdict
from pushfric_core.bags.samples import stamp_from_msg
from pushfric_core.trajectories.trajectory import TrajectoryConfig
from pushfric_msgs.msg import FrictionEstimate, PusherState
from pushfric_msgs.srv import PredictPush

STEPS = 1

RATE = 20.0
"""How often the client asks [Hz]."""

QUESTION = PredictPush.Request(
    contact_points=[Point(x=0.0, y=-0.032)], contact_normals=[Vector3(y=-1.0)], tip_velocities=[Vector3(x=0.005, y=0.02)]
)

Figures = dict[str, Any]


def measure(progress: Callable[[str], None]) -> Figures:
    """Run the whole plan of the demo's cell once.

    Returns:
        "answers": {count, p50_ms, p90_ms, p99_ms}; "estimates": for "asked" and "quiet" pushes {count, p50_ms, p90_ms, p99_ms}.
    """
    progress("services of the estimator")
    planner = _Planner()
    pipeline.run(planner, pipeline.CAMERA_RATE)
    return planner.figures()


def verdicts(figures: Figures) -> Iterator[Verdict]:
    """The targets, next to what was measured."""
    answer = figures["answers"]["p50_ms"]
    yield Verdict("an answer while pushes run, p50 ms", "<= 5", answer, answer <= 5)
    later = figures["estimates"]["asked"]["p50_ms"] - figures["estimates"]["quiet"]["p50_ms"]
    yield Verdict("an estimate later by, p50 ms", "<= 1", later, later <= 1)


class _Planner:
    """Asks during every second push, and records when messages were published [ns], by their stamps [ns]."""

    frame_count = 0

    def __init__(self) -> None:
        self.started = self.seconds = self.cpu_seconds = 0.0
        self._poses: dict[int, int] = {}
        self._pusher_states: dict[int, int] = {}
        self._estimates: dict[int, int] = {}
        self._pushes: dict[int, int] = {}  # push_id of each pusher state
        self._asks = False
        self._answers: list[float] = []  # [ms]

    def subscribe(self, node: Node) -> None:
        self._client = node.create_client(PredictPush, "estimator/predict_push")
        node.create_subscription(PoseWithCovarianceStamped, "object_pose", self._on_pose, pipeline.BEST_EFFORT)
        node.create_subscription(PusherState, "pusher_state", self._on_pusher_state, pipeline.DEEP)
        node.create_subscription(FrictionEstimate, "friction_estimate", self._on_estimate, pipeline.LATCHED)
        node.create_timer(1 / RATE, self._ask)

    def figures(self) -> Figures:
        poses, states = sorted(self._poses), sorted(self._pusher_states)
        ahead = TrajectoryConfig.window // 2 + 1
        delays: dict[str, list[float]] = {"asked": [], "quiet": []}
        for stamp, published in self._estimates.items():
            last_but_one, newest = poses[bisect_left(poses, stamp) + ahead - 1 :][:2]
            state = states[bisect_left(states, last_but_one)]
            push = self._pushes[states[min(bisect_left(states, stamp), len(states) - 1)]]
            if push != PusherState.NO_PUSH:
                kind = "asked" if _asked(push) else "quiet"
                delays[kind].append((published - max(self._poses[newest], self._pusher_states[state])) / 1e6)
        return {"answers": _spread(self._answers), "estimates": {kind: _spread(values) for kind, values in delays.items()}}

    def _ask(self) -> None:
        if self._asks and self._client.service_is_ready():
            begin = time.perf_counter()
            self._client.call_async(QUESTION).add_done_callback(lambda answer: self._on_answer(begin, answer))

    def _on_answer(self, begin: float, answer: Future) -> None:
        if answer.result().success:  # there is no estimate before the first data point
            self._answers.append(1e3 * (time.perf_counter() - begin))

    def _on_pose(self, msg: PoseWithCovarianceStamped, info: dict[str, Any]) -> None:
        self._poses.setdefault(stamp_from_msg(msg.header.stamp), info["source_timestamp"])

    def _on_pusher_state(self, msg: PusherState, info: dict[str, Any]) -> None:
        stamp = stamp_from_msg(msg.header.stamp)
        self._pusher_states.setdefault(stamp, info["source_timestamp"])
        self._pushes.setdefault(stamp, msg.push_id)
        self._asks = msg.push_id != PusherState.NO_PUSH and _asked(msg.push_id)

    def _on_estimate(self, msg: FrictionEstimate, info: dict[str, Any]) -> None:
        if msg.data_points:
            self._estimates.setdefault(stamp_from_msg(msg.header.stamp), info["source_timestamp"])


def _asked(push: int) -> bool:
    return push % 2 == 1


def _spread(values: list[float]) -> Figures:
    quantiles = np.percentile(values, (50, 90, 99), method="higher") if values else np.full(3, np.nan)
    return {"count": len(values), **dict(zip(("p50_ms", "p90_ms", "p99_ms"), quantiles.tolist(), strict=True))}
