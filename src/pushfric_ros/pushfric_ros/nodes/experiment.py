"""The experiment node: carries out a push plan, push after push, with an operator who places the object."""

import enum
import itertools
import math
import time
import uuid
from collections.abc import Callable
from functools import partial
from typing import Any

from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rclpy.action import ActionClient
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import String
from std_srvs.srv import Trigger
from unique_identifier_msgs.msg import UUID

from pushfric_core.bags.samples import pose_sample_from_msg, pusher_sample_from_msg, stamp_from_msg
from pushfric_core.cell.node_settings import ExperimentConfig, FrameConfig, ObjectConfig, PlanConfig
from pushfric_core.errors import InvalidInput
from pushfric_core.estimation.push_plan import PlannedPush, number_of, placement, purpose_of
from pushfric_core.files.object_file import load_object
from pushfric_core.files.plan_file import load_plan
from pushfric_core.geometry.contact import PushingLine
from pushfric_core.geometry.frames import TABLE
from pushfric_core.geometry.planar import Pose, wrap
from pushfric_core.pushers.pusher import PusherFault
from pushfric_core.trajectories.trajectory import PoseSample, Trajectory
from pushfric_core.vision.sighting import NO_OBJECT
from pushfric_core.wording import counted
from pushfric_msgs.action import Push
from pushfric_msgs.msg import (
    CenterOfFrictionRegion,
    ContactFriction,
    EstimatorProgress,
    Observation,
    PlanProgress,
    PusherState,
)
from pushfric_msgs.srv import SelectPush
from pushfric_ros.messages.conversions import pose_to_msg
from pushfric_ros.node_kit import executable
from pushfric_ros.node_kit.diagnostics import NO_POSE, Awaited, Diagnostics, Figure, Health, Level
from pushfric_ros.node_kit.heartbeat import Heartbeat, Listener
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_QUEUE

NANOSECONDS = 1e9
BEFORE_SLIPS = 3  # pushes for p_CF, before every other one that is chosen is for mu_c
WITHDRAWN = 1e-3  # a pusher nearer than this to the beginning of its stroke need not be brought back [m]

STALL = 0.5
"""If this node stood still for longer, it could not hear anyone meanwhile [s of wall time]."""

ALARM_PATIENCE = 5.0
"""An alarm of the pusher that lasts this long ends a run that nobody attends; while it homes, one may come and go [s of wall
time]."""

PAUSES = {PusherFault.TIME.value, PusherFault.OWNER.value, PusherFault.NODES.value}
"""Why a pusher stopped when a process, this one included, or the controller stood still."""

REPEATS = 2
"""A push that a pause ended is repeated this often without asking."""

LAST_WORDS = 20.0
"""The node ends this long after its plan, even if a listener has not acknowledged what it last said, or the estimator has not
processed what it has seen [s of wall time]."""

REMEDY = "check that the camera gives new images, its calibration and time_offset, and line_origin"
IN_ALARM = "it is in alarm: mend what it reports, see that it is free to move, then press Reset"
WAS_STOPPED = "it was stopped: press Reset when it is free to move"

HINDRANCES = {
    PusherState.MODE_DISCONNECTED: "no controller answers: is it switched on, and plugged in?",
    PusherState.MODE_HOMING: "it seeks its home switch",
    PusherState.MODE_RUNNING: "",  # for a moment only
    PusherState.MODE_HOLD: "it is held, by its controller or until its actuator is active: press Reset when it is free to move",
    PusherState.MODE_ALARM: IN_ALARM,
}
"""Why a pusher in this mode cannot push, and what the operator can do about it."""


class Choice(enum.Enum):
    """A person's decision on a push: the names of the services, and why the push was given up."""

    REPEAT = "a person wants it repeated"
    SKIP = "a person skipped it"
    END = "a person ended the run"


class _Ended(Exception):
    """A person has ended the run while something was awaited."""


