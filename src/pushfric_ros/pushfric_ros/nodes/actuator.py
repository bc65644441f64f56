"""The actuator node: the push action, and the state of the pusher; a managed node.

    unconfigured --configure--> inactive --activate--> active --deactivate--> inactive --cleanup--> unconfigured

Unconfigured, the node does not touch the port. Inactive, it connects to the controller, and again whenever the connection is
lost, but moves nothing. Active, it accepts goals. It takes the first two steps by itself unless `autostart` is false.
"""

import math
from collections.abc import Callable
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
from pushfric_core.cell.plugins import PUSHERS, plugin
from pushfric_core.errors import InvalidInput
from pushfric_core.geometry.contact import pushing_line
from pushfric_core.geometry.frames import TABLE
from pushfric_core.pushers.clock import clock
from pushfric_core.pushers.position_memory import PositionMemory
from pushfric_core.pushers.pusher import (
    Mode,
    NotConnected,
    Pusher,
    PusherConfig,
    PusherDriver,
    PusherError,
    PusherFault,
    PusherReport,
)
from pushfric_core.pushers.stroke import unevenness
from pushfric_msgs.action import Push
from pushfric_msgs.msg import PusherState
from pushfric_ros.messages.conversions import stamp_to_msg
from pushfric_ros.node_kit import executable
from pushfric_ros.node_kit.diagnostics import Diagnostics, Health, Level
from pushfric_ros.node_kit.heartbeat import Listener
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_DATA
from pushfric_ros.node_kit.stop_button import StopButton

