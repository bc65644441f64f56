"""The live graph: how long an estimate takes after the image that completes it.

The whole simulated cell runs in real time under the supervisor, as in the demo. All times are those at which the middleware
published a message, so that the delays of the listener do not count.

An estimate carries the stamp of the frame in the middle of its window. The newest image that it needs comes half a window and
one frame later. The latency runs from the publication of that image to the publication of the estimate.

An estimate needs a pusher state at least as new as the frame before that image, and sometimes one as new as the image itself.
"""

import math
import tempfile
import time
from bisect import bisect_left
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

from bench.display import Figures
from bench.processes import Run, cell_of
from pushfric_core import TrajectoryConfig
from pushfric_core.bags.samples import stamp_from_msg
from pushfric_msgs.msg import FrictionEstimate, PusherState
from pushfric_ros.graph import graph
from pushfric_ros.graph.graph import NodeSpec
from pushfric_ros.node_kit.visit import visit
from pushfric_ros.nodes.tracker import IMAGE_QUEUE

AFTERWARDS = 2.5
"""How long to wait for the last estimates after the plan [s]."""

DEEP = QoSProfile(depth=5000)
LATCHED = QoSProfile(depth=5000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=5000, reliability=ReliabilityPolicy.BEST_EFFORT)


def measure(progress: Callable[[str], None]) -> Figures:
    """Run the demo's cell once in real time; see `Listener.latency`."""
    progress("live graph")
    listener = Listener()
    run(listener)
    return listener.latency()


class Listener:
    """Records when messages of the cell were published [ns], by their stamps [ns].

    Args:
        images: whether those of images count, too.
    """

    def __init__(self, images: bool = True) -> None:
        self._sees = images
        self.images: dict[int, int] = {}
        self.poses: dict[int, int] = {}
        self.pusher_states: dict[int, int] = {}
        self.estimates: dict[int, int] = {}

    def subscribe(self, node: Node) -> None:
        """Called before the nodes start."""

        def note(times: dict[int, int]) -> Callable[[Any, dict[str, Any]], None]:
            return lambda msg, info: times.setdefault(stamp_from_msg(msg.header.stamp), info["source_timestamp"])

        def on_estimate(msg: FrictionEstimate, info: dict[str, Any]) -> None:
            if msg.data_points:
                note(self.estimates)(msg, info)

        if self._sees:
            node.create_subscription(Image, "image_raw", note(self.images), IMAGE_QUEUE)
        node.create_subscription(PoseWithCovarianceStamped, "object_pose", note(self.poses), BEST_EFFORT)
        node.create_subscription(PusherState, "pusher_state", note(self.pusher_states), DEEP)
        node.create_subscription(FrictionEstimate, "friction_estimate", on_estimate, LATCHED)

    def estimated(self) -> Iterator[tuple[int, int, int, int, int]]:
        """Of each estimate: its stamp, that of the newest frame it needs; when it, the pose and the pusher state came."""
        stamps, pusher_stamps = sorted(self.poses), sorted(self.pusher_states)
        ahead = TrajectoryConfig.window // 2 + 1
        for stamp, published in self.estimates.items():
            last_but_one, *newest = stamps[bisect_left(stamps, stamp) + ahead - 1 :][:2]
            if newest:  # else this listener missed it
                state = pusher_stamps[bisect_left(pusher_stamps, last_but_one)]
                yield stamp, newest[0], published, self.poses[newest[0]], self.pusher_states[state]

    def latency(self) -> Figures:
        """Number of estimates, and how long they and their parts took, in the median or 99 of 100 [ms]."""
        seen = [(self.images[newest], *times) for _, newest, *times in self.estimated() if newest in self.images]
        image, published, pose, pusher = np.array(seen).T
        both = np.maximum(pose, pusher)
        parts = {"": published - image, "pose_": pose - image, "pusher_": both - pose, "rest_": published - both}
        medians = {f"{name}p50_ms": float(np.median(part)) / 1e6 for name, part in parts.items()}
        tail = float(np.percentile(published - image, 99, method="higher")) / 1e6
        return {"estimates": len(seen), "p99_ms": tail, **medians}


def run(listener: Listener, changed: Callable[[list[NodeSpec]], list[NodeSpec]] = list) -> None:
    """Run the cell in real time until its plan is finished.

    Args:
        listener: hears of the run.
        changed: makes other nodes of the cell's.
    """
    with tempfile.TemporaryDirectory(prefix="pushfric-bench-") as folder, visit("bench", graph.NAMESPACE, images=True) as here:
        listener.subscribe(here.node)
        until = math.inf
        with Run(changed(cell_of(folder))) as cell:
            while time.monotonic() < until:
                here.spin_once(0.05)
                if until == math.inf and cell.finished():
                    until = time.monotonic() + AFTERWARDS
