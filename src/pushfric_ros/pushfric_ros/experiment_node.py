"""The experiment node: carries out a push plan, one push after the other, with an operator who places the object."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rclpy.action import ActionClient
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.task import Future

from pushfric_core.contact import PushingLine
from pushfric_core.planar import Pose, wrap
from pushfric_core.push_plan import PlannedPush, placement
from pushfric_core.settings import setting
from pushfric_msgs.action import Push
from pushfric_msgs.msg import PlanProgress, PusherState
from pushfric_ros.conversions import TABLE, pose_sample_from_msg, pose_to_msg, pusher_sample_from_msg
from pushfric_ros.object_file import load_object
from pushfric_ros.parameters import declare
from pushfric_ros.plan_file import load_plan
from pushfric_ros.process import run_node
from pushfric_ros.qos import LATCHED, RELIABLE, SENSOR_QUEUE

NANOSECONDS = 1e9


@dataclass(frozen=True)
class ExperimentConfig:
    """What is pushed where, and when the object counts as placed."""

    object: str = setting("", "name of an object of Table 1, or path of an object YAML")
    plan: str = setting("", "path of a push plan; empty: the paper's plan, or a few pushes along each edge")
    distance: float = setting(0.05, "length of a push [m]", 0.001, 10.0)
    speed: float = setting(0.02, "speed of a push [m/s]", 0.0001, 1.0)
    gap: float = setting(0.005, "from the resting tip to where the object is wanted [m]", 0.0, 0.1)
    position_tolerance: float = setting(0.01, "the object may lie this far from where it is wanted [m]", 0.0, 1.0)
    angle_tolerance: float = setting(0.2, "and be turned this much against it [rad]", 0.0, math.pi)
    still: float = setting(0.5, "it must lie still for this long [s]", 0.0, 60.0)
    still_distance: float = setting(0.0005, "still: moved less than this [m], turned less than it over 10 cm", 0.0, 0.1)
    awaits: tuple[str, ...] = setting(("estimator", "recorder"), "nodes that must report themselves well before the first push")
    lost_result: float = setting(
        3.0, "a push is given up when the pusher idles or is silent for this long, of wall time [s]", 0.1, 60.0
    )


class ExperimentNode(Node):
    """Ends its process when the plan is finished."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("experiment", **kwargs)
        self._config = declare(self, ExperimentConfig)
        self._object = load_object(self._config.object)
        self._plan = load_plan(self._config.plan, self._object)
        self._placement_out = self.create_publisher(PoseStamped, "placement", LATCHED)
        self._progress_out = self.create_publisher(PlanProgress, "plan_progress", LATCHED)
        self._progress = PlanProgress(count=len(self._plan))
        self._awaited = {f"{self.get_namespace()}/{name}".replace("//", "/") for name in self._config.awaits if name}
        self._well: set[str] = set()
        self._action = ActionClient(self, Push, "push")
        self._pusher: PusherState | None = None
        self._heard = -math.inf  # when the pusher last said something; this and the next in wall time [s]
        self._idle_since: float | None = None
        self._poses: list[tuple[int, Pose]] = []  # of the last `still` seconds [ns]
        self._condition: tuple[Callable[[], bool], Future] | None = None
        self.create_subscription(PusherState, "pusher_state", self._on_pusher_state, RELIABLE)
        self.create_subscription(PoseWithCovarianceStamped, "object_pose", self._on_pose, SENSOR_QUEUE)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, RELIABLE)
        self.create_timer(0.05, self._check_condition)
        # its own group: the plan waits in its callback while the others run
        self._start = self.create_timer(0.05, self._carry_out, callback_group=MutuallyExclusiveCallbackGroup())

    async def _carry_out(self) -> None:
        self._start.cancel()
        self._report(PlanProgress.PHASE_WAITING, "waiting for the pusher to be ready")
        await self._until(lambda: self._idle and self._action.server_is_ready())
        # not only are they running: they hear those they need, so that nothing of the first push is missed
        self._report(PlanProgress.PHASE_WAITING, f"waiting for {', '.join(self._config.awaits)}")
        await self._until(lambda: self._awaited <= self._well)
        for push_id, push in enumerate(self._plan):
            self._progress.push_id = push_id
            await self._place(push)
            await self._push(push_id)
        self._report(PlanProgress.PHASE_FINISHED, f"{self._progress.completed} of {len(self._plan)} pushes done")
        await self._until(self._progress_out.wait_for_all_acked)
        raise SystemExit(0)

    async def _place(self, push: PlannedPush) -> None:
        """Ask for the object where the push needs it, and wait until it lies there still."""
        await self._until(lambda: self._idle)
        assert self._pusher is not None
        line: PushingLine = pusher_sample_from_msg(self._pusher).line
        wanted = placement(self._object.outline, push, line, self._pusher.position + self._config.gap)
        self._progress.placement = pose_to_msg(wanted)
        msg = PoseStamped(pose=self._progress.placement)
        msg.header.frame_id, msg.header.stamp = TABLE, self.get_clock().now().to_msg()
        self._poses.clear()
        self._placement_out.publish(msg)
        where = f"x {wanted.x * 1e3:.0f} mm, y {wanted.y * 1e3:.0f} mm, turned by {math.degrees(wanted.theta):.0f} degrees"
        self._report(PlanProgress.PHASE_PLACING, f"place the object at {where}")
        await self._until(lambda: self._lies_still_at(wanted))

    async def _push(self, push_id: int) -> None:
        goal = Push.Goal(push_id=push_id, distance=self._config.distance, speed=self._config.speed, retract=True)
        self._report(PlanProgress.PHASE_PUSHING, f"push {push_id + 1} of {len(self._plan)}")
        await self._until(lambda: self._idle and self._action.server_is_ready())
        answered = self._action.send_goal_async(goal)
        self._idle_since = None
        await self._until(lambda: answered.done() or self._lost())
        if not answered.done() or not answered.result().accepted:
            return self._count_aborted(push_id, "the pusher refused it" if answered.done() else "the pusher does not answer")
        result = answered.result().get_result_async()
        self._idle_since = None
        await self._until(lambda: result.done() or self._lost())
        if not result.done():
            return self._count_aborted(push_id, "the pusher forgot it")
        answer = result.result()
        if answer.status != GoalStatus.STATUS_SUCCEEDED:
            return self._count_aborted(push_id, answer.result.message)
        self._progress.completed += 1
        return None

    def _count_aborted(self, push_id: int, why: str) -> None:
        self._progress.aborted += 1
        self.get_logger().warning(f"push {push_id + 1} aborted: {why}")

    def _report(self, phase: int, message: str) -> None:
        self._progress.phase, self._progress.message = phase, message
        self._progress.header.stamp = self.get_clock().now().to_msg()
        self._progress_out.publish(self._progress)
        self.get_logger().info(message)

    def _until(self, condition: Callable[[], bool]) -> Future:
        """A future that is done once the condition, looked at 20 times a second, holds."""
        future: Future = Future()
        self._condition = (condition, future)
        return future

    def _check_condition(self) -> None:
        if self._condition is not None and self._condition[0]():
            future, self._condition = self._condition[1], None
            future.set_result(None)

    @property
    def _idle(self) -> bool:
        """The pusher said so, and not long ago."""
        return self._pusher is not None and self._pusher.mode == PusherState.MODE_IDLE and not self._silent

    @property
    def _silent(self) -> bool:
        return time.monotonic() - self._heard > self._config.lost_result

    def _lost(self) -> bool:
        """A pusher that idles, or says nothing at all, has forgotten its goal."""
        idles = self._idle_since is not None and time.monotonic() - self._idle_since > self._config.lost_result
        return idles or self._silent

    def _lies_still_at(self, wanted: Pose) -> bool:
        span = self._poses[-1][0] - self._poses[0][0] if self._poses else 0
        if span < 0.9 * self._config.still * NANOSECONDS:
            return False
        last = self._poses[-1][1]
        near = math.hypot(last.x - wanted.x, last.y - wanted.y) <= self._config.position_tolerance
        aligned = abs(wrap(last.theta - wanted.theta)) <= self._config.angle_tolerance
        still = all(
            math.hypot(p.x - last.x, p.y - last.y) + 0.1 * abs(wrap(p.theta - last.theta)) < 2 * self._config.still_distance
            for _, p in self._poses
        )
        return near and aligned and still

    def _on_pusher_state(self, msg: PusherState) -> None:
        self._pusher, self._heard = msg, time.monotonic()
        if msg.mode != PusherState.MODE_IDLE or msg.push_id != PusherState.NO_PUSH:
            self._idle_since = None
        elif self._idle_since is None:
            self._idle_since = time.monotonic()

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        self._well |= {status.name for status in msg.status if status.level == DiagnosticStatus.OK}

    def _on_pose(self, msg: PoseWithCovarianceStamped) -> None:
        try:
            stamp, pose = pose_sample_from_msg(msg)
        except ValueError as error:
            self.get_logger().error(f"object_pose refused: {error}", once=True)
            return
        oldest = stamp - int(self._config.still * NANOSECONDS)
        self._poses = [(t, p) for t, p in self._poses if oldest <= t <= stamp] + [(stamp, pose)]


def main() -> None:
    run_node(ExperimentNode)
