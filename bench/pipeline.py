"""The live graph: how long an estimate takes after the image that completes it, and whether every frame is used.

The whole simulated cell runs in real time under the supervisor, as in the demo. All times are those at which the middleware
published a message, so that the delays of the listener do not count.

An estimate carries the stamp of the frame in the middle of its window. The newest image that it needs comes half a window and
one frame later. The latency runs from the publication of that image to the publication of the estimate. The results also give
it from the stamp of the image, which adds the rendering time of the simulation; a real camera does not have that.

An estimate needs a pusher state at least as new as the frame before that image, and sometimes one as new as the image itself.
"""

import math
import tempfile
import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image

from bench.processes import cpu_of_ended_children
from pushfric_core import TrajectoryConfig
from pushfric_core.bags.samples import stamp_from_msg
from pushfric_msgs.msg import FrictionEstimate, PusherState
from pushfric_ros.commands.demo import demo_cell
from pushfric_ros.graph import graph
from pushfric_ros.graph.graph import NodeSpec
from pushfric_ros.graph.supervisor import Supervisor
from pushfric_ros.nodes.tracker import IMAGE_QUEUE

OBJECT = "rubber_rect4"
CAMERA_RATE, HIGH_RATE = 14.0, 64.0
"""The cell's own frame rate, and one that still gives 60 a second if the simulation falls a little behind its clock [Hz]."""

HIGH_RATE_SECONDS = 30.0
"""Duration of the run at the high rate [s]."""

STEPS = 2

AFTERWARDS = 2.5
"""How long to wait for the tracker's last count of frames after the plan [s]; it comes at 1 Hz."""

DEEP = QoSProfile(depth=5000)
LATCHED = QoSProfile(depth=5000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=5000, reliability=ReliabilityPolicy.BEST_EFFORT)

Figures = dict[str, Any]


def measure(progress: Callable[[str], None]) -> Figures:
    """Run the cell twice: its whole plan at 14 frames/s, then half a minute at more than 60 frames/s.

    Returns:
        "latency": {estimates, p50_ms, p99_ms, max_ms; from_stamp_p50_ms and from_stamp_p99_ms, from the moment of the stamp;
        pose_p50_ms, until the pose; pusher_p50_ms, from then until the pusher state that every estimate needs, 0 if it came
        earlier; rest_p50_ms and rest_p99_ms, after both}.
        "start_to_first_pose_s". "frames": for each rate {published_hz, published, dropped, cores}; cores are CPU time of all
        nodes over wall time.
    """
    progress("live graph, 14 frames/s")
    at_camera_rate, at_high_rate = LatencyListener(), LatencyListener()
    run(at_camera_rate, CAMERA_RATE)
    progress("live graph, more than 60 frames/s")
    run(at_high_rate, HIGH_RATE, HIGH_RATE_SECONDS)
    return {
        "latency": at_camera_rate.latency(),
        "start_to_first_pose_s": at_camera_rate.first_pose_s(),
        "frames": [listener.frames() for listener in (at_camera_rate, at_high_rate)],
    }


class Listener(Protocol):
    """A listener to a run."""

    started: float  # when the nodes were started [ns]
    seconds: float  # of the whole run
    cpu_seconds: float  # of all nodes, over the whole run

    def subscribe(self, node: Node) -> None:
        """Called before the nodes start."""

    @property
    def frame_count(self) -> int:
        """Number of images so far."""


