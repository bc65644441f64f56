"""The actuator node: the push action, and where the pusher is."""

import math
import time
from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import Point, Vector3
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from pushfric_core.contact import pushing_line
from pushfric_core.errors import InvalidInput
from pushfric_core.settings import check_ranges, setting
from pushfric_msgs.action import Push
from pushfric_msgs.msg import PusherState
from pushfric_ros.conversions import TABLE, stamp_to_msg
from pushfric_ros.diagnostics import Diagnostics, Health, Level
from pushfric_ros.grbl import Grbl
from pushfric_ros.parameters import declare
from pushfric_ros.process import run_node
from pushfric_ros.pusher import Mode, NotConnected, Pusher, PusherError, PusherReport
from pushfric_ros.qos import RELIABLE

READ_PERIOD = 0.005  # [s], as all below
FIRST_RETRY, LAST_RETRY = 0.5, 5.0
GRACE = 3.0  # a port may appear this late before anybody is told
RETRACT_FASTER = 5.0  # than the push was, where max_speed allows
ROUNDING = 1e-5  # of positions [m]
RESTART_JUMP = 1e-3  # a position that changed by more while disconnected is reported [m]


@dataclass(frozen=True)
class ActuatorConfig:
    """The pusher and its line on the table."""

    port: str = setting("", "serial port of the GRBL controller")
    baud: int = setting(115200, "[bit/s]", 300, 4_000_000)
    axis: str = setting("X", "axis of the controller, with a minus sign where the stroke runs to negative coordinates")
    home: bool = setting(False, "seek the home switch at start; otherwise the controller's work zero is stroke position 0")
    line_origin: tuple[float, ...] = setting((0.0, 0.0), "centre of the tip at stroke position 0, in the table frame [m]")
    line_direction: tuple[float, ...] = setting((0.0, 1.0), "of the forward stroke, in the table frame; any length")
    tip_radius: float = setting(0.003, "[m]", 0.0, 0.1)
    stroke: float = setting(0.06, "greatest stroke position [m]", 0.001, 10.0)
    max_speed: float = setting(0.1, "[m/s]", 0.0001, 10.0)
    poll_rate: float = setting(20.0, "reports of the pusher [Hz]", 1.0, 100.0)
    connect_timeout: float = setting(2.0, "how long the controller may take to boot [s]", 0.1, 60.0)
    wait_for_port: bool = setting(True, "wait for a port that is not there yet, instead of ending")

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.port:
            raise ValueError("port must name the serial port of the GRBL controller, got ''")
        pushing_line(self.line_origin, self.line_direction, self.tip_radius)


