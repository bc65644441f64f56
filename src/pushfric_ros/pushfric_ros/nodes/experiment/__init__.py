"""The experiment node: carries out a push plan, push after push, with an operator who places the object."""

import itertools
import math
import time
from typing import Any

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rclpy.action import ActionClient
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from std_msgs.msg import String

from pushfric_core.bags.samples import pose_sample_from_msg, pusher_sample_from_msg
from pushfric_core.cell.node_settings import ExperimentConfig, FrameConfig, ObjectConfig, PlanConfig
from pushfric_core.errors import InvalidInput
from pushfric_core.estimation.push_plan import PlannedPush, number_of, placement, purpose_of
from pushfric_core.files.object_file import load_object
from pushfric_core.files.plan_file import load_plan
from pushfric_core.geometry.planar import TABLE
from pushfric_core.wording import counted
from pushfric_msgs.action import Push
from pushfric_msgs.msg import PlanProgress, PusherState
from pushfric_ros.messages.conversions import pose_to_msg
from pushfric_ros.node_kit.diagnostics import Diagnostics, Health, Level
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_QUEUE
from pushfric_ros.node_kit.timers import cell_timer, wall_timer
from pushfric_ros.nodes.experiment.carrier import Carrier
from pushfric_ros.nodes.experiment.operator import ALARM_PATIENCE, Choice, Operator, RunEnded
from pushfric_ros.nodes.experiment.others import NOT_OBSERVED, EstimatorAccount, Others
from pushfric_ros.nodes.experiment.reports import HIDDEN, LET_LIE, PAUSES, ReportedPusher, SeenObject

WITHDRAWN = 1e-3  # a pusher nearer than this to the beginning of its stroke need not be brought back [m]

STALL = 0.5
"""If this process stood still for longer, it could not hear anyone meanwhile [s of wall time]."""

REPEATS = 2
"""A push that a pause ended is repeated this often without asking."""

LATE = 3.0
"""An observation that the estimator has made is awaited for so long [s of wall time]."""

LAST_WORDS = 20.0
"""The node ends this long after its plan, even if a listener has not acknowledged what it last said, or the estimator has not
processed and judged what it has seen [s of wall time]."""