class LatencyListener:
    """Records when messages of the cell were published [ns], by their stamps [ns]."""

    def __init__(self) -> None:
        self.started = time.time_ns()
        self.seconds = self.cpu_seconds = 0.0  # of the whole run
        self._ticks: dict[int, int] = {}
        self._images: dict[int, int] = {}
        self._poses: dict[int, int] = {}
        self._pusher_states: dict[int, int] = {}
        self._estimates: dict[int, int] = {}
        self._frames: list[tuple[int, int]] = []  # (time [ns], number published until then)
        self._tracked: list[tuple[int, int]] = []  # (time [ns], number of frames that the tracker had taken)

    def subscribe(self, node: Node) -> None:
        def note(times: dict[int, int]) -> Callable[[Any, dict[str, Any]], None]:
            return lambda msg, info: times.setdefault(stamp_from_msg(msg.header.stamp), info["source_timestamp"])

        node.create_subscription(Clock, "/clock", self._on_tick, DEEP)
        node.create_subscription(Image, "image_raw", note(self._images), IMAGE_QUEUE)
        node.create_subscription(PoseWithCovarianceStamped, "object_pose", note(self._poses), BEST_EFFORT)
        node.create_subscription(PusherState, "pusher_state", note(self._pusher_states), DEEP)
        node.create_subscription(FrictionEstimate, "friction_estimate", note(self._estimates), LATCHED)
        node.create_subscription(CameraInfo, "camera_info", self._on_camera_info, BEST_EFFORT)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, DEEP)

    @property
    def frame_count(self) -> int:
        return self._frames[-1][1] if self._frames else 0

    def latency(self) -> Figures:
        stamps = sorted(self._poses)
        pusher_stamps = sorted(self._pusher_states)
        ahead = TrajectoryConfig.window // 2 + 1
        waits = []
        for stamp, published in self._estimates.items():
            last_but_one = bisect_left(stamps, stamp) + ahead - 1
            newest = stamps[last_but_one + 1] if last_but_one + 1 < len(stamps) else None
            if newest not in self._images or newest not in self._ticks:  # this listener missed it
                continue
            image = self._images[newest]
            pose = self._poses[newest]
            pusher = self._pusher_states[pusher_stamps[bisect_left(pusher_stamps, stamps[last_but_one])]]
            both = max(pose, pusher)
            waits.append((published - image, published - self._ticks[newest], pose - image, both - pose, published - both))
        whole, from_stamp, until_pose, until_pusher, rest = np.array(waits).T / 1e6

        def tail(values: npt.NDArray[np.float64]) -> float:
            return float(np.percentile(values, 99, method="higher"))

        return {
            "estimates": len(waits),
            "p50_ms": float(np.median(whole)),
            "p99_ms": tail(whole),
            "max_ms": float(whole.max()),
            "from_stamp_p50_ms": float(np.median(from_stamp)),
            "from_stamp_p99_ms": tail(from_stamp),
            "pose_p50_ms": float(np.median(until_pose)),
            "pusher_p50_ms": float(np.median(until_pusher)),
            "rest_p50_ms": float(np.median(rest)),
            "rest_p99_ms": tail(rest),
        }

    def first_pose_s(self) -> float:
        return (min(self._poses.values()) - self.started) / 1e9

    def frames(self) -> Figures:
        (begin, before), (end, count) = self._frames[0], self._frames[-1]
        moments = [moment for moment, _ in self._frames]
        missing = [
            self._frames[bisect_right(moments, moment) - 1][1] - taken for moment, taken in self._tracked if moment > begin
        ]
        # at any moment some frames may be on their way, at first more than in the end; lost frames add up
        third = max(1, len(missing) // 3)
        return {
            "published_hz": (count - before) / ((end - begin) / 1e9),
            "published": count - before,
            "dropped": max(0, min(missing[-third:]) - min(missing[:third])),
            "cores": self.cpu_seconds / self.seconds,
        }

    def _on_tick(self, msg: Clock, info: dict[str, Any]) -> None:
        self._ticks[stamp_from_msg(msg.clock)] = info["source_timestamp"]

    def _on_camera_info(self, msg: CameraInfo, info: dict[str, Any]) -> None:
        # one comes with each image, and the publisher numbers them
        self._frames.append((info["source_timestamp"], info["publication_sequence_number"]))

    def _on_diagnostics(self, msg: DiagnosticArray, info: dict[str, Any]) -> None:
        for status in msg.status:
            if status.name.endswith("/tracker"):
                taken = next(int(pair.value) for pair in status.values if pair.key == "frames")
                self._tracked.append((info["source_timestamp"], taken))


def run(
    listener: Listener,
    frame_rate: float,
    seconds: float = math.inf,
    changed: Callable[[list[NodeSpec]], list[NodeSpec]] = list,
    heard: Callable[[str, str], None] = lambda name, line: None,
) -> None:
    """Run the cell in real time until its plan is finished, or until frames have come for this many seconds.

    Args:
        listener: hears of the run.
        frame_rate: of the camera [Hz].
        seconds: infinite: until the plan is finished.
        changed: makes other nodes of the cell's.
        heard: called from threads with what the nodes print.
    """
    with tempfile.TemporaryDirectory(prefix="pushfric-bench-") as folder, _executor() as (executor, node):
        cell = demo_cell(OBJECT, Path(folder))
        specs = [
            replace(spec, parameters={**spec.parameters, "frame_rate": frame_rate}) if spec.name == "simulated_cell" else spec
            for spec in graph.simulated_cell(cell, f"{folder}/bag", seed=0, speed=1.0)
        ]
        listener.subscribe(node)
        said: list[str] = []

        def say(name: str, line: str) -> None:
            said.append(f"{name}: {line}")
            heard(name, line)

        begin, cpu_before = time.monotonic(), cpu_of_ended_children()
        with Supervisor(changed(specs), graph.NAMESPACE, say) as supervisor:
            listener.started = time.time_ns()
            until = None
            while until is None or time.monotonic() < until:
                executor.spin_once(timeout_sec=0.05)
                ended = supervisor.poll()
                if ended is not None and ended.code:
                    raise RuntimeError("\n".join([*said[-5:], ended.reason]))
                if until is None and (ended or listener.frame_count >= seconds * frame_rate):
                    until = time.monotonic() + AFTERWARDS
        listener.seconds, listener.cpu_seconds = time.monotonic() - begin, cpu_of_ended_children() - cpu_before


@contextmanager
def _executor() -> Iterator[tuple[SingleThreadedExecutor, Node]]:
    context = rclpy.Context()
    rclpy.init(context=context, args=[])
    node = Node("bench", namespace=graph.NAMESPACE, context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        yield executor, node
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown(context=context)