READ_PERIOD = 0.005  # [s], as all below
FIRST_RETRY, LAST_RETRY = 0.1, 5.0
FORCE_SILENCE = 0.5
GRACE = 3.0  # a port may appear this late without an error message; simulated time begins once a simulated port is there
ROUNDING = 1e-5  # tolerance of positions [m]
UNEVEN = 0.1  # a speed that varies by more than this is worth a note; a share of the mean
KEPT = 1e-4  # a controller that kept its position while disconnected reports it this exactly [m]
STOPPED = "stopped: nothing moves until a reset"
UNKNOWN = "where the pusher stands is not known: "
REMEDIES = {
    False: UNKNOWN + "bring it to its home end, restart the controller, then reset",
    True: UNKNOWN + "see that it is free to move, then reset, which homes",
}
"""What a person does about it; the key says whether the cell homes."""


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
        self._configured = self._active = self._recovering = False
        self._located = not config.home  # whether the pusher stands where the controller says it does
        self._start_due = config.autostart
        self._report = PusherReport(0.0, 0.0, Mode.DISCONNECTED, None)  # the last one
        self._problem: PusherError | None = None
        self._lost_at: float | None = None  # where it rested when the connection was lost; NaN: it did not rest
        self._retry_at, self._retry_after = 0.0, FIRST_RETRY
        self._quiet_until = math.inf  # set when time has begun
        self._told: str | None = None  # the last problem logged
        self._unsure = False  # the position is unknown, and only a person can say so
        self._fault = PusherFault.NONE
        self._stopped: str | None = None  # why nothing moves until a reset, although the position is known
        self._ending = False
        self._enabled = self._forced = -math.inf  # when enable was last true, and a force measured; in wall time [s]
        self._memory: PositionMemory | None = None  # of the pusher that is connected, or was last
        self._goal: ServerGoalHandle | None = None
        self._may_go: Future | None = None  # until the goal's owner and the required nodes have shown a sign of life
        self._revoked: str | None = None  # why the goal may not go on
        self._push_id = PusherState.NO_PUSH
        self._start: float | None = None  # where the stroke that the goal asks for began, while it is under way
        self._travelled = 0.0  # of the stroke
        self._course: list[PusherReport] = []  # reports of the stroke
        self._arrival: Future | None = None
        self._diagnostics = Diagnostics(self, self._health, declare(self, FrameConfig).within(self.get_namespace()))
        self._state_out = self._diagnostics.advertise(PusherState, "pusher_state", RELIABLE)
        self._told_fault: PusherFault | None = None
        self._guarded, self._gap = clock(), 0.0  # when the conditions of a push were last checked; how long before that
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
        self.create_timer(READ_PERIOD, self._poll, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._service_change_state.callback = self._refuse_unknown(self._service_change_state.callback)
        if self._start_due:
            self.trigger_configure()

    def wind_up(self) -> bool:
        """Stop the pusher, tell the client and publish the state at rest; True once all of this is done."""
        if not self._ending:
            self._ending, self._active = True, False
            self._revoke(PusherFault.STOPPED, "the actuator was told to end")
        if self._goal is not None or (self._pusher.busy and self._pusher.mode is not Mode.DISCONNECTED):
            return False
        self._publish(self._report._replace(speed=0.0, mode=self._pusher.mode, stamp=None))
        return True

    def destroy_node(self) -> None:
        """Stop the pusher before anything else ends."""
        self._pusher.close()
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
        self._configured, self._located = True, self._located and not self._config.home
        self._retry_at, self._retry_after = 0.0, FIRST_RETRY
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Accept goals, after homing if it is configured and still due. Refused until the controller has answered."""
        if self._report.mode is Mode.DISCONNECTED or self._pusher.busy:
            self.get_logger().error(f"cannot be activated yet: {self._problem or 'the controller is being connected'}")
            return TransitionCallbackReturn.FAILURE
        if self._config.home and not self._located and not self._unsure:
            try:
                self._recover()
            except PusherError as error:
                self._fail(error)
                return TransitionCallbackReturn.FAILURE
        self._active = True
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop a motion, and accept no more goals."""
        self._active = False
        self._revoke(PusherFault.STOPPED, "the actuator was deactivated")
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

    def _revoke(self, fault: PusherFault, why: str) -> None:
        """Stop any motion; a goal under way is aborted with this reason once the pusher rests."""
        if self._goal is not None and self._revoked is None:
            self._revoked, self._fault = why, fault
        if self._may_go is not None and not self._may_go.done():
            self._may_go.set_result(None)
        if self._pusher.busy:
            self._stop()

    def _halt(self, fault: PusherFault = PusherFault.STOPPED, why: str = "somebody asked for a stop") -> None:
        """Stop any motion, and move nothing until somebody calls reset."""
        self._stopped, self._fault = why, fault
        self.get_logger().warning(f"{why}: nothing moves until a reset")
        self._revoke(fault, why)

    def _leave(self, why: str) -> None:
        self._configured = self._active = False
        self._pusher.close()
        self._lose()
        if self._arrival is not None:
            self._arrival.set_exception(NotConnected(why))

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

    def _guard(self) -> None:
        """Stop a push if any of its conditions fails: enable, owner, required nodes, force."""
        config, goal, now = self._config, self._goal, clock()
        self._gap, self._guarded = now - self._guarded, now
        moves = goal is not None or (self._pusher.busy and self._pusher.mode is Mode.HOMING)
        if moves and (disabled := self._disabled) is not None:
            self._revoke(PusherFault.DISABLED, disabled)
        if goal is None or self._revoked is not None:
            return
        lasted = now - self._accepted
        waits = self._may_go is not None and not self._may_go.done()
        lacking = self._lifeless(bytes(goal.goal_id.uuid), lasted)
        if lacking is not None and not (waits and lasted < config.grace):
            self._revoke(*lacking)
        if self._may_go is not None and waits and lacking is None:
            self._may_go.set_result(None)
        if lasted > config.max_time:
            self._revoke(PusherFault.TIME, f"the push took {lasted:.1f} s, more than max_time {config.max_time:g} s")
        if config.max_force and (unmeasured := now - self._forced) > FORCE_SILENCE:
            how_long = "yet" if math.isinf(unmeasured) else f"for {unmeasured:.2f} s, the limit is {FORCE_SILENCE:g} s"
            self._revoke(PusherFault.FORCE, f"no force was measured {how_long}")

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
        if self._goal is not None and force > self._config.max_force and self._stopped is None:
            self._halt(PusherFault.FORCE, f"the force was {force:.1f} N, more than max_force {self._config.max_force:g} N")

    def _remember(self, moves: bool = False) -> None:
        """Keep what is known of the position for the next process."""
        report = self._report
        if self._memory is None or (report.mode is Mode.DISCONNECTED and not moves):
            return
        rests = not moves and self._located and self._goal is None and report.mode is Mode.IDLE and report.speed == 0
        try:
            self._memory.keep(report.position if rests else math.nan)
        except OSError as error:
            self.get_logger().warning(f"the pusher's position is not kept: {error}", once=True)

    def _poll(self) -> None:
        if (who := self._button.pressed()) is not None:
            self._halt()
            self._button.answer(who, STOPPED)
        if not self._configured:
            return
        self._guard()
        pusher = self._pusher
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
        if self._arrival is not None:
            self._arrival.set_result(None)
            self._problem = None
        if self._recovering:
            self._recovering, self._located, self._problem = False, True, None
            self._unsure, self._fault = False, PusherFault.NONE
        if self._start_due and self._report.mode is not Mode.DISCONNECTED:
            self._start_due = False
            self.trigger_activate()

    def _take(self, report: PusherReport) -> None:
        if self._report.mode is Mode.DISCONNECTED:
            self._on_connected(report)
        self._report = report
        self._publish(report)
        self._remember()
        if self._goal is not None:  # also while it waits, so that its client knows that it is not forgotten
            if self._start is not None:
                self._travelled = report.position - self._start
                self._course.append(report)
            self._goal.publish_feedback(Push.Feedback(travelled=self._travelled, speed=report.speed))

    def _on_connected(self, report: PusherReport) -> None:
        self.get_logger().info(f"connected to {self._pusher.name}")
        self._recall()
        # before it has homed, its positions count from wherever it stood when it was switched on
        counted_from_home = self._located or not self._config.home
        if self._lost_at is not None and (
            math.isnan(self._lost_at) or (counted_from_home and abs(report.position - self._lost_at) > KEPT)
        ):
            self._located, self._unsure = False, True
            before = "not idle" if math.isnan(self._lost_at) else f"at {self._lost_at:.4f} m"
            what = f"{before} when the connection was lost, said to be at {report.position:.4f} m now"
            self.get_logger().error(f"{what}: {REMEDIES[self._config.home]}")
        if isinstance(self._problem, NotConnected):
            self._problem = None
        if self._pusher.mode is Mode.ALARM and not self._config.home:
            self._located = False
        if self._pusher.doubt is not None:
            self._located, self._unsure = False, True
            self.get_logger().error(f"{self._pusher.doubt}: {REMEDIES[self._config.home]}")
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
        """End the stroke under way, log the error once, and connect again later if the connection is lost."""
        self._recovering = False
        if self._arrival is not None:
            self._arrival.set_exception(error)
        lost = self._pusher.mode is Mode.DISCONNECTED
        self._problem, self._fault = error, error.fault
        if not lost or (str(error) != self._told and clock() >= self._quiet_until):
            self.get_logger().error(f"{error}, retrying" if lost else str(error))
            self._told = str(error)
        if lost:
            self._lose()
            self._retry_at = clock() + self._retry_after
            self._retry_after = min(2 * self._retry_after, LAST_RETRY)
        else:  # the controller may be silent for a while now
            self._located = self._located and self._pusher.mode is not Mode.ALARM and self._pusher.doubt is None
            self._push_id = PusherState.NO_PUSH
            # the stamp is that of the report: the pusher may have gone on since
            self._publish(self._report._replace(speed=0.0, mode=self._pusher.mode))

    def _lose(self) -> None:
        """The connection is lost; remember where the pusher rested."""
        self._recovering = False
        if self._report.mode is not Mode.DISCONNECTED:
            rests = self._report.mode is Mode.IDLE and self._goal is None
            self._lost_at = self._report.position if rests else math.nan
        self._report = self._report._replace(speed=0.0, mode=Mode.DISCONNECTED)

    def _recover(self) -> None:
        self._pusher.recover()
        # if homing is not completed, the pusher can be anywhere
        self._recovering, self._located = True, self._located and not self._config.home

    def _stop(self) -> None:
        self._recovering = False
        try:
            self._pusher.stop()
        except PusherError as error:
            self._fail(error)

    def _shown(self, mode: Mode) -> Mode:
        """The mode as others see it: idle means ready to move."""
        if mode is not Mode.IDLE or (self._active and self._located and self._stopped is None):
            return mode
        return Mode.ALARM if self._active and not self._located else Mode.HOLD

    def _explained(self, mode: Mode) -> str:
        """A mode, what went wrong, and what to do about it; for people."""
        remedy = REMEDIES[self._config.home] if mode is Mode.ALARM and self._active and not self._located else None
        if mode is Mode.HOLD and self._stopped is not None:
            remedy = f"{self._stopped}: nothing moves until a reset"
        return ": ".join(str(text) for text in (mode.value, self._problem, remedy) if text is not None)

    def _publish(self, report: PusherReport) -> None:
        mode = self._shown(report.mode)
        stamp = self.get_clock().now().nanoseconds if report.stamp is None else report.stamp
        (x, y), (along_x, along_y), radius = self._line
        msg = PusherState(
            mode=getattr(PusherState, f"MODE_{mode.name}"),
            position=report.position,
            speed=report.speed,
            tip=Point(x=x + report.position * along_x, y=y + report.position * along_y),
            direction=Vector3(x=along_x, y=along_y),
            tip_radius=radius,
            push_id=self._push_id,
        )
        msg.header.stamp, msg.header.frame_id = stamp_to_msg(stamp), TABLE
        self._state_out.publish(msg)
        fault = self._fault if self._located or self._fault is not PusherFault.NONE else PusherFault.POSITION
        if fault is not self._told_fault:
            self._told_fault = fault
            self._fault_out.publish(String(data=fault.value))

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._goal is not None or not self._active:
            response.message = "a push is under way, cancel it first" if self._goal else self._not_active
            return response
        stopped, self._stopped = self._stopped, None
        if stopped is not None and self._located and self._pusher.mode is Mode.IDLE:
            self._fault = PusherFault.NONE
            response.success, response.message = True, "released"
            return response
        try:
            if not self._recovering:  # whoever asks again does not begin it again
                self._recover()
        except PusherError as error:
            response.message = str(error)
        else:
            response.success, response.message = True, "homing" if self._config.home else "unlocking"
        return response

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._halt()
        response.success, response.message = True, STOPPED
        return response

    def _health(self) -> Health:
        mode = self._shown(self._pusher.mode) if self._active else self._pusher.mode
        level = {Mode.DISCONNECTED: Level.ERROR, Mode.ALARM: Level.ERROR, Mode.HOLD: Level.WARN}.get(mode, Level.OK)
        message = mode.value if level is Level.OK else self._explained(mode)
        if not self._active and (not self._configured or level is Level.OK):
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
        if self._goal is not None:
            return f"push {self._goal.request.push_id} is under way"
        if not self._active:
            return self._not_active
        if mode is not Mode.IDLE:
            return f"the pusher must be idle, it is {self._explained(mode)}"
        if push.push_id < PusherState.NO_PUSH:
            return f"push_id must be 0 or more, or {PusherState.NO_PUSH} for a jog, got {push.push_id}"
        if (disabled := self._disabled) is not None:
            return disabled
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
        self._goal, self._revoked, self._fault = goal, None, PusherFault.NONE
        self._may_go, self._accepted, self._travelled = Future(), clock(), 0.0
        goal.execute()

    def _on_cancel(self, _: ServerGoalHandle) -> CancelResponse:
        self._stop()
        return CancelResponse.ACCEPT

    async def _execute(self, goal: ServerGoalHandle) -> Push.Result:
        push, start = goal.request, self._report.position
        fastest = self._pusher.limits.max_speed
        if push.speed > fastest:
            self.get_logger().warning(f"push {push.push_id} is slower than asked: the controller allows {fastest:.4f} m/s")
        try:
            assert self._may_go is not None
            await self._may_go  # nothing moves for a client that shows no sign of life, or without the required nodes
            self._start, self._course = start, []
            problem = await self._stroke(goal, start + push.distance, push.speed)
            self._start = None
            travelled = self._report.position - start
            uneven = unevenness(self._course, start, start + push.distance)
            if push.retract and problem is None:
                back = min(self._config.retract_speed, self._config.max_speed)
                problem = await self._stroke(goal, start, back)
        finally:
            self._goal = self._start = self._may_go = None
        if problem is not None:
            goal.abort()
            return Push.Result(outcome=Push.Result.OUTCOME_ABORTED, travelled=travelled, message=problem)
        if goal.is_cancel_requested:
            goal.canceled()
            return Push.Result(outcome=Push.Result.OUTCOME_CANCELED, travelled=travelled, message="stopped on request")
        goal.succeed()
        note = f", unevenly: its speed varied by {100 * uneven:.0f} %" if uneven > UNEVEN else ""
        return Push.Result(outcome=Push.Result.OUTCOME_REACHED, travelled=travelled, message=f"reached{note}")

    async def _stroke(self, goal: ServerGoalHandle, position: float, speed: float) -> str | None:
        """Move there unless canceled or revoked; return what went wrong, if anything."""
        if goal.is_cancel_requested or self._revoked is not None:
            return self._revoked
        forward = position > self._report.position
        self._push_id, self._arrival = goal.request.push_id if forward else PusherState.NO_PUSH, Future()
        self._remember(moves=True)
        try:
            self._pusher.move_to(position, speed)
            await self._arrival
        except PusherError as error:
            return self._revoked or str(error)
        except BaseException:
            self._stop()
            raise
        finally:
            self._push_id, self._arrival = PusherState.NO_PUSH, None
        return self._revoked


def main() -> None:
    run_node(ActuatorNode, winds_up=True)


if __name__ == "__main__":
    executable.main()