class ExperimentNode(Node):
    """Ends its process when the plan is finished."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("experiment", **kwargs)
        model, begin = declare(self, ObjectConfig), declare(self, ExperimentConfig)
        self._config = config = declare(self, PlanConfig)
        known = load_object(model.object)
        self._outline = known.outline
        self._plan = [] if config.choose else load_plan(config.plan, known)
        count = config.choose or len(self._plan)
        if begin.start > count:
            where = f"{self.get_fully_qualified_name()}: parameter"
            raise InvalidInput(f"{where} start must be at most {count}, the pushes of the plan; got {begin.start}")
        topics = Diagnostics(self, self._health, declare(self, FrameConfig).within(self.get_namespace()))
        action = ActionClient(self, Push, "push")
        self._placement_out = topics.advertise(PoseStamped, "placement", LATCHED)
        told = topics.advertise(PlanProgress, "plan_progress", LATCHED)
        self._looked = time.monotonic()
        self._pusher = pusher = ReportedPusher(config.lost_result, action.server_is_ready)
        self._object = SeenObject(self._outline, config)
        self._operator = Operator(self, told, PlanProgress(count=count, push_id=begin.start - 1), pusher, begin.attended)
        self._carrier = Carrier(self, action, pusher, self._object, self._operator)
        self._estimator = EstimatorAccount(self, topics, bool(config.choose))
        self._others = Others(self, config, begin.lifeless, told.topic_name)
        topics.subscribe(PusherState, "pusher_state", self._on_pusher_state, RELIABLE)
        topics.subscribe(PoseWithCovarianceStamped, "object_pose", self._on_pose, SENSOR_QUEUE)
        self.create_subscription(String, "pusher_fault", lambda msg: pusher.report_fault(msg.data), LATCHED)
        wall_timer(self, 0.02, self._look)  # simulated time may stand still
        # in a group of its own, because the plan waits in this callback while other callbacks run
        self._start = cell_timer(self, 0.05, self._carry_out, MutuallyExclusiveCallbackGroup())

    async def _carry_out(self) -> None:
        self._start.cancel()
        end = ""
        try:
            await self._carry_out_plan()
        except RunEnded:
            end = "; ended by a person"
        estimator, operator, progress = self._estimator, self._operator, self._operator.progress
        skipped = f", {progress.skipped} skipped" if progress.skipped else ""
        done = f"{progress.completed} of {counted(progress.count, 'push', 'pushes')} done"
        deadline = time.monotonic() + LAST_WORDS
        if not estimator.complete:
            operator.report(PlanProgress.PHASE_WAITING, "waiting for the estimator")
        # what it says after the end must be its last word, so nothing may be left to leave out by then
        await operator.until(lambda: estimator.complete, lambda: time.monotonic() > deadline)
        operator.report(PlanProgress.PHASE_FINISHED, f"{done}{skipped}{end}")
        await operator.until(lambda: operator.acknowledged, lambda: time.monotonic() > deadline)
        raise SystemExit(0)

    async def _carry_out_plan(self) -> None:
        progress = self._operator.progress
        await self._operator.until_well(self._pusher.hindrance, "waiting for the pusher")
        for index in range(progress.push_id, progress.count):
            progress.push_id = index
            push = await self._choose(index) if self._config.choose else self._plan[index]
            if push is None:
                self.get_logger().warning("the region of p_CF has collapsed: no push would shrink it")
                return
            progress.purpose = purpose_of(self._outline, push, bool(self._config.choose))
            await self._push(index, push)

    async def _choose(self, index: int) -> PlannedPush | None:
        """The next push, once the estimator has the whole last one; None if no push is of use."""

        def missing() -> str | None:
            return None if self._estimator.knows(index) else self._others.foreign_clock() or "the region of p_CF"

        await self._operator.until_well(missing, "waiting for")
        return self._estimator.next_push(index)

    async def _push(self, index: int, push: PlannedPush) -> None:
        """Carry out a push, and again for as long as it is aborted and a person wants it repeated."""
        operator, progress, again = self._operator, self._operator.progress, 0
        for push_id in itertools.count(index, progress.count):
            progress.push_id, progress.in_place = push_id, False
            number = f"push {number_of(push_id, progress.count)}"
            if operator.choice is not Choice.END:
                operator.choice = None
            problem = await self._withdraw() or await self._place_and_push(push_id, push)
            self._estimator.pushed = self.get_clock().now().nanoseconds
            if problem is None:
                progress.completed += 1
                return
            self.get_logger().warning(f"{number} aborted: {problem}")
            self._others.awaited.renew()
            self._estimator.unwanted.append(push_id)
            if again < REPEATS and operator.choice is None and await self._paused():
                again += 1
                self.get_logger().warning(f"{number} is repeated: the pusher rests where it should")
                continue
            if operator.choice is None:
                if not operator.attended:
                    progress.aborted += 1
                    return
                await operator.until_chosen(f"{number} of {progress.count} was given up: {problem}")
            if operator.choice is Choice.END:
                raise RunEnded
            if operator.choice is Choice.SKIP:
                progress.skipped += 1
                return

    async def _paused(self) -> bool:
        """Whether the push was given up for a pause alone, of the computer or of the controller, and nothing is in doubt."""
        deadline = time.monotonic() + ALARM_PATIENCE
        await self._operator.until(self._pusher.explained, lambda: time.monotonic() > deadline)
        return self._pusher.hindrance() is None and self._pusher.fault in PAUSES

    async def _withdraw(self) -> str | None:
        """Bring the pusher back from where an aborted push or an earlier run left it; return what went wrong, or None."""
        pusher, operator = self._pusher, self._operator

        def blind() -> str | None:
            """Why it is not brought back yet: nobody knows what it would do to an object that is not seen."""
            pusher.blind = pusher.blind and self._object.unseen
            return HIDDEN if pusher.blind else None

        await operator.until_well(self._pusher.hindrance, "waiting for the pusher")
        if pusher.state.position <= WITHDRAWN:
            pusher.blind = False
            return None
        await operator.until_well(self._others.unwell, "waiting for")
        await operator.until_well(blind, "the pusher stays where it is")
        operator.report(PlanProgress.PHASE_WAITING, "bringing the pusher back")
        back = Push.Goal(push_id=operator.progress.push_id, distance=-pusher.state.position, speed=self._config.speed)
        problem = await self._carrier.carry(back)
        await operator.until_well(self._pusher.hindrance, "waiting for the pusher")
        return None if problem is None else f"the pusher could not be brought back: {problem}"

    async def _place_and_push(self, push_id: int, planned: PlannedPush) -> str | None:
        """Have the object placed, and push it; return what went wrong, or None."""
        operator, config, progress = self._operator, self._config, self._operator.progress
        push = f"push {number_of(push_id, progress.count)} of {progress.count}"
        tip = pusher_sample_from_msg(self._pusher.state)
        wanted = placement(self._outline, planned, tip.line, tip.position + config.gap)
        progress.placement = pose_to_msg(wanted)
        msg = PoseStamped(pose=progress.placement)
        msg.header.frame_id, msg.header.stamp = TABLE, self.get_clock().now().to_msg()
        self._object.poses.clear()
        self._placement_out.publish(msg)
        turned = 180 - (180 - round(math.degrees(wanted.theta))) % 360
        where = f"x {wanted.x * 1e3:z.0f} mm, y {wanted.y * 1e3:z.0f} mm, turned by {turned} degrees"

        def misplaced() -> str | None:
            if operator.choice is not None or self._pusher.hindrance() is not None:
                return None
            fault = self._object.misplaced(wanted, self._others.awaited.no_pose)
            progress.in_place = fault in (None, LET_LIE)
            return fault

        while misplaced() is not None or self._others.unwell() is not None or self._pusher.hindrance() is not None:
            await operator.until_well(self._pusher.hindrance, "waiting for the pusher")
            await operator.until_well(misplaced, f"{push}: place the object at {where}", PlanProgress.PHASE_PLACING)
            # a node that reports OK receives the topics it needs, so it misses nothing of a push
            await operator.until_well(self._others.unwell, "waiting for")
        if operator.choice is not None:
            return operator.choice.value
        progress.in_place = True
        await operator.until_well(self._others.foreign_clock, "no push can be measured")
        await operator.until_well(self._others.namesake, "the messages may come from another cell")
        operator.report(PlanProgress.PHASE_PUSHING, f"{push}: the pusher moves, leave the object alone")
        goal = Push.Goal(push_id=push_id, distance=config.distance, speed=config.speed, retract=True)
        return await self._carrier.carry(goal) or await self._unobserved(push_id, push)

    async def _unobserved(self, push_id: int, push: str) -> str | None:
        """Why a push that reached its end is of little use: the estimator made few observations of it, and none is to come.

        Where nobody attends who could choose to repeat it, a few are better than none.
        """
        end, made = self.get_clock().now().nanoseconds, math.inf  # when all of them were made [s of wall time]

        def outstanding() -> str | None:
            nonlocal made
            if self._estimator.settled >= end:
                made = min(made, time.monotonic())
            awaited = self._estimator.lacks(push_id) and self._operator.choice is None
            come = time.monotonic() - made > (0 if self._estimator.heard else LATE)
            waits = awaited and not come and not self._unobservable()
            return f"waiting for {self._others.unwell() or 'its observations'}" if waits else None

        await self._operator.until_well(outstanding, push, PlanProgress.PHASE_PUSHING)
        if self._operator.choice is not None:
            return self._operator.choice.value
        lack = self._estimator.lacks(push_id)
        if lack is None or (lack != NOT_OBSERVED and not self._operator.attended):
            return None
        return "; ".join(filter(None, (lack, self._unobservable())))

    def _unobservable(self) -> str | None:
        """Why no observation is made at present; None if it may be."""
        return "the object is not seen" if self._object.unseen else self._others.foreign_clock()

    def _look(self) -> None:
        self._estimator.ask_exclusions()
        before, self._looked = self._looked, time.monotonic()
        if (stood_still := self._looked - before) > STALL:
            self._pusher.excuse(stood_still)
            self._object.excuse(stood_still)
        self._operator.check_conditions()

    def _on_pusher_state(self, msg: PusherState) -> None:
        try:
            sample = pusher_sample_from_msg(msg)
        except ValueError as error:
            self.get_logger().error(f"pusher_state refused: {error}", once=True)
            return
        self._object.following.add_pusher(sample)
        self._pusher.report(msg)
        self._others.compare_clock("the pusher", sample.stamp, "set the clocks of both computers, for example by NTP")

    def _on_pose(self, msg: PoseWithCovarianceStamped) -> None:
        try:
            new = pose_sample_from_msg(msg)
        except ValueError as error:
            self.get_logger().error(f"object_pose refused: {error}", once=True)
            return
        self._object.report(new)
        self._others.compare_clock("the camera", new.stamp, "set it, for example by NTP, or give the difference as time_offset")

    def _health(self) -> Health:
        progress = self._operator.progress
        values = {"push": number_of(progress.push_id, progress.count), "pushes": progress.count}
        values |= {ended: getattr(progress, ended) for ended in ("completed", "aborted", "skipped")}
        values["awaited"] = self._others.unwell() or "none"
        if hindrance := self._pusher.hindrance():
            return Health(Level.WARN, f"the pusher cannot push: {hindrance}", values)
        if progress.phase == PlanProgress.PHASE_PUSHING and self._object.unseen:
            return Health(Level.WARN, "the object is not seen", values)
        return Health(Level.OK, progress.message or "starting", values)


def main() -> None:
    run_node(ExperimentNode)