class ActuatorNode(Node):
    """Serves `push`, one goal at a time: a goal that arrives while another runs is rejected, neither queued nor preferred.

    A lost connection is made again by itself, without a motion. After an alarm, `~/reset` unlocks or homes, as configured.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("actuator", **kwargs)
        self._config = config = declare(self, ActuatorConfig)
        try:
            self._pusher: Pusher = Grbl(config.port, config.baud, config.axis, config.home, config.connect_timeout)
        except ValueError as error:
            raise InvalidInput(f"{self.get_fully_qualified_name()}: {error}") from error
        if not config.wait_for_port:
            try:
                self._pusher.connect()
            except NotConnected as error:
                raise InvalidInput(str(error)) from error
        self._line = pushing_line(config.line_origin, config.line_direction, config.tip_radius)
        self._report = PusherReport(0.0, 0.0, Mode.DISCONNECTED, None)  # the last one
        self._problem: str | None = None
        self._lost_at: float | None = None  # position when the connection was lost
        self._retry_at, self._retry_after = 0.0, FIRST_RETRY
        self._quiet_until = time.monotonic() + GRACE
        self._told: str | None = None  # the last problem that was logged
        self._goal: ServerGoalHandle | None = None
        self._push_id, self._start = PusherState.NO_PUSH, 0.0
        self._arrival: Future | None = None
        self._state_out = self.create_publisher(PusherState, "pusher_state", RELIABLE)
        callbacks = {"goal_callback": self._on_goal, "cancel_callback": self._on_cancel}
        self._server = ActionServer(self, Push, "push", self._execute, handle_accepted_callback=self._on_accepted, **callbacks)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self._diagnostics = Diagnostics(self, self._health)
        self.create_timer(1 / config.poll_rate, self._ask)
        # bytes come in real time, whatever clock the cell runs on
        self.create_timer(READ_PERIOD, self._poll, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def destroy_node(self) -> None:
        """Stop the pusher, whatever it does, before anything else ends."""
        self._pusher.close()
        self._server.destroy()
        super().destroy_node()

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

    def _poll(self) -> None:
        pusher = self._pusher
        try:
            if pusher.mode is Mode.DISCONNECTED and not pusher.busy:
                if time.monotonic() < self._retry_at:
                    return
                pusher.connect()
            report = pusher.poll()
        except PusherError as error:
            self._fail(error)
            return
        if report is not None and report.mode is not Mode.DISCONNECTED:
            self._take(report)
        if self._arrival is not None and not pusher.busy:
            self._arrival.set_result(None)

    def _take(self, report: PusherReport) -> None:
        if self._report.mode is Mode.DISCONNECTED:
            self._on_connected(report)
        self._report = report
        self._publish(report)
        if self._goal is not None and self._push_id != PusherState.NO_PUSH:
            self._goal.publish_feedback(Push.Feedback(travelled=report.position - self._start, speed=report.speed))

    def _on_connected(self, report: PusherReport) -> None:
        self.get_logger().info(f"connected to {self._pusher.name}")
        if self._lost_at is not None and abs(report.position - self._lost_at) > RESTART_JUMP:
            self.get_logger().warning(
                f"position {self._lost_at:.4f} m when the connection was lost, {report.position:.4f} m now: "
                "if the controller restarted meanwhile, restart it with the pusher at its home end, or home it"
            )
        self._lost_at, self._problem, self._told, self._retry_after = None, None, None, FIRST_RETRY
        self._quiet_until = 0.0

    def _fail(self, error: PusherError) -> None:
        """End the stroke under way, say once what happened, and connect again later where the connection is gone."""
        if self._arrival is not None:
            self._arrival.set_exception(error)
        lost = self._pusher.mode is Mode.DISCONNECTED
        self._problem = str(error)
        if not lost or (self._problem != self._told and time.monotonic() >= self._quiet_until):
            self.get_logger().error(f"{error}, retrying" if lost else str(error))
            self._told = self._problem
        if lost:
            if self._report.mode is not Mode.DISCONNECTED:
                self._lost_at = self._report.position
            self._report = self._report._replace(speed=0.0, mode=Mode.DISCONNECTED)
            self._retry_at = time.monotonic() + self._retry_after
            self._retry_after = min(2 * self._retry_after, LAST_RETRY)

    def _publish(self, report: PusherReport) -> None:
        stamp = self.get_clock().now().nanoseconds if report.stamp is None else report.stamp
        (x, y), (along_x, along_y), radius = self._line
        msg = PusherState(
            mode=getattr(PusherState, f"MODE_{report.mode.name}"),
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
        if self._goal is not None:
            response.message = "a push is under way, cancel it first"
            return response
        self._report = self._report._replace(speed=0.0, mode=Mode.DISCONNECTED)
        try:
            self._pusher.recover()
        except NotConnected as error:
            self._fail(error)
            response.message = str(error)
        else:
            response.success, response.message = True, "homing" if self._config.home else "unlocking"
        return response

    def _health(self) -> Health:
        mode = self._pusher.mode
        level = {Mode.DISCONNECTED: Level.ERROR, Mode.ALARM: Level.ERROR, Mode.HOLD: Level.WARN}.get(mode, Level.OK)
        message = mode.value if level is Level.OK or self._problem is None else f"{mode.value}: {self._problem}"
        values = {"port": self._config.port, "controller": self._pusher.name, "mode": mode.value,
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
        # the first report after a connection says where the pusher is
        mode = Mode.DISCONNECTED if self._report.mode is Mode.DISCONNECTED else self._pusher.mode
        if self._goal is not None:
            return f"push {self._goal.request.push_id} is under way"
        if mode is not Mode.IDLE:
            return f"the pusher's mode is {mode.value}, expected idle"
        if push.push_id < 0:
            return f"push_id must be 0 or more, got {push.push_id}"
        if not (push.distance > 0 and math.isfinite(push.distance)):
            return f"distance must be positive, got {push.distance} m"
        if not 0 < push.speed <= config.max_speed:
            return f"speed must be positive and at most max_speed {config.max_speed} m/s, got {push.speed} m/s"
        end, reach = self._report.position + push.distance, min(config.stroke, self._pusher.limits.travel)
        if end > reach + ROUNDING:
            return f"it would end at {end:.4f} m, beyond the stroke of {reach} m"
        return None

    def _on_accepted(self, goal: ServerGoalHandle) -> None:
        self._goal = goal
        goal.execute()

    def _on_cancel(self, _: ServerGoalHandle) -> CancelResponse:
        try:
            self._pusher.stop()
        except PusherError as error:
            self._fail(error)
        return CancelResponse.ACCEPT

    async def _execute(self, goal: ServerGoalHandle) -> Push.Result:
        push, start = goal.request, self._report.position
        fastest = self._pusher.limits.max_speed
        if push.speed > fastest:
            self.get_logger().warning(f"push {push.push_id} is slower than asked: the controller allows {fastest:.4f} m/s")
        self._start = start
        try:
            problem = await self._stroke(goal, start + push.distance, push.speed, push.push_id)
            travelled = self._report.position - start
            if push.retract and problem is None:
                back = min(RETRACT_FASTER * push.speed, self._config.max_speed)
                problem = await self._stroke(goal, start, back, PusherState.NO_PUSH)
        finally:
            self._goal = None
        if problem is not None:
            goal.abort()
            return Push.Result(outcome=Push.Result.OUTCOME_ABORTED, travelled=travelled, message=problem)
        if goal.is_cancel_requested:
            goal.canceled()
            return Push.Result(outcome=Push.Result.OUTCOME_CANCELED, travelled=travelled, message="stopped on request")
        goal.succeed()
        return Push.Result(outcome=Push.Result.OUTCOME_REACHED, travelled=travelled, message="reached")

    async def _stroke(self, goal: ServerGoalHandle, position: float, speed: float, push_id: int) -> str | None:
        """Move there unless canceled; what went wrong, if anything."""
        if goal.is_cancel_requested:
            return None
        self._push_id, self._arrival = push_id, Future()
        try:
            self._pusher.move_to(position, speed)
            await self._arrival
        except PusherError as error:
            return str(error)
        except BaseException:
            self._pusher.stop()
            raise
        finally:
            self._push_id, self._arrival = PusherState.NO_PUSH, None
        return None


def main() -> None:
    run_node(ActuatorNode)
