"""The actuator node: the push action, and where the pusher is; a managed node.

    unconfigured --configure--> inactive --activate--> active --deactivate--> inactive --cleanup--> unconfigured

Unconfigured, the port is left alone. Inactive, the controller is connected, and connected again whenever it is lost, but
nothing moves. Active, goals are taken. It does the first two steps by itself unless `autostart` is false.
"""

import math
import time
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import Point, Vector3
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.clock import Clock, ClockType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.task import Future
from std_srvs.srv import Trigger

from pushfric_core.contact import pushing_line
from pushfric_core.errors import InvalidInput
from pushfric_msgs.action import Push
from pushfric_msgs.msg import PusherState
from pushfric_ros.files.plugins import PUSHERS, plugin
from pushfric_ros.messages.conversions import TABLE, stamp_to_msg
from pushfric_ros.node_kit.diagnostics import Diagnostics, Health, Level
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.qos import RELIABLE
from pushfric_ros.pushers.pusher import Mode, NotConnected, Pusher, PusherConfig, PusherDriver, PusherError, PusherReport

READ_PERIOD = 0.005  # [s], as all below
FIRST_RETRY, LAST_RETRY = 0.5, 5.0
GRACE = 3.0  # a port may appear this late before anybody is told
ROUNDING = 1e-5  # of positions [m]
KEPT = 1e-4  # a controller that kept its position while disconnected reports it this exactly [m]
UNKNOWN = "where the pusher stands is not known: "
REMEDIES = {
    False: UNKNOWN + "bring it to its home end, restart the controller, then call actuator/reset",
    True: UNKNOWN + "see that it is free to move, then call actuator/reset, which homes",
}
"""What a person does about it, without and with homing."""


