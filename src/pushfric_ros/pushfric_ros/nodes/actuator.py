"""The actuator node: the push action, and the state of the pusher; a managed node.

    unconfigured --configure--> inactive --activate--> active --deactivate--> inactive --cleanup--> unconfigured

Unconfigured, the node does not touch the port. Inactive, it connects to the controller, and again whenever the connection is
lost, but moves nothing. Active, it accepts goals. It takes the first two steps by itself unless `autostart` is false.

What it may do, and what follows each event, stands in the table `states.ACTUATOR`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from geometry_msgs.msg import Point, Vector3, WrenchStamped
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.clock import Clock, ClockType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.task import Future
from std_msgs.msg import Bool, Empty, String
from std_srvs.srv import Trigger

from pushfric_core.cell.node_settings import FrameConfig
from pushfric_core.errors import InvalidInput
from pushfric_core.geometry.contact import pushing_line
from pushfric_core.geometry.frames import TABLE
from pushfric_core.plugins import PUSHERS, plugin
from pushfric_core.pushers.clock import clock
from pushfric_core.pushers.position_memory import PositionMemory
from pushfric_core.pushers.pusher import (
    POLL_PERIOD,
    Mode,
    NotConnected,
    Pusher,
    PusherConfig,
    PusherDriver,
    PusherError,
    PusherFault,
    PusherReport,
)
from pushfric_core.pushers.states import (
    ACTUATOR,
    READY,
    UNDER_WAY,
    Action,
    Controller,
    Enable,
    Event,
    Hold,
    Homing,
    Life,
    Needs,
    Position,
    Task,
    Way,
    at_first,
    step,
)
from pushfric_core.pushers.stroke import unevenness
from pushfric_msgs.action import Push
from pushfric_msgs.msg import PusherState
from pushfric_ros.messages.conversions import stamp_to_msg
from pushfric_ros.node_kit import executable
from pushfric_ros.node_kit.diagnostics import Diagnostics, Health, Level
from pushfric_ros.node_kit.heartbeat import Listener
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.process import URGENT, run_node
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_DATA
from pushfric_ros.node_kit.stop_button import StopButton

FIRST_RETRY, LAST_RETRY = 0.1, 5.0  # [s], as all below
FORCE_SILENCE = 0.5
DISK = 3.0  # a push waits this long for the disk
GRACE = 3.0  # a port may appear this late without an error message; simulated time begins once a simulated port is there
ROUNDING = 1e-5  # tolerance of positions [m]
UNEVEN = 0.05  # a speed that varies by more than this is worth a note; a share of the mean
KEPT = 1e-4  # a controller that kept its position while disconnected reports it this exactly [m]
STOPPED = "stopped: nothing moves until a reset"
UNKNOWN = "where the pusher stands is not known: "
REMEDIES = {
    False: UNKNOWN + "bring it to its home end, restart the controller, then reset",
    True: UNKNOWN + "see that it is free to move, then reset, which homes",
}
"""The remedy of a person; the key says whether the cell homes."""


@dataclass
class UnderWay:
    """A push, from its acceptance until its client has been told how it ended."""

    goal: ServerGoalHandle
    accepted: float  # when [s]
    start: float  # of the stroke [m]
    end: Future  # its result, but for the outcome
    course: list[PusherReport] = field(default_factory=list)  # reports of the stroke
    travelled: float | None = None  # once the way back has begun [m]
    why: str | None = None  # it was ended before its time


class ActuatorNode(LifecycleNode):
    """Serves `push`, one goal at a time, while it knows where the pusher stands.

    The position is unknown before homing, if homing is configured; after an alarm; and after a connection was lost during a
    motion or came back at another position. Then `~/reset` homes, or confirms the reported position. A lost connection is
    restored without a motion.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("actuator", **kwargs)
        self._config = config = declare(self, PusherConfig)
        try:
            driver: PusherDriver = declare(self, plugin(PUSHERS, config.driver))
            self._pusher: Pusher = driver.open_pusher(config)
        except ValueError as error:
            raise InvalidInput(f"{self.get_fully_qualified_name()}: {error}") from error
        self._line = pushing_line(config.line_origin, config.line_direction, config.tip_radius)
        self._state = at_first(config.home)
        self._needs = Needs.MISSING  # as last checked
        self._start_due = config.autostart
        self._report = PusherReport(0.0, 0.0, Mode.DISCONNECTED, None)  # the last one
        self._reported = clock()  # when it came
        self._problem: PusherError | None = None
        self._lost_at: float | None = None  # where it rested when the connection was lost; NaN: it did not rest
        self._retry_at, self._retry_after = 0.0, FIRST_RETRY
        self._quiet_until = math.inf  # set when time has begun
        self._told: str | None = None  # the last problem logged
        self._fault = PusherFault.NONE
        self._held = ""  # why nothing moves until a reset, if it is held
        self._enabled = self._forced = -math.inf  # when enable was last true, and a force measured; in wall time [s]
        self._memory: PositionMemory | None = None  # of the pusher that is connected, or was last
        self._push: UnderWay | None = None  # until its client is told
        self._diagnostics = Diagnostics(self, self._health, declare(self, FrameConfig).within(self.get_namespace()))
        self._state_out = self._diagnostics.advertise(PusherState, "pusher_state", RELIABLE)
        self._newest_stamp = 0  # of the states that were published [ns]
        self._told_fault: PusherFault | None = None
        self._polled, self._gap = clock(), 0.0  # when the pusher was last polled; how long before that
        self._fault_out = self._diagnostics.advertise(String, "pusher_fault", LATCHED)
        callbacks = {"goal_callback": self._on_goal, "cancel_callback": self._on_cancel}
        self._server = ActionServer(self, Push, "push", self._execute, handle_accepted_callback=self._on_accepted, **callbacks)
        self._life, self._button = Listener(self), StopButton(self.get_namespace())
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(Trigger, "~/stop", self._on_stop)
        self.create_subscription(Empty, "stop", lambda _: self._halt(), RELIABLE)
        if config.enable_timeout:
            self.create_subscription(Bool, "enable", self._on_enable, RELIABLE)
        if config.max_force:
            self._diagnostics.subscribe(WrenchStamped, "wrench", self._on_wrench, SENSOR_DATA)
        self.create_timer(1 / config.poll_rate, self._ask)
        # bytes come in real time, whatever the cell's clock
        self.create_timer(POLL_PERIOD, self._poll, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._service_change_state.callback = self._refuse_unknown(self._service_change_state.callback)
        if self._start_due:
            self.trigger_configure()

    def wind_up(self) -> bool:
        """Stop the pusher, tell the client and publish the state at rest; True once all of this is done."""
        self._start_due = False
        if Life.ACTIVE in self._state:
            self._revoke(Event.DEACTIVATE, PusherFault.STOPPED, "the actuator was told to end")
        if self._push is not None or (self._pusher.busy and self._pusher.mode is not Mode.DISCONNECTED):
            return False
        self._publish(self._report._replace(speed=0.0, mode=self._pusher.mode, stamp=None))
        return True

    def destroy_node(self) -> None:
        """Stop the pusher before anything else ends."""
        self._pusher.close()
        self._settle(DISK)
        self._button.close()
        self._server.destroy()
        super().destroy_node()

    # Transitions

    def _refuse_unknown(self, change_state: Callable) -> Callable:
        """Refuse transitions that the present state does not have; in rclpy they would end the node."""

        def changed(request: Any, response: Any) -> Any:
            self._start_due = False  # somebody else decides from now on
            try:
                return change_state(request, response)
            except rclpy_implementation.RCLError:
                wanted = request.transition.label or request.transition.id
                self.get_logger().warning(f"no transition {wanted} from the state {self._lifecycle_state}")
                response.success = False
                return response

        return changed

    @property
    def _lifecycle_state(self) -> str:
        return str(self._state_machine.current_state[1])

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Connect to the controller from now on, as soon as its port exists."""
        self._on(Event.CONFIGURE)
        self._retry_at, self._retry_after = 0.0, FIRST_RETRY
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Accept goals, after homing if it is configured and still due. Refused until the controller has answered."""
        if not self._on(Event.ACTIVATE):
            self.get_logger().error(f"cannot be activated yet: {self._problem or 'the controller is being connected'}")
            self._on(Event.DEACTIVATE)
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop a motion, and accept no more goals."""
        self._revoke(Event.DEACTIVATE, PusherFault.STOPPED, "the actuator was deactivated")
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave the port."""
        self._leave("the actuator was told to leave its port")
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop a motion and leave the port, for good."""
        self._leave("the actuator was shut down")
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """A transition raised an exception: leave the port, which is the safe state."""
        self.get_logger().error("a transition failed; the pusher is left")
        self._leave("a transition failed")
        return TransitionCallbackReturn.SUCCESS

    @property
    def _not_active(self) -> str:
        return f"the actuator is {self._lifecycle_state}, expected active"

    # What happens, and what follows

    def _on(self, event: Event) -> bool:
        """Do what the table says of an event. False: it is refused, or what it asks for has failed."""
        following = step(ACTUATOR, self._state, event, self._facts())
        if following is None:
            return False
        self._state = following.state
        for action in following.actions:
            try:
                self._do(action)
            except PusherError as error:
                self._fail(error)
                return False
        return True

    def _facts(self) -> tuple[Enum, ...]:
        returns = self._push is not None and self._push.goal.request.retract
        return (
            Homing.HOMES if self._config.home else Homing.UNLOCKS,
            Enable.ENABLED if self._disabled is None else Enable.DISABLED,
            self._needs,
            Controller.IDLE if self._pusher.mode is Mode.IDLE else Controller.NOT_IDLE,
            Way.RETURNS if returns else Way.ONE_WAY,
        )

    def _do(self, action: Enum) -> None:
        """Raises PusherError."""
        match action:
            case Action.MOVE | Action.RETRACT:
                self._move(back=action is Action.RETRACT)
            case Action.BRAKE:
                self._pusher.stop()
            case Action.RECOVER:
                self._pusher.recover()
            case Action.LEAVE:
                self._pusher.close()
            case Action.CLEAR:
                self._problem, self._fault = None, PusherFault.NONE
            case Action.TELL:
                self._tell()

    def _move(self, back: bool) -> None:
        assert self._push is not None
        push, config = self._push.goal.request, self._config
        if back:
            self._push.travelled = self._travelled(self._push)
            self._pusher.move_to(self._push.start, min(config.retract_speed, config.max_speed))
        else:
            self._pusher.move_to(self._push.start + push.distance, push.speed)

    def _tell(self) -> None:
        """The push has ended: its client is told."""
        assert self._push is not None
        push = self._push
        uneven = unevenness(push.course, push.start, push.start + push.goal.request.distance)
        note = f", unevenly: its speed varied by {100 * uneven:.0f} %" if uneven > UNEVEN else ""
        push.end.set_result(Push.Result(travelled=self._travelled(push), message=push.why or f"reached{note}"))

    def _travelled(self, push: UnderWay) -> float:
        return self._report.position - push.start if push.travelled is None else push.travelled

    def _revoke(self, event: Event, fault: PusherFault, why: str) -> None:
        """Let an event end any motion; a push under way is aborted with this reason."""
        self._blame(fault, why)
        self._on(event)

    def _blame(self, fault: PusherFault, why: str) -> None:
        """The reason for what ends a push under way, if it has none yet."""
        if self._push is not None and self._push.why is None and self._state & UNDER_WAY:
            self._push.why, self._fault = why, fault

    def _halt(self, fault: PusherFault = PusherFault.STOPPED, why: str = "somebody asked for a stop") -> None:
        """Stop any motion, and move nothing until somebody calls reset."""
        self._held, self._fault = why, fault
        self.get_logger().warning(f"{why}: nothing moves until a reset")
        self._revoke(Event.STOP, fault, why)

    def _leave(self, why: str) -> None:
        self._blame(PusherFault.STOPPED, why)
        self._lose(Event.LEAVE)

    # The pusher

    def _ask(self) -> None:
        """Request a report at each tick of the cell's clock; if none can come, publish the known state."""
        mode = self._pusher.mode
        if mode in (Mode.DISCONNECTED, Mode.HOMING):
            self._publish(self._report._replace(speed=0.0, mode=mode, stamp=None))
            return
        try:
            self._pusher.ask(self.get_clock().now().nanoseconds)
        except PusherError as error:
            self._fail(error)

    def _check(self, now: float) -> None:
        """Let a motion begin, or go on, only while it has all that it needs."""
        if self._push is not None and self._state & {Task.WAITING, Task.PUSHING, Task.RETRACTING}:
            missing = self._missing(self._push, now)
            self._needs = Needs.MET if missing is None else missing[0]
            if (disabled := self._disabled) is not None:
                self._blame(PusherFault.DISABLED, disabled)
            elif missing is not None and missing[0] is Needs.MISSING:
                self._blame(*missing[1:])
        self._on(Event.CHECKED)

    def _missing(self, push: UnderWay, now: float) -> tuple[Needs, PusherFault, str] | None:
        """The first thing that a push needs and does not have; None if it has all."""
        config, lasted = self._config, now - push.accepted
        if lasted > config.max_time:
            why = f"the push took {lasted:.1f} s, more than max_time {config.max_time:g} s"
            return Needs.MISSING, PusherFault.TIME, why
        if Task.WAITING in self._state and self._memory is not None and not self._memory.settled:
            why = f"the disk took {lasted:.1f} s to keep that the pusher moves"
            return Needs.AWAITED if lasted < DISK else Needs.MISSING, PusherFault.TIME, why
        if config.max_force and (unmeasured := now - self._forced) > FORCE_SILENCE:
            how_long = "yet" if math.isinf(unmeasured) else f"for {unmeasured:.2f} s, the limit is {FORCE_SILENCE:g} s"
            return Needs.MISSING, PusherFault.FORCE, f"no force was measured {how_long}"
        if (lifeless := self._lifeless(bytes(push.goal.goal_id.uuid), lasted)) is not None:
            awaited = Task.WAITING in self._state and lasted < config.grace
            return Needs.AWAITED if awaited else Needs.MISSING, *lifeless
        return None

    @property
    def _disabled(self) -> str | None:
        """Why nothing may move, as far as the topic enable says; None if it may."""
        ago, limit = clock() - self._enabled, self._config.enable_timeout
        if not limit or ago <= limit:
            return None
        if math.isinf(ago):
            return "the topic enable does not say true"
        return f"the topic enable said true {ago:.2f} s ago; enable_timeout is {limit:g} s"

    def _lifeless(self, goal: bytes, lasted: float) -> tuple[PusherFault, str] | None:
        """Who shows no sign of life, of those that a goal needs: the fault, and what was measured; None if all of them live."""
        config = self._config
        self._life.look()
        needed = [(PusherFault.OWNER, "its client", self._life.owner(goal), "owner_timeout")] if config.owner_timeout else []
        needed += [(PusherFault.NODES, name, self._life.node(name), "requires_timeout") for name in config.requires]
        for fault, who, sign, setting in needed:
            limit: float = getattr(config, setting)
            if sign is None:
                how = "; docs/graph.md says how, or set owner_timeout to 0" if fault is PusherFault.OWNER else ""
                return fault, f"{who} published no heartbeat in {lasted:.2f} s, expected one within {config.grace:g} s{how}"
            # the client must be able to cancel; a node that is only needed may have much to do
            if (sign.idle if fault is PusherFault.OWNER else sign.age) > limit:
                own = f"; the actuator itself stood still for {self._gap:.2f} s" if self._gap > limit / 2 else ""
                return fault, f"{who} shows no sign of life: its {sign}; {setting} is {limit:g} s{own}"
        return None

    def _on_enable(self, msg: Bool) -> None:
        self._enabled = clock() if msg.data else -math.inf

    def _on_wrench(self, msg: WrenchStamped) -> None:
        force = math.hypot(msg.wrench.force.x, msg.wrench.force.y, msg.wrench.force.z)
        if math.isfinite(force):
            self._forced = clock()
        if force > self._config.max_force and self._state & UNDER_WAY and Hold.FREE in self._state:
            self._halt(PusherFault.FORCE, f"the force was {force:.1f} N, more than max_force {self._config.max_force:g} N")

    def _remember(self, moves: bool = False) -> None:
        """Keep what is known of the position for the next process."""
        report = self._report
        if self._memory is None or (report.mode is Mode.DISCONNECTED and not moves):
            return
        rests = not moves and Position.KNOWN in self._state and not self._state & UNDER_WAY
        rests = rests and report.mode is Mode.IDLE and report.speed == 0
        self._memory.keep(report.position if rests else math.nan)
        self._settle(0.0)

    def _settle(self, seconds: float) -> None:
        """Wait for the disk, at most so long, and say once if it refuses."""
        if self._memory is not None and (problem := self._memory.settle(seconds)) is not None:
            self.get_logger().warning(f"the pusher's position is not kept: {problem}", once=True)

    def _poll(self) -> None:
        if (who := self._button.pressed()) is not None:
            self._halt()
            self._button.answer(who, STOPPED)
        if Life.UNCONFIGURED in self._state:
            return
        now, pusher = clock(), self._pusher
        self._gap, self._polled = now - self._polled, now
        if moves := self._push is not None or Task.RECOVERING in self._state:
            self._check(now)
        if math.isinf(self._quiet_until) and self.get_clock().now().nanoseconds:
            self._quiet_until = clock() + GRACE
        try:
            if pusher.mode is Mode.DISCONNECTED and not pusher.busy:
                if clock() < self._retry_at:
                    return
                pusher.connect()
            report = pusher.poll(self.get_clock().now().nanoseconds)
        except PusherError as error:
            self._fail(error)
            return
        if report is not None and report.mode is not Mode.DISCONNECTED:
            self._take(report)
        if pusher.busy:
            return
        if moves:
            self._on(Event.RESTED)
        if self._start_due and Task.NONE in self._state:
            self._start_due = False
            self.trigger_activate()

    def _take(self, report: PusherReport) -> None:
        if self._report.mode is Mode.DISCONNECTED:
            self._on_connected(report)
        self._report, self._reported = report, clock()
        self._publish(report)
        self._remember()
        if (push := self._push) is not None and self._state & UNDER_WAY:  # also while it waits: its client is not forgotten
            if Task.PUSHING in self._state:
                push.course.append(report)
            push.goal.publish_feedback(Push.Feedback(travelled=self._travelled(push), speed=report.speed))

    def _on_connected(self, report: PusherReport) -> None:
        self.get_logger().info(f"connected to {self._pusher.name}")
        self._recall()
        # before it has homed, its positions count from wherever it stood when it was switched on
        counted_from_home = Position.KNOWN in self._state or not self._config.home
        found = None
        if self._lost_at is not None and (
            math.isnan(self._lost_at) or (counted_from_home and abs(report.position - self._lost_at) > KEPT)
        ):
            before = "not idle" if math.isnan(self._lost_at) else f"at {self._lost_at:.4f} m"
            found = f"{before} when the connection was lost, said to be at {report.position:.4f} m now"
        if isinstance(self._problem, NotConnected):
            self._problem = None
        self._on(Event.CONNECTED)
        for what in (found, self._pusher.doubt):
            if what is not None:
                self._on(Event.MISPLACED)
                self.get_logger().error(f"{what}: {REMEDIES[self._config.home]}")
        if self._pusher.mode is Mode.ALARM:
            self._on(Event.UNSURE)
        self._lost_at, self._told, self._retry_after = None, None, FIRST_RETRY
        self._quiet_until = 0.0

    def _recall(self) -> None:
        """Find out what was kept about the pusher that is connected now."""
        before, place = self._memory, self._pusher.place
        if before is not None and before.place == place:
            return
        self._memory = PositionMemory(self._config.memory, place)
        if before is None:
            self._lost_at = self._memory.recall()
            if self._config.memory and place.startswith("/"):
                self.get_logger().info(f"{place} has no serial number: where it rests is kept by this path")
        elif not place.startswith("/"):
            self._lost_at = math.nan  # another one

    def _fail(self, error: PusherError) -> None:
        """End what is under way, log the error once, and connect again later if the connection is lost."""
        lost = self._pusher.mode is Mode.DISCONNECTED
        self._blame(error.fault, str(error))
        self._problem, self._fault = error, error.fault
        if not lost or (str(error) != self._told and clock() >= self._quiet_until):
            self.get_logger().error(f"{error}, retrying" if lost else str(error))
            self._told = str(error)
        if lost:
            self._lose(Event.LOST)
            self._retry_at = clock() + self._retry_after
            self._retry_after = min(2 * self._retry_after, LAST_RETRY)
        else:  # the controller may be silent for a while now
            self._on(Event.FAILED)
            if self._pusher.mode is Mode.ALARM or self._pusher.doubt is not None:
                self._on(Event.UNSURE)
            # the stamp is that of the report: the pusher may have gone on since
            self._publish(self._report._replace(speed=0.0, mode=self._pusher.mode))

    def _lose(self, event: Event) -> None:
        """The connection is lost; remember where the pusher rested."""
        if self._report.mode is not Mode.DISCONNECTED:
            rests = self._report.mode is Mode.IDLE and not self._state & UNDER_WAY
            self._lost_at = self._report.position if rests else math.nan
        self._report = self._report._replace(speed=0.0, mode=Mode.DISCONNECTED)
        self._on(event)

    def _shown(self, mode: Mode) -> Mode:
        """The mode as others see it: idle means ready to move."""
        if mode not in (Mode.IDLE, Mode.HOLD) or (mode is Mode.IDLE and self._state >= READY):
            return mode
        return Mode.ALARM if self._lost_track else Mode.HOLD

    @property
    def _push_id(self) -> int:
        """Number of the push that moves forward now."""
        if self._push is None or Task.PUSHING not in self._state or self._push.goal.request.distance < 0:
            return PusherState.NO_PUSH
        return int(self._push.goal.request.push_id)

    @property
    def _lost_track(self) -> bool:
        """Whether only a person can say where the pusher stands, or homing."""
        return Life.ACTIVE in self._state and Position.KNOWN not in self._state

    def _explained(self, mode: Mode) -> str:
        """A mode, what went wrong, and what to do about it; for people."""
        remedy = REMEDIES[self._config.home] if mode is Mode.ALARM and self._lost_track else None
        if mode is Mode.HOLD and Hold.HELD in self._state:
            remedy = f"{self._held}: nothing moves until a reset"
        return ": ".join(str(text) for text in (mode.value, self._problem, remedy) if text is not None)

    def _publish(self, report: PusherReport) -> None:
        mode = self._shown(report.mode)
        now = self.get_clock().now().nanoseconds
        stamp = now if report.stamp is None else report.stamp
        if self._newest_stamp <= now:  # the clock has not gone back
            # the answer to an earlier request may come after a state of a pusher that could not be asked: it still rested then
            stamp = max(stamp, self._newest_stamp)
        self._newest_stamp = stamp
        (x, y), (along_x, along_y), radius = self._line
        msg = PusherState(
            mode=getattr(PusherState, f"MODE_{mode.name}"),
            position=report.position,
            speed=report.speed,
            tip=Point(x=x + report.position * along_x, y=y + report.position * along_y),
            direction=Vector3(x=along_x, y=along_y),
            tip_radius=radius,
            in_doubt=mode is Mode.DISCONNECTED or Position.KNOWN not in self._state or self._pusher.doubt is not None,
            age=0.0 if report is self._report and report.mode is not Mode.DISCONNECTED else clock() - self._reported,
            push_id=self._push_id,
        )
        msg.header.stamp, msg.header.frame_id = stamp_to_msg(stamp), TABLE
        self._state_out.publish(msg)
        known = Position.KNOWN in self._state or self._fault is not PusherFault.NONE
        fault = self._fault if known else PusherFault.POSITION
        if fault is not self._told_fault:
            self._told_fault = fault
            self._fault_out.publish(String(data=fault.value))

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._on(Event.RESET):
            response.success = True
            recovery = "homing" if self._config.home else "unlocking"
            response.message = recovery if Task.RECOVERING in self._state else "released"
        elif Life.ACTIVE not in self._state:
            response.message = self._not_active
        elif self._state & UNDER_WAY:
            response.message = "a push is under way, cancel it first"
        else:
            response.message = self._disabled or self._explained(self._shown(self._pusher.mode))
        return response

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._halt()
        response.success, response.message = True, STOPPED
        return response

    def _health(self) -> Health:
        active = Life.ACTIVE in self._state
        mode = self._shown(self._pusher.mode) if active else self._pusher.mode
        level = {Mode.DISCONNECTED: Level.ERROR, Mode.ALARM: Level.ERROR, Mode.HOLD: Level.WARN}.get(mode, Level.OK)
        message = mode.value if level is Level.OK else self._explained(mode)
        if not active and (Life.UNCONFIGURED in self._state or level is Level.OK):
            level, message = Level.WARN, self._not_active
        values = {"state": self._lifecycle_state, "controller": self._pusher.name,
                  "mode": mode.value, "fault": self._fault.value, "reports dropped": self._pusher.dropped,
                  "last problem": self._problem or "none"}  # fmt: skip
        return Health(level, message, values)

    # The push action

    def _on_goal(self, push: Push.Goal) -> GoalResponse:
        reason = self._refusal(push)
        if reason is None:
            return GoalResponse.ACCEPT
        self.get_logger().warning(f"push {push.push_id} rejected: {reason}")
        return GoalResponse.REJECT

    def _refusal(self, push: Push.Goal) -> str | None:
        """Why a goal is rejected; None for a good one."""
        config = self._config
        # only the first report after connecting says where the pusher is
        mode = Mode.DISCONNECTED if self._report.mode is Mode.DISCONNECTED else self._shown(self._pusher.mode)
        if self._push is not None:
            return f"push {self._push.goal.request.push_id} is under way"
        if Life.ACTIVE not in self._state:
            return self._not_active
        if step(ACTUATOR, self._state, Event.GOAL, self._facts()) is None:
            return self._disabled or f"the pusher must be idle, it is {self._explained(mode)}"
        if push.push_id < PusherState.NO_PUSH:
            return f"push_id must be 0 or more, or {PusherState.NO_PUSH} for a jog, got {push.push_id}"
        if push.distance == 0 or not math.isfinite(push.distance):
            return f"distance must be a length, negative for the way back, got {push.distance} m"
        if abs(push.distance) > config.max_distance:
            return f"distance must be at most max_distance {config.max_distance} m, got {push.distance} m"
        if push.distance < 0 and push.retract:
            return f"retract must be false for a way back, got {push.retract}"
        if not 0 < push.speed <= config.max_speed:
            return f"speed must be positive and at most max_speed {config.max_speed} m/s, got {push.speed} m/s"
        end, reach = self._report.position + push.distance, min(config.stroke, self._pusher.limits.travel)
        if end > reach + ROUNDING:
            return f"it would end at {end:.4f} m, beyond the stroke of {reach} m"
        if push.distance < 0 and end < -ROUNDING:
            return f"it would end at {end:.4f} m, before the stroke's beginning at 0 m"
        return None

    def _on_accepted(self, goal: ServerGoalHandle) -> None:
        push = goal.request
        if push.speed > (fastest := self._pusher.limits.max_speed):
            self.get_logger().warning(f"push {push.push_id} is slower than asked: the controller allows {fastest:.4f} m/s")
        self._problem, self._fault = None, PusherFault.NONE
        self._push = UnderWay(goal, clock(), self._report.position, Future())
        self._on(Event.GOAL)
        self._remember(moves=True)
        goal.execute()

    def _on_cancel(self, _: ServerGoalHandle) -> CancelResponse:
        self._on(Event.CANCEL)
        return CancelResponse.ACCEPT

    async def _execute(self, goal: ServerGoalHandle) -> Push.Result:
        """Wait until a push has ended, and tell its client; until then, there is no other."""
        assert self._push is not None
        push = self._push
        result: Push.Result = await push.end
        self._push = None
        if push.why is not None:
            result.outcome = Push.Result.OUTCOME_ABORTED
            goal.abort()
        elif goal.is_cancel_requested:
            result.outcome, result.message = Push.Result.OUTCOME_CANCELED, "stopped on request"
            goal.canceled()
        else:
            result.outcome = Push.Result.OUTCOME_REACHED
            goal.succeed()
        return result


def main() -> None:
    run_node(ActuatorNode, winds_up=True, niceness=URGENT)


if __name__ == "__main__":
    executable.main()