class ExperimentNode(Node):
    """Ends its process when the plan is finished."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("experiment", **kwargs)
        model = declare(self, ObjectConfig)
        self._begin = begin = declare(self, ExperimentConfig)
        self._config = declare(self, PlanConfig)
        self._object = load_object(model.object)
        self._plan = [] if self._config.choose else load_plan(self._config.plan, self._object)
        self._count = self._config.choose or len(self._plan)
        self._first = begin.start - 1
        if begin.start > self._count:
            where = f"{self.get_fully_qualified_name()}: parameter"
            raise InvalidInput(f"{where} start must be at most {self._count}, the pushes of the plan; got {begin.start}")
        self._region: CenterOfFrictionRegion | None = None
        self._mu_c = ContactFriction()
        self._settled = self._pushed = -1  # what the estimator has processed; when the last push ended [ns]
        self._newest = -1  # its newest observation [ns]
        self._observed = -1  # the push that this is of
        self._diagnostics = topics = Diagnostics(self, self._health, declare(self, FrameConfig).within(self.get_namespace()))
        self._heartbeat, self._life = Heartbeat(self), Listener(self)
        self._awaits_choice = False  # a push was aborted, and a person chooses what becomes of it
        self._blind = False  # the last push was stopped because the object was not seen
        self._choice: Choice | None = None  # what a person wants of the present push
        self._unwanted: list[int] = []  # aborted pushes whose observations the estimator must still leave out
        self._fault = ""  # why the pusher stopped
        self.create_service(Trigger, "~/withdraw", self._on_withdraw)
        for choice in Choice:
            self.create_service(Trigger, f"~/{choice.name.lower()}", partial(self._on_choice, choice))
        self._exclude, self._excluding = self.create_client(SelectPush, "estimator/exclude_push"), Future()
        self._excluding.set_result(None)
        self._placement_out = topics.advertise(PoseStamped, "placement", LATCHED)
        self._progress_out = topics.advertise(PlanProgress, "plan_progress", LATCHED)
        self._progress = PlanProgress(count=self._count, push_id=self._first)
        self._awaited = Awaited(self, self._config.awaits)
        self._no_pose = Figure(self, NO_POSE)
        self._action = ActionClient(self, Push, "push")
        self._pusher: PusherState | None = None
        self._checked = time.monotonic()  # when the condition was; this and the next in wall time [s]
        self._heard = self._seen = -math.inf  # when pusher and object were last seen
        self._idle_since: float | None = None
        self._offsets: dict[
            str, tuple[float, str]
        ] = {}  # by the source of stamps: how far they are ahead of this node's time [s], and the remedy
        self._following = self._followed()  # judges whether the poses of the present push are possible
        self._poses: list[tuple[int, Pose]] = []  # of the last `still` seconds [ns], and the last one before
        self._condition: tuple[Callable[[], bool], Future] | None = None
        topics.subscribe(PusherState, "pusher_state", self._on_pusher_state, RELIABLE)
        topics.subscribe(PoseWithCovarianceStamped, "object_pose", self._on_pose, SENSOR_QUEUE)
        self.create_subscription(String, "pusher_fault", self._on_fault, LATCHED)
        if self._config.choose:
            topics.subscribe(CenterOfFrictionRegion, "center_of_friction_region", self._on_region, LATCHED)
            topics.subscribe(ContactFriction, "contact_friction", self._on_contact_friction, LATCHED)
        # not a topic without which this node is unwell: a run may go without an estimator
        self._estimator = self.create_subscription(
            EstimatorProgress, "estimator_progress", self._on_estimator_progress, LATCHED
        )
        self.create_subscription(Observation, "observation", self._on_observation, RELIABLE)
        self.create_timer(0.05, self._check_condition)
        # in a group of its own, because the plan waits in this callback while other callbacks run
        self._start = self.create_timer(0.05, self._carry_out, callback_group=MutuallyExclusiveCallbackGroup())

    async def _carry_out(self) -> None:
        self._start.cancel()
        end = ""
        try:
            await self._carry_out_plan()
        except _Ended:
            end = "; ended by a person"
        progress = self._progress
        skipped = f", {progress.skipped} skipped" if progress.skipped else ""
        done = f"{progress.completed} of {counted(self._count, 'push', 'pushes')} done"
        self._report(PlanProgress.PHASE_FINISHED, f"{done}{skipped}{end}")
        deadline = time.monotonic() + LAST_WORDS
        at_once = Duration(seconds=0)  # a wait would hold up this node's heartbeat, and end as a hang

        def all_told() -> bool:
            # what leads the run must not end before the estimator has all that was seen of it
            estimated = self._settled >= self._pushed or not self._estimator.get_publisher_count()
            asked = not self._unwanted and self._excluding.done()
            return estimated and asked and self._progress_out.wait_for_all_acked(at_once)

        await self._until(lambda: all_told() or time.monotonic() > deadline)
        raise SystemExit(0)

    async def _carry_out_plan(self) -> None:
        await self._until_well(self._hindrance, PlanProgress.PHASE_WAITING, "waiting for the pusher")
        for index in range(self._first, self._count):
            self._progress.push_id = index
            push = await self._choose(index) if self._config.choose else self._plan[index]
            if push is None:
                self.get_logger().warning("the region of p_CF has collapsed: no push would shrink it")
                return
            self._progress.purpose = purpose_of(self._object.outline, push, bool(self._config.choose))
            await self._push(index, push)

    async def _push(self, index: int, push: PlannedPush) -> None:
        """Carry out a push, and again for as long as it is aborted and a person wants it repeated."""
        progress, again = self._progress, 0
        for push_id in itertools.count(index, self._count):
            progress.push_id, progress.in_place = push_id, False
            if self._choice is not Choice.END:
                self._choice = None
            problem = await self._withdraw() or await self._place_and_push(push_id, push)
            self._pushed = self.get_clock().now().nanoseconds
            if problem is None:
                progress.completed += 1
                return
            self.get_logger().warning(f"push {number_of(push_id, self._count)} aborted: {problem}")
            self._awaited.renew()
            self._unwanted.append(push_id)
            if again < REPEATS and self._choice is None and await self._stood_still():
                again += 1
                self.get_logger().warning(
                    f"push {number_of(push_id, self._count)} is repeated: the pusher rests where it should"
                )
                continue
            if self._choice is None and not self._begin.attended:
                progress.aborted += 1
                return
            if self._choice is None:
                await self._until_chosen(push_id, problem)
            if self._choice is Choice.END:
                raise _Ended
            if self._choice is Choice.SKIP:
                progress.skipped += 1
                return

    async def _until_chosen(self, push_id: int, problem: str) -> None:
        """Let a person choose what becomes of an aborted push, once the pusher can move again."""
        push = f"push {number_of(push_id, self._count)} of {self._count} was given up: {problem}"
        self._awaits_choice = True
        await self._until_well(self._hindrance_to_choice, PlanProgress.PHASE_WAITING, "waiting for the pusher")
        if self._choice is None:
            self._report(PlanProgress.PHASE_CHOOSING, f"{push}. Repeat it, skip it, or end the run?")
            await self._until(lambda: self._choice is not None)
        self._awaits_choice = False

    async def _stood_still(self) -> bool:
        """Whether the push was given up for a pause alone, of the computer or of the controller, and nothing is in doubt."""
        since = time.monotonic()

        def known() -> bool:
            another = self._fault not in ("", PusherFault.NONE.value, *PAUSES)
            return another or self._hindrance() in (None, IN_ALARM) or time.monotonic() - since > ALARM_PATIENCE

        await self._until(known)
        return self._hindrance() is None and self._fault in PAUSES

    def _hindrance_to_choice(self) -> str | None:
        return self._hindrance() if self._choice is None else None

    async def _withdraw(self) -> str | None:
        """Bring the pusher back from where an aborted push or an earlier run left it; return what went wrong, or None."""
        await self._until_well(self._hindrance, PlanProgress.PHASE_WAITING, "waiting for the pusher")
        assert self._pusher is not None
        if self._pusher.position <= WITHDRAWN:
            self._blind = False
            return None
        await self._others()
        await self._until_well(self._blindness, PlanProgress.PHASE_WAITING, "the pusher stays where it is")
        self._report(PlanProgress.PHASE_WAITING, "bringing the pusher back")
        back = Push.Goal(push_id=self._progress.push_id, distance=-self._pusher.position, speed=self._config.speed)
        problem = await self._carry(back)
        await self._until_well(self._hindrance, PlanProgress.PHASE_WAITING, "waiting for the pusher")
        return None if problem is None else f"the pusher could not be brought back: {problem}"

    async def _place_and_push(self, push_id: int, planned: PlannedPush) -> str | None:
        """Have the object placed, and push it; return what went wrong, or None."""
        push = f"push {number_of(push_id, self._count)} of {self._count}"
        assert self._pusher is not None
        line: PushingLine = pusher_sample_from_msg(self._pusher).line
        wanted = placement(self._object.outline, planned, line, self._pusher.position + self._config.gap)
        self._progress.placement = pose_to_msg(wanted)
        msg = PoseStamped(pose=self._progress.placement)
        msg.header.frame_id, msg.header.stamp = TABLE, self.get_clock().now().to_msg()
        self._poses.clear()
        self._placement_out.publish(msg)
        turned = 180 - (180 - round(math.degrees(wanted.theta))) % 360
        where = f"x {wanted.x * 1e3:.0f} mm, y {wanted.y * 1e3:.0f} mm, turned by {turned} degrees"
        prompt = f"{push}: place the object at {where}"

        def misplaced() -> str | None:
            return None if self._choice is not None else self._misplaced(wanted)

        while misplaced() is not None or self._unwell() is not None:
            await self._until_well(misplaced, PlanProgress.PHASE_PLACING, prompt)
            await self._others()
        if self._choice is not None:
            return self._choice.value
        self._progress.in_place = True
        await self._until_well(self._hindrance, PlanProgress.PHASE_WAITING, "waiting for the pusher")
        await self._until_well(self._foreign_clock, PlanProgress.PHASE_WAITING, "no push can be measured")
        await self._until_well(self._namesake, PlanProgress.PHASE_WAITING, "the messages may come from another cell")
        self._report(PlanProgress.PHASE_PUSHING, f"{push}: the pusher moves, leave the object alone")
        config = self._config
        carried = Push.Goal(push_id=push_id, distance=config.distance, speed=config.speed, retract=True)
        return await self._carry(carried) or await self._unobserved(push_id, push)

    async def _unobserved(self, push_id: int, push: str) -> str | None:
        """Why a push that reached its end is of no use: the estimator made no observation of it, and none is to come."""
        end = self.get_clock().now().nanoseconds

        def outstanding() -> str | None:
            estimates = self._estimator.get_publisher_count() and self._observed != push_id and self._choice is None
            if not estimates or self._settled >= end or self._unseen:
                return None
            return f"waiting for {self._unwell() or 'its observations'}"

        await self._until_well(outstanding, PlanProgress.PHASE_PUSHING, push)
        if self._choice is not None:
            return self._choice.value
        if self._observed == push_id or not self._estimator.get_publisher_count():
            return None
        return "no observation came from it" + "; the object is not seen" * self._unseen

    async def _others(self) -> None:
        """Wait for the other nodes. A node that reports OK receives the topics it needs, so it misses nothing of a push."""
        await self._until_well(self._unwell, PlanProgress.PHASE_WAITING, "waiting for")

    async def _choose(self, index: int) -> PlannedPush | None:
        """The next push, once the estimator has the whole last one; None if no push is of use.

        It is the one that shrinks the region of p_CF most; but from the fourth on, as long as mu_c has no value, every other
        push is one that slips.
        """

        def missing() -> str | None:
            known = self._region is not None and stamp_from_msg(self._region.header.stamp) == self._newest
            known = known and (index < BEFORE_SLIPS or stamp_from_msg(self._mu_c.header.stamp) == self._newest)
            if known and self._settled >= self._pushed:
                return None
            return self._foreign_clock() or "the region of p_CF"

        await self._until_well(missing, PlanProgress.PHASE_WAITING, "waiting for")
        assert self._region is not None
        shrink, slip = self._region.next_pushes[:1], []
        if index >= BEFORE_SLIPS and self._mu_c.kind in (ContactFriction.KIND_UNKNOWN, ContactFriction.KIND_BOUND):
            turn = (index - BEFORE_SLIPS) // 2
            slip = self._region.slip_pushes[turn : turn + 1]
        chosen = [*slip, *shrink] if (index - BEFORE_SLIPS) % 2 == 0 else [*shrink, *slip]
        return next((PlannedPush(one.edge, one.offset, one.angle) for one in chosen), None)

    async def _carry(self, goal: Push.Goal) -> str | None:
        """Have the pusher carry out a goal, and own it meanwhile; return what went wrong, or None."""
        owned = uuid.uuid4().bytes
        self._heartbeat.own(owned)
        problem = await self._owned(goal, owned)
        self._heartbeat.own(None)
        return problem

    async def _owned(self, goal: Push.Goal, owned: bytes) -> str | None:
        answered = self._action.send_goal_async(goal, self._on_feedback, UUID(uuid=list(owned)))
        self._idle_since = None
        forgotten: list[str] = []  # how it has shown that it forgot the goal, when this struck
        stopped: list[str] = []  # for this reason

        def strikes(reasons: list[str], reason: str | None) -> bool:
            reasons.extend(filter(None, [reason]))
            return bool(reasons)

        await self._until(lambda: answered.done() or strikes(forgotten, self._forgotten))
        if not answered.done():
            return f"the pusher does not answer: {forgotten[0]}"
        handle = answered.result()
        if not handle.accepted:
            return "the pusher refused it"
        result = handle.get_result_async()
        self._idle_since = None
        self._following = self._followed()
        forgotten.clear()

        def over() -> bool:
            return result.done() or strikes(forgotten, self._forgotten)

        await self._until(lambda: over() or strikes(stopped, self._reason_to_stop()))
        if stopped:
            self._blind = self._unseen
            handle.cancel_goal_async()
            await self._until(over)
        if not result.done():
            return f"the pusher forgot it: {forgotten[0]}"
        if result.result().status == GoalStatus.STATUS_SUCCEEDED:
            return None
        return stopped[0] if stopped else str(result.result().result.message)

    def _on_feedback(self, _: Push.Impl.FeedbackMessage) -> None:
        self._idle_since = None  # the actuator has the goal, though it may wait for signs of life

    def _blindness(self) -> str | None:
        """Why the pusher is not brought back yet: nobody knows what it would do to an object that is not seen."""
        if not self._blind or not self._unseen:
            self._blind = False
            return None
        return "the object is not seen; let the camera see it, or press Skip to bring the pusher back"

    def _on_withdraw(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """A person says that the pusher may be brought back though the object is not seen."""
        response.success, self._blind = self._blind, False
        response.message = "bringing the pusher back" if response.success else "the pusher is not waiting to be brought back"
        return response

    def _on_choice(self, choice: Choice, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """A person wants the push repeated or skipped, or the run ended."""
        push = f"push {number_of(self._progress.push_id, self._count)}"
        if choice is Choice.SKIP and self._blind and not self._awaits_choice:
            return self._on_withdraw(_, response)
        under_way = self._progress.phase in (PlanProgress.PHASE_PLACING, PlanProgress.PHASE_PUSHING)
        response.success = {
            Choice.REPEAT: self._awaits_choice,
            Choice.SKIP: self._awaits_choice or under_way,
            Choice.END: self._progress.phase != PlanProgress.PHASE_FINISHED,
        }[choice]
        if response.success:
            self._choice = choice
            done = {Choice.REPEAT: f"{push} is repeated", Choice.SKIP: f"{push} is skipped", Choice.END: "the run ends"}
            response.message = done[choice]
        else:
            response.message = f"no push to {choice.name.lower()}: {self._progress.message or 'starting'}"
        return response

    def _on_fault(self, msg: String) -> None:
        self._fault = msg.data

    def _leave_out(self) -> None:
        """Have the estimator leave out what it made of aborted pushes, once it has made all of it."""
        if not self._unwanted or not self._excluding.done() or not self._estimator.get_publisher_count():
            return
        if self._settled >= self._pushed and self._exclude.service_is_ready():
            # the estimator refuses if nothing was observed of the push, which is as well
            self._excluding = self._exclude.call_async(SelectPush.Request(push_id=self._unwanted.pop()))

    def _report(self, phase: int, message: str) -> None:
        progress = self._progress
        progress.phase, progress.message, progress.details = phase, message, self._details(phase)
        self._progress.header.stamp = self.get_clock().now().to_msg()
        self._progress_out.publish(self._progress)
        self.get_logger().info(message)

    def _details(self, phase: int) -> str:
        """The services that answer a prompt of this phase, and the pusher's fault."""
        services = {
            PlanProgress.PHASE_PLACING: "experiment/skip, experiment/end",
            PlanProgress.PHASE_CHOOSING: "experiment/repeat, experiment/skip, experiment/end",
            PlanProgress.PHASE_ALARM: "actuator/reset",
        }.get(phase, "experiment/withdraw" if self._blind else "actuator/reset" if self._was_stopped else "")
        fault = "" if self._fault in ("", PusherFault.NONE.value) else f"fault: {self._fault}"
        return "; ".join(filter(None, (services and f"services: {services}", fault)))

    async def _until_well(self, problem: Callable[[], str | None], phase: int, prompt: str) -> None:
        """Tell the operator about a problem, whenever it changes, until there is none."""

        def changed() -> bool:
            return problem() != said

        def given_up() -> bool:
            return said == IN_ALARM and not self._begin.attended and time.monotonic() - since > ALARM_PATIENCE

        if self._choice is Choice.END:
            raise _Ended
        since = 0.0
        while (said := problem()) is not None:
            phase_now = PlanProgress.PHASE_ALARM if said == IN_ALARM else phase
            self._report(phase_now, f"{prompt}: {said}" if said else prompt)
            since = time.monotonic()
            await self._until(lambda: changed() or given_up() or self._choice is Choice.END)
            if self._choice is Choice.END:
                raise _Ended
            if given_up() and not changed():
                raise SystemExit(f"{self._progress.message}; nobody is here to do that")

    def _until(self, condition: Callable[[], bool]) -> Future:
        """A future that is done once a condition holds, which is checked 20 times a second."""
        future: Future = Future()
        self._condition = (condition, future)
        return future

    def _check_condition(self) -> None:
        self._leave_out()
        now = time.monotonic()
        if (stood_still := now - self._checked) > STALL:
            self._heard, self._seen = (min(now, then + stood_still) for then in (self._heard, self._seen))
            self._idle_since = self._idle_since and min(now, self._idle_since + stood_still)
        self._checked = now
        if self._condition is not None and self._condition[0]():
            future, self._condition = self._condition[1], None
            future.set_result(None)

    def _unwell(self) -> str | None:
        """The nodes that have not reported OK yet, or whose heartbeat has stopped; None if there is none."""
        self._life.look()
        signs = {name: self._life.node(name) for name in self._config.awaits}
        lifeless = {name for name, sign in signs.items() if sign is not None and sign.age > self._begin.lifeless}
        return ", ".join(sorted(lifeless.union(self._awaited.missing))) or None

    def _hindrance(self) -> str | None:
        """Why the pusher cannot move; None if it can."""
        if self._pusher is None or self._silent:
            return "it does not report"
        if self._was_stopped:
            return WAS_STOPPED
        if self._pusher.mode != PusherState.MODE_IDLE:
            return HINDRANCES[self._pusher.mode]
        return None if self._action.server_is_ready() else "its action server is not available"

    @property
    def _was_stopped(self) -> bool:
        held = self._pusher is not None and self._pusher.mode == PusherState.MODE_HOLD
        return held and self._fault == PusherFault.STOPPED.value

    @property
    def _silent(self) -> bool:
        return time.monotonic() - self._heard > self._config.lost_result

    @property
    def _forgotten(self) -> str:
        """How the pusher has shown that it forgot its goal: it idles, or it does not report at all; empty: it has not."""
        now, limit = time.monotonic(), self._config.lost_result
        if self._silent:
            return f"its last report came {now - self._heard:.1f} s ago; lost_result is {limit:g} s"
        if self._idle_since is not None and now - self._idle_since > limit:
            return f"it has reported for {now - self._idle_since:.1f} s that it idles; lost_result is {limit:g} s"
        return ""

    @property
    def _unseen(self) -> bool:
        return time.monotonic() - self._seen > self._config.lost_object

    def _followed(self) -> Trajectory:
        return Trajectory(self._object.outline, tolerance=self._config.follow_tolerance)

    def _reason_to_stop(self) -> str | None:
        """Why the pusher must not go on forward; None if it may."""
        if self._pusher is None or self._pusher.push_id == PusherState.NO_PUSH:
            return None
        if self._choice is not None:
            return self._choice.value
        if self._unseen:
            ago = time.monotonic() - self._seen
            return f"the object was not seen for {ago:.2f} s; lost_object is {self._config.lost_object:g} s"
        contradiction = self._following.contradiction
        return contradiction and f"{contradiction}; {REMEDY}"

    def _foreign_clock(self) -> str | None:
        """Which stamps differ from this node's time, by how much, and what to do; None if all agree."""
        for whose, (offset, remedy) in self._offsets.items():
            if abs(offset) > self._config.clock_tolerance:
                way = "ahead of" if offset > 0 else "behind"
                return f"the clock of {whose} is {abs(offset):.0f} s {way} this computer's: {remedy}"
        return None

    def _namesake(self) -> str | None:
        """Whether another cell or node has a name that is used here; on another computer, no lock keeps it from starting."""
        if self._life.twins:
            return f"two nodes named {self._life.twins[0]} are running on this ROS domain: end one of them"
        plans = self.get_publishers_info_by_topic(self._progress_out.topic_name)
        if len(plans) < 2:
            return None
        return f"another cell named {self.get_namespace()} is running on this ROS domain: end it, or rename one of the two"

    def _misplaced(self, wanted: Pose) -> str | None:
        """The fault of the placement; None once the object lies still in its place."""
        if not self._poses or self._unseen:
            self._progress.in_place = False
            why = self._no_pose.text
            if why == NO_OBJECT:  # this needs no explanation
                why = ""
            return why if not self._poses else ": ".join(filter(None, ("it is not seen", why)))
        last = self._poses[-1][1]
        off, turn = math.hypot(last.x - wanted.x, last.y - wanted.y), wrap(wanted.theta - last.theta)
        self._progress.in_place = off <= self._config.position_tolerance and abs(turn) <= self._config.angle_tolerance
        faults = []
        if off > self._config.position_tolerance:
            faults.append(f"move it by about {10 * round(100 * off)} mm")
        if abs(turn) > self._config.angle_tolerance:
            way = "counter-clockwise" if turn > 0 else "clockwise"
            faults.append(f"turn it {way} by about {10 * round(math.degrees(abs(turn)) / 10)} degrees")
        if faults:
            return " and ".join(faults)
        still = all(
            math.hypot(p.x - last.x, p.y - last.y) + 0.1 * abs(wrap(p.theta - last.theta)) < 2 * self._config.still_distance
            for _, p in self._poses
        )
        long_enough = self._poses[-1][0] - self._poses[0][0] >= int(self._config.still * NANOSECONDS)
        return None if still and long_enough else "let it lie still"

    def _compare_clock(self, whose: str, stamp: int, remedy: str) -> None:
        now = self.get_clock().now().nanoseconds
        if now:  # simulated time has begun
            self._offsets[whose] = (stamp - now) / NANOSECONDS, remedy

    def _on_pusher_state(self, msg: PusherState) -> None:
        try:
            sample = pusher_sample_from_msg(msg)
        except ValueError as error:
            self.get_logger().error(f"pusher_state refused: {error}", once=True)
            return
        self._following.add_pusher(sample)
        self._compare_clock("the pusher", sample.stamp, "set the clocks of both computers, for example by NTP")
        self._pusher, self._heard = msg, time.monotonic()
        if msg.mode != PusherState.MODE_IDLE or msg.push_id != PusherState.NO_PUSH:
            self._idle_since = None
        elif self._idle_since is None:
            self._idle_since = time.monotonic()

    def _health(self) -> Health:
        progress = self._progress
        values = {
            "push": number_of(progress.push_id, progress.count),
            "pushes": progress.count,
            "completed": progress.completed,
            "aborted": progress.aborted,
            "skipped": progress.skipped,
            "awaited": self._unwell() or "none",
        }
        hindrance = self._hindrance()
        if hindrance:
            return Health(Level.WARN, f"the pusher cannot push: {hindrance}", values)
        if progress.phase == PlanProgress.PHASE_PUSHING and self._unseen:
            return Health(Level.WARN, "the object is not seen", values)
        return Health(Level.OK, progress.message or "starting", values)

    def _on_estimator_progress(self, msg: EstimatorProgress) -> None:
        self._settled, self._newest = stamp_from_msg(msg.settled_until), stamp_from_msg(msg.header.stamp)

    def _on_observation(self, msg: Observation) -> None:
        self._observed = msg.push_id

    def _on_region(self, msg: CenterOfFrictionRegion) -> None:
        self._region = msg

    def _on_contact_friction(self, msg: ContactFriction) -> None:
        self._mu_c = msg

    def _on_pose(self, msg: PoseWithCovarianceStamped) -> None:
        try:
            stamp, pose = pose_sample_from_msg(msg)
        except ValueError as error:
            self.get_logger().error(f"object_pose refused: {error}", once=True)
            return
        self._following.add_pose(PoseSample(stamp, pose))
        self._compare_clock("the camera", stamp, "set it, for example by NTP, or give the difference as time_offset")
        self._seen = time.monotonic()
        kept = [(t, p) for t, p in self._poses if t < stamp] + [(stamp, pose)]
        # the last pose before that time stays, however few frames come
        before = sum(t <= stamp - int(self._config.still * NANOSECONDS) for t, _ in kept)
        self._poses = kept[max(before - 1, 0) :]


def main() -> None:
    run_node(ExperimentNode)


if __name__ == "__main__":
    executable.main()