class ActuatorNode(LifecycleNode):
    """Serves `push`, one goal at a time: a goal that arrives while another runs is rejected, neither queued nor preferred.

    A lost connection is made again by itself, without a motion. After an alarm, `~/reset` unlocks or homes, as configured.

    It takes goals only while it knows where the pusher stands. It does not before homing, where that is configured, nor after
    an alarm, nor once a connection was lost in mid-motion or comes back at another position: a controller that restarts counts
    from wherever the pusher happens to stand. Such a pusher is published as in alarm. `~/reset` ends that, too: it homes; or
    else the person who calls it vouches for the position that is reported.
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
        self._lost_at: float | None = None  # where it rested when the connection was lost; nan: it did not rest
        self._retry_at, self._retry_after = 0.0, FIRST_RETRY
        self._quiet_until = time.monotonic() + GRACE
        self._told: str | None = None  # the last problem that was logged
        self._goal: ServerGoalHandle | None = None
        self._client_seen = False  # that of the goal, in the graph
        self._revoked: str | None = None  # why the goal may not go on
        self._push_id = PusherState.NO_PUSH
        self._start: float | None = None  # where the stroke that the goal asks for began, while it is under way
        self._arrival: Future | None = None
        self._diagnostics = Diagnostics(self, self._health)
        self._state_out = self._diagnostics.advertise(PusherState, "pusher_state", RELIABLE)
        callbacks = {"goal_callback": self._on_goal, "cancel_callback": self._on_cancel}
        self._server = ActionServer(self, Push, "push", self._execute, handle_accepted_callback=self._on_accepted, **callbacks)
        self._client_endpoint = self.resolve_service_name("push") + "/_action/send_goal"
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_timer(1 / config.poll_rate, self._ask)
        # bytes come in real time, whatever clock the cell runs on
        self.create_timer(READ_PERIOD, self._poll, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._service_change_state.callback = self._refuse_unknown(self._service_change_state.callback)
        if self._start_due:
            self.trigger_configure()

    def destroy_node(self) -> None:
        """Stop the pusher, whatever it does, before anything else ends."""
        self._pusher.close()
        self._server.destroy()
        super().destroy_node()

    # Transitions

    def _refuse_unknown(self, change_state: Callable) -> Callable:
        """rclpy lets a transition that the state does not know end the node."""

        def changed(request: Any, response: Any) -> Any:
            self._start_due = False  # somebody else decides now
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
        """From now on the controller is connected, as soon as its port is there."""
        self._configured, self._located = True, self._located and not self._config.home
        self._retry_at, self._retry_after = 0.0, FIRST_RETRY
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take goals; where so configured, home before that unless it has been. Refused until the controller has answered."""
        if self._pusher.mode is Mode.DISCONNECTED or self._pusher.busy:
            self.get_logger().error(f"cannot be activated yet: {self._problem or 'the controller is being connected'}")
            return TransitionCallbackReturn.FAILURE
        if self._config.home and not self._located:
            try:
                self._recover()
            except PusherError as error:
                self._fail(error)
                return TransitionCallbackReturn.FAILURE
        self._active = True
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop a motion, and take no more goals."""
        self._active = False
        self._revoke("the actuator was deactivated")
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
        """A transition raised something: the safe state is to have left the port."""
        self.get_logger().error("a transition failed; the pusher is left")
        self._leave("a transition failed")
        return TransitionCallbackReturn.SUCCESS

    @property
    def _not_active(self) -> str:
        return f"the actuator is {self._lifecycle_state}, expected active"

    def _revoke(self, why: str) -> None:
        """Stop whatever moves; a goal under way is aborted with this reason once the pusher rests."""
        if self._goal is not None:
            self._revoked = why
        if self._pusher.busy:
            self._stop()

    def _leave(self, why: str) -> None:
        self._configured = self._active = False
        self._pusher.close()
        self._lose()
        if self._arrival is not None:
            self._arrival.set_exception(NotConnected(why))

    # The pusher

    def _ask(self) -> None:
        """At each tick of the cell's clock; what cannot answer now is published as it is known to be."""
        mode = self._pusher.mode
        if mode in (Mode.DISCONNECTED, Mode.HOMING):
            self._publish(self._report._replace(speed=0.0, mode=mode, stamp=None))
            return
        try:
            self._pusher.ask(self.get_clock().now().nanoseconds)
        except PusherError as error:
            self._fail(error)
        self._look_for_client()

    def _look_for_client(self) -> None:
        """Nobody would cancel a push once the last client of the action has left."""
        if self._goal is None or self._revoked is not None:
            return
        if self.count_clients(self._client_endpoint):
            self._client_seen = True
        elif self._client_seen:
            self._revoke("the client that sent it is gone")

    def _poll(self) -> None:
        if not self._configured:
            return
        pusher = self._pusher
        try:
            if pusher.mode is Mode.DISCONNECTED and not pusher.busy:
                if time.monotonic() < self._retry_at:
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
        if self._start_due and pusher.mode is not Mode.DISCONNECTED:
            self._start_due = False
            self.trigger_activate()

    def _take(self, report: PusherReport) -> None:
        if self._report.mode is Mode.DISCONNECTED:
            self._on_connected(report)
        self._report = report
        self._publish(report)
        if self._goal is not None and self._start is not None:
            self._goal.publish_feedback(Push.Feedback(travelled=report.position - self._start, speed=report.speed))

    def _on_connected(self, report: PusherReport) -> None:
        self.get_logger().info(f"connected to {self._pusher.name}")
        if self._lost_at is not None and not abs(report.position - self._lost_at) <= KEPT:
            self._located = False
            before = "not idle" if math.isnan(self._lost_at) else f"at {self._lost_at:.4f} m"
            what = f"{before} when the connection was lost, said to be at {report.position:.4f} m now"
            self.get_logger().error(f"{what}: {REMEDIES[self._config.home]}")
        if isinstance(self._problem, NotConnected):
            self._problem = None
        if self._pusher.mode is Mode.ALARM:
            self._located = False
        if self._pusher.doubt is not None:
            self._located = False
            self.get_logger().error(f"{self._pusher.doubt}: {REMEDIES[self._config.home]}")
        self._lost_at, self._told, self._retry_after = None, None, FIRST_RETRY
        self._quiet_until = 0.0

    def _fail(self, error: PusherError) -> None:
        """End the stroke under way, say once what happened, and connect again later where the connection is gone."""
        self._recovering = False
        if self._arrival is not None:
            self._arrival.set_exception(error)
        lost = self._pusher.mode is Mode.DISCONNECTED
        self._problem = error
        if not lost or (str(error) != self._told and time.monotonic() >= self._quiet_until):
            self.get_logger().error(f"{error}, retrying" if lost else str(error))
            self._told = str(error)
        if lost:
            self._lose()
            self._retry_at = time.monotonic() + self._retry_after
            self._retry_after = min(2 * self._retry_after, LAST_RETRY)
        else:  # the controller may be silent for a while now
            self._located = self._located and self._pusher.mode is not Mode.ALARM and self._pusher.doubt is None
            self._push_id = PusherState.NO_PUSH
            self._publish(self._report._replace(speed=0.0, mode=self._pusher.mode, stamp=None))

    def _lose(self) -> None:
        """The connection is gone; remember where the pusher rested."""
        self._recovering = False
        if self._report.mode is not Mode.DISCONNECTED:
            rests = self._report.mode is Mode.IDLE and self._goal is None
            self._lost_at = self._report.position if rests else math.nan
        self._report = self._report._replace(speed=0.0, mode=Mode.DISCONNECTED)

    def _recover(self) -> None:
        self._pusher.recover()
        # a homing that is not completed leaves the pusher anywhere
        self._recovering, self._located = True, self._located and not self._config.home

    def _stop(self) -> None:
        self._recovering = False
        try:
            self._pusher.stop()
        except PusherError as error:
            self._fail(error)

    def _shown(self, mode: Mode) -> Mode:
        """To others, idle means ready to move."""
        if mode is not Mode.IDLE or (self._active and self._located):
            return mode
        return Mode.ALARM if self._active else Mode.HOLD

    def _explained(self, mode: Mode) -> str:
        """A mode with what went wrong, and what to do where the position is not known; for people."""
        remedy = REMEDIES[self._config.home] if mode is Mode.ALARM and self._active and not self._located else None
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

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._goal is not None or not self._active:
            response.message = "a push is under way, cancel it first" if self._goal else self._not_active
            return response
        try:
            self._recover()
        except PusherError as error:
            response.message = str(error)
        else:
            response.success, response.message = True, "homing" if self._config.home else "unlocking"
        return response

    def _health(self) -> Health:
        mode = self._shown(self._pusher.mode) if self._active else self._pusher.mode
        level = {Mode.DISCONNECTED: Level.ERROR, Mode.ALARM: Level.ERROR, Mode.HOLD: Level.WARN}.get(mode, Level.OK)
        message = mode.value if level is Level.OK else self._explained(mode)
        if not self._active and (not self._configured or level is Level.OK):
            level, message = Level.WARN, self._not_active
        values = {"state": self._lifecycle_state, "controller": self._pusher.name,
                  "mode": mode.value, "last problem": self._problem or "none"}  # fmt: skip
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
        # the first report after a connection says where the pusher is
        mode = Mode.DISCONNECTED if self._report.mode is Mode.DISCONNECTED else self._shown(self._pusher.mode)
        if self._goal is not None:
            return f"push {self._goal.request.push_id} is under way"
        if not self._active:
            return self._not_active
        if mode is not Mode.IDLE:
            return f"the pusher must be idle, it is {self._explained(mode)}"
        if push.push_id < 0:
            return f"push_id must be 0 or more, got {push.push_id}"
        if push.distance == 0 or not math.isfinite(push.distance):
            return f"distance must be a length, negative for the way back, got {push.distance} m"
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
        self._goal, self._revoked, self._client_seen = goal, None, False
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
            self._start = start
            problem = await self._stroke(goal, start + push.distance, push.speed)
            self._start = None
            travelled = self._report.position - start
            if push.retract and problem is None:
                back = min(self._config.retract_speed, self._config.max_speed)
                problem = await self._stroke(goal, start, back)
        finally:
            self._goal = self._start = None
        if problem is not None:
            goal.abort()
            return Push.Result(outcome=Push.Result.OUTCOME_ABORTED, travelled=travelled, message=problem)
        if goal.is_cancel_requested:
            goal.canceled()
            return Push.Result(outcome=Push.Result.OUTCOME_CANCELED, travelled=travelled, message="stopped on request")
        goal.succeed()
        return Push.Result(outcome=Push.Result.OUTCOME_REACHED, travelled=travelled, message="reached")

    async def _stroke(self, goal: ServerGoalHandle, position: float, speed: float) -> str | None:
        """Move there unless canceled or revoked; what went wrong, if anything."""
        if goal.is_cancel_requested or self._revoked is not None:
            return self._revoked
        forward = position > self._report.position
        self._push_id, self._arrival = goal.request.push_id if forward else PusherState.NO_PUSH, Future()
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
    run_node(ActuatorNode)
