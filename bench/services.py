"""How planners delay estimates and how soon they are answered while a live cell pushes, and how many clients a planner serves.

In the cell, the pushes take turns: nobody asks (`quiet`); a client asks about one push at RATE (`asked`); a client asks about
MANY pushes, again and again, and about one push at RATE (`loaded`). So all figures come from the same run, under the same load.
An estimate's delay runs from the publication of the last message that it needs (the newest pose of its window, or the pusher
state) to its own; all are times at which the middleware published. An answer's delay is what the client sees. A gap in the
estimator's heartbeat is the time between two heartbeats, or that for which its executor had not turned.
"""

import math
import pathlib
import subprocess
import tempfile
import time
from bisect import bisect_left
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future

from bench import pipeline
from bench.display import Figures, Verdict
from bench.paper import pushes
from bench.processes import OBJECT
from pushfric_core import TABLE_1, friction_model
from pushfric_core.bags.samples import stamp_from_msg
from pushfric_core.cell.node_settings import PlannerConfig
from pushfric_core.estimation.verdict import Verdict as EstimateVerdict
from pushfric_msgs.msg import FrictionModel, Heartbeat, PusherState
from pushfric_msgs.srv import PredictPush
from pushfric_ros.faults.processes import end, started
from pushfric_ros.graph import graph
from pushfric_ros.graph.supervisor import command
from pushfric_ros.messages.conversions import MODEL_TOPIC, friction_model_to_msg
from pushfric_ros.node_kit.planner_client import planner_client
from pushfric_ros.node_kit.qos import LATCHED
from pushfric_ros.node_kit.visit import visit

RATE = 20.0
"""How often the client asks about one push [Hz]."""

MANY = 10_000
KINDS = ("quiet", "asked", "loaded")

CLIENTS, AT_ONCE, EACH, TIMES = 50, 200, 100, 20
"""Number of clients; of calls at once; of pushes in a call, and of calls of each client, one after another."""

PATIENCE = 60.0  # [s]


def question(count: int) -> PredictPush.Request:
    """A number of pushes all over the outline of the demo's object, always the same."""
    rng, outline = np.random.default_rng(count), TABLE_1[OBJECT].outline
    edges = rng.integers(len(outline.edges), size=count)
    points = outline.vertices[edges] + rng.uniform(0.1, 0.9, (count, 1)) * outline.edges[edges]
    normals = outline.normals[edges]
    velocities = 0.02 * (0.4 * rng.normal(size=(count, 2)) - normals)
    return PredictPush.Request(
        contact_points=points.ravel(), contact_normals=normals.ravel(), tip_velocities=velocities.ravel()
    )


def timed(client: Client, request: PredictPush.Request, answers: list[float]) -> Future:
    """Ask; once a push is predicted, note how long that took [ms]. There is no estimate before the first observation."""
    begin, future = time.perf_counter(), client.call_async(request)

    def on_answer(answer: Future) -> None:
        if answer.result().success:
            answers.append(1e3 * (time.perf_counter() - begin))

    future.add_done_callback(on_answer)
    return future


def measure(progress: Callable[[str], None]) -> Figures:
    """Run the whole plan of the demo's cell once, and let many clients ask a planner.

    Returns:
        By kind of push: "answers" to questions about one push, and "estimates": {count, p50_ms, p90_ms, p99_ms}; and
        "heartbeat_gap_s": the longest. "crowd": {"at_once": number of answers to AT_ONCE calls; "in_a_row": number of answers
        to CLIENTS x TIMES calls, "p50_ms", "p99_ms"}.
    """
    progress("answers while a cell pushes")
    planner = _Planner()
    pipeline.run(planner, changed=lambda specs: graph.with_planner(specs, PlannerConfig()))
    progress(f"{CLIENTS} clients")
    return {**planner.figures(), "crowd": _crowd()}


def verdicts(figures: Figures) -> Iterator[Verdict]:
    """The targets, next to what was measured."""
    yield Verdict.at_most("an answer while pushes run, p50 ms", 5, figures["answers"]["asked"]["p50_ms"])
    quiet = figures["estimates"]["quiet"]["p50_ms"]
    for kind in KINDS[1:]:
        yield Verdict.at_most(f"an estimate later by, {kind}, p50 ms", 1, figures["estimates"][kind]["p50_ms"] - quiet)
    gap = figures["heartbeat_gap_s"]["loaded"]
    yield Verdict.at_most(f"the estimator's heartbeat, {MANY} predictions again and again, largest gap, s", 0.15, gap)
    crowd = figures["crowd"]
    yield Verdict(f"answers to {AT_ONCE} calls at once", f"{AT_ONCE}", crowd["at_once"], crowd["at_once"] == AT_ONCE)
    every = CLIENTS * TIMES
    yield Verdict(f"answers to {CLIENTS} clients in a row", f"{every}", crowd["in_a_row"], crowd["in_a_row"] == every)
    yield Verdict.at_most(f"the same, p99 ms, k = {EACH}", 500, crowd["p99_ms"])


class _Planner(pipeline.Listener):
    """Asks during pushes."""

    def __init__(self) -> None:
        super().__init__(images=False)
        self._pushes: dict[int, int] = {}  # push_id of each pusher state
        self._now: str | None = None  # kind of the present push
        self._pending: Future | None = None  # the last answer about MANY pushes
        self._answers: dict[str, list[float]] = {kind: [] for kind in KINDS}  # [ms]
        self._gaps: dict[str, list[float]] = {kind: [] for kind in KINDS}  # [s]
        self._beat: int | None = None  # when the last heartbeat was published [ns]

    def subscribe(self, node: Node) -> None:
        super().subscribe(node)
        self._one, self._many = question(1), question(MANY)
        self._client, self._greedy = (planner_client(node, PredictPush) for _ in range(2))
        node.create_subscription(PusherState, "pusher_state", self._on_pusher_state, pipeline.DEEP)
        node.create_subscription(Heartbeat, "heartbeat", self._on_heartbeat, pipeline.DEEP)
        node.create_timer(1 / RATE, self._ask)

    def figures(self) -> Figures:
        stamps = sorted(self._pushes)
        delays: dict[str, list[float]] = {kind: [] for kind in KINDS}
        for stamp, _, published, pose, state in self.estimated():
            push = self._pushes[stamps[min(bisect_left(stamps, stamp), len(stamps) - 1)]]
            if push != PusherState.NO_PUSH:
                delays[_kind(push)].append((published - max(pose, state)) / 1e6)
        return {
            "answers": {kind: _spread(values) for kind, values in self._answers.items() if kind != "quiet"},
            "estimates": {kind: _spread(values) for kind, values in delays.items()},
            "heartbeat_gap_s": {kind: max(values, default=math.nan) for kind, values in self._gaps.items()},
        }

    def _ask(self) -> None:
        if self._now not in ("asked", "loaded") or not self._client.service_is_ready():
            return
        timed(self._client, self._one, self._answers[self._now])
        if self._now == "loaded" and (self._pending is None or self._pending.done()):
            self._pending = self._greedy.call_async(self._many)

    def _on_heartbeat(self, msg: Heartbeat, info: dict[str, Any]) -> None:
        if not msg.node.endswith("/estimator"):
            return
        now: int = info["source_timestamp"]
        if self._now is not None and self._beat is not None:
            self._gaps[self._now].append(max((now - self._beat) / 1e9, msg.stalled))
        self._beat = now

    def _on_pusher_state(self, msg: PusherState) -> None:
        self._pushes.setdefault(stamp_from_msg(msg.header.stamp), msg.push_id)
        self._now = None if msg.push_id == PusherState.NO_PUSH else _kind(msg.push_id)


def _kind(push: int) -> str:
    return KINDS[push % len(KINDS)]


def _crowd() -> Figures:
    """Many clients of a planner that has only its topic."""
    known = TABLE_1[OBJECT]
    data = pushes.watch(OBJECT, pushes.motions(OBJECT, pushes.plan(OBJECT), 0), 0)
    estimate = pushes.estimated(data, known.support_points)[1]
    msg = friction_model_to_msg(OBJECT, known.outline, estimate, friction_model(estimate), EstimateVerdict())
    asked = question(EACH)
    with tempfile.TemporaryDirectory(prefix="pushfric-bench-") as folder, ExitStack() as stack:
        here = stack.enter_context(visit("bench", graph.NAMESPACE))
        here.node.create_publisher(FrictionModel, MODEL_TOPIC, LATCHED).publish(msg)
        arguments = command(graph.NodeSpec("planner"), graph.NAMESPACE, pathlib.Path(folder))
        stack.callback(end, started(arguments, pathlib.Path(folder), subprocess.DEVNULL))
        # with rclpy's own queues, as another language's client has them; that of `planner_client` is deeper
        names = [f"planner/predict_push/client_{number}" for number in range(CLIENTS)]
        clients = [here.node.create_client(PredictPush, name) for name in names]

        def spin(done: Callable[[], bool]) -> None:
            deadline = time.monotonic() + PATIENCE
            while not done() and time.monotonic() < deadline:
                here.spin_once(0.05)

        spin(lambda: all(client.service_is_ready() for client in clients))
        answers: list[float] = []  # [ms]
        while not answers:  # until it has the model
            spin(timed(clients[0], asked, answers).done)

        def asked_by_all(at_once: int, in_a_row: int) -> list[float]:
            """How long the answers to so many calls of each client took [ms]."""
            answers: list[float] = []

            def ask(client: Client, left: int) -> None:
                if left:
                    timed(client, asked, answers).add_done_callback(lambda _: ask(client, left - 1))

            for client in clients * at_once:
                ask(client, in_a_row)
            spin(lambda: len(answers) == CLIENTS * at_once * in_a_row)
            return answers

        at_once = len(asked_by_all(AT_ONCE // CLIENTS, 1))
        spread = _spread(asked_by_all(1, TIMES))
    return {"at_once": at_once, "in_a_row": spread.pop("count"), **spread}


def _spread(values: list[float]) -> Figures:
    quantiles = np.percentile(values, (50, 90, 99), method="higher") if values else np.full(3, np.nan)
    return {"count": len(values), **dict(zip(("p50_ms", "p90_ms", "p99_ms"), quantiles.tolist(), strict=True))}
