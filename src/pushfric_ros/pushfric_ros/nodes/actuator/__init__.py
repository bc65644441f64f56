"""The actuator node: the push action, and the state of the pusher; a managed node.

    unconfigured --configure--> inactive --activate--> active --deactivate--> inactive --cleanup--> unconfigured

Unconfigured, the node does not touch the port. Inactive, it connects to the controller, and again whenever the connection is
lost, but moves nothing. Active, it accepts goals. It takes the first two steps by itself unless `autostart` is false.

What it may do, and what follows each event, stands in the table `states.ACTUATOR`.
"""

import math
from collections.abc import Callable
from enum import Enum
from functools import partial
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from pushfric_core.cell.node_settings import FrameConfig
from pushfric_core.errors import blaming
from pushfric_core.plugins import PUSHERS, plugin
from pushfric_core.pushers.clock import clock
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
    UNDER_WAY,
    Action,
    Controller,
    Enable,
    Event,
    Hold,
    Homing,
    Life,
    Position,
    Task,
    Way,
    at_first,
    step,
)
from pushfric_msgs.action import Push
from pushfric_msgs.msg import PusherState
from pushfric_ros.node_kit.diagnostics import Diagnostics, Health, Level
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.process import URGENT, run_node
from pushfric_ros.node_kit.qos import RELIABLE
from pushfric_ros.node_kit.stop_button import StopButton
from pushfric_ros.node_kit.timers import cell_timer, wall_timer
from pushfric_ros.nodes.actuator.connection import Connection
from pushfric_ros.nodes.actuator.needs import DISK, PushNeeds
from pushfric_ros.nodes.actuator.reports import StateTopics, UnderWay, impossible, lost_track, shown

STOPPED = "stopped: nothing moves until a reset"
UNKNOWN = "where the pusher stands is not known: "
REMEDIES = {
    False: UNKNOWN + "bring it to its home end, restart the controller, then reset",
    True: UNKNOWN + "see that it is free to move, then reset, which homes",
}
"""The remedy of a person; the key says whether the cell homes."""


class ActuatorNode(LifecycleNode):
    """Serves `push`, one goal at a time, while it knows where the pusher stands.

    The position is unknown before homing, if homing is configured; after an alarm; and after a connection was lost during a
    motion or came back at another position. Then `~/reset` homes, or confirms the reported position. A lost connection is
    restored without a motion.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("actuator", **kwargs)
        self._config = config = declare(self, PusherConfig)
        with blaming(self.get_fully_qualified_name()):
            driver: PusherDriver = declare(self, plugin(PUSHERS, config.driver))
            self._pusher: Pusher = driver.open_pusher(config)
        self._state = at_first(config.home)
        self._start_due = config.autostart
        self._report, self._reported = PusherReport(0.0, 0.0, Mode.DISCONNECTED, None), clock()  # the last one; when it came
        self._problem: PusherError | None = None
        self._fault = PusherFault.NONE
        self._held = ""  # why nothing moves until a reset, if it is held
        self._push: UnderWay | None = None  # until its client is told
        topics = Diagnostics(self, self._health, declare(self, FrameConfig).within(self.get_namespace()))
        self._topics = StateTopics(self, config, topics)
        self._needs = PushNeeds(self, config, topics, self._on_force)
        self._connection = Connection(self._pusher, config.memory, self.get_logger())
        self._button = StopButton(self.get_namespace())
        callbacks = {"goal_callback": self._on_goal, "cancel_callback": self._on_cancel}
        self._server = ActionServer(self, Push, "push", self._execute, handle_accepted_callback=self._on_accepted, **callbacks)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(Trigger, "~/stop", self._on_stop)
        self.create_subscription(Empty, "stop", lambda _: self._halt(), RELIABLE)
        cell_timer(self, 1 / config.poll_rate, self._ask)
        # bytes come in real time, whatever the cell's clock
        wall_timer(self, POLL_PERIOD, self._poll)
        self._service_change_state.callback = partial(self._change_state, self._service_change_state.callback)
        if self._start_due:
            self.trigger_configure()

    def wind_up(self) -> bool:
        """Stop the pusher, tell the client and publish the state at rest; True once all of this is done."""
        self._start_due = False
        self._revoke(Event.DEACTIVATE, PusherFault.STOPPED, "the actuator was told to end")
        if self._push is not None or (self._pusher.busy and self._pusher.mode is not Mode.DISCONNECTED):
            return False
        self._publish(self._report._replace(speed=0.0, mode=self._pusher.mode, stamp=None))
        return True

    def destroy_node(self) -> None:
        """Stop the pusher before anything else ends."""
        self._pusher.close()
        self._connection.settle(DISK)
        self._button.close()
        self._server.destroy()
        super().destroy_node()

    # Transitions

    def _change_state(self, change: Callable, request: Any, response: Any) -> Any:
        """Refuse transitions that the present state does not have; in rclpy they would end the node."""
        self._start_due = False  # somebody else decides from now on
        try:
            return change(request, response)
        except rclpy_implementation.RCLError:
            wanted = request.transition.label or request.transition.id
            self.get_logger().warning(f"no transition {wanted} from the state {self._lifecycle_state}")
            response.success = False
            return response

    @property
    def _lifecycle_state(self) -> str:
        return str(self._state_machine.current_state[1])

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Connect to the controller from now on, as soon as its port exists."""
        self._on(Event.CONFIGURE)
        self._connection.renew()
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
            Enable.ENABLED if self._needs.disabled is None else Enable.DISABLED,
            self._needs.met,
            Controller.IDLE if self._pusher.mode is Mode.IDLE else Controller.NOT_IDLE,
            Way.RETURNS if returns else Way.ONE_WAY,
        )

    def _do(self, action: Enum) -> None:
        """Raises PusherError."""
        push, config = self._push, self._config
        match action:
            case Action.MOVE if push is not None:
                self._pusher.move_to(push.start + push.goal.request.distance, push.goal.request.speed)
            case Action.RETRACT if push is not None:
                push.turned = self._report.position
                self._pusher.move_to(push.start, min(config.retract_speed, config.max_speed))
            case Action.TELL if push is not None:
                push.conclude(self._report.position)
            case Action.BRAKE:
                self._pusher.stop()
            case Action.RECOVER:
                self._pusher.recover()
            case Action.LEAVE:
                self._pusher.close()
            case Action.CLEAR:
                self._problem, self._fault = None, PusherFault.NONE
            case _:
                raise AssertionError(f"{action.value}: there is no push")

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
        if (mode := self._pusher.mode) in (Mode.DISCONNECTED, Mode.HOMING):
            self._publish(self._report._replace(speed=0.0, mode=mode, stamp=None))
            return
        try:
            self._pusher.ask(self.get_clock().now().nanoseconds)
        except PusherError as error:
            self._fail(error)

    def _check(self) -> None:
        """Let a motion begin, or go on, only while it has all that it needs."""
        if self._push is not None and self._state & {Task.WAITING, Task.PUSHING, Task.RETRACTING}:
            missing = self._needs.missing(self._push, Task.WAITING in self._state, self._connection.kept)
            if missing is not None:
                self._blame(*missing)
        self._on(Event.CHECKED)

    def _on_force(self, why: str) -> None:
        if self._state & UNDER_WAY and Hold.FREE in self._state:
            self._halt(PusherFault.FORCE, why)

    @property
    def _rests(self) -> bool:
        """Whether the last report shows it at rest, and no push is under way."""
        return self._report.mode is Mode.IDLE and not self._state & UNDER_WAY

    def _poll(self) -> None:
        if (who := self._button.pressed()) is not None:
            self._halt()
            self._button.answer(who, STOPPED)
        if Life.UNCONFIGURED in self._state:
            return
        self._needs.note_turn()
        if moves := self._push is not None or Task.RECOVERING in self._state:
            self._check()
        now, pusher = self.get_clock().now().nanoseconds, self._pusher
        if now:
            self._connection.begin_time()
        try:
            if not self._connection.open():
                return
            report = pusher.poll(now)
        except PusherError as error:
            self._fail(error)
            return
        if report is not None and report.mode is not Mode.DISCONNECTED:
            self._take(report)
        if pusher.busy:
            return
        if moves:
            self._on(Event.RESTED)
        self._look_for_doubt()
        if self._start_due and Task.NONE in self._state:
            self._start_due = False
            self.trigger_activate()

    def _take(self, report: PusherReport) -> None:
        if self._report.mode is Mode.DISCONNECTED:
            self._on_connected(report)
        self._report, self._reported = report, clock()
        self._publish(report)
        rests = self._rests and report.speed == 0 and Position.KNOWN in self._state
        self._connection.keep(report.position if rests else math.nan)
        if (push := self._push) is not None and self._state & UNDER_WAY:  # also while it waits: its client is not forgotten
            if Task.PUSHING in self._state:
                push.course.append(report)
            push.goal.publish_feedback(Push.Feedback(travelled=push.travelled(report.position), speed=report.speed))

    def _on_connected(self, report: PusherReport) -> None:
        # before it has homed, its positions count from wherever it stood when it was switched on
        doubts = self._connection.made(report.position, Position.KNOWN in self._state or not self._config.home)
        if isinstance(self._problem, NotConnected):
            self._problem = None
        self._on(Event.CONNECTED)
        for doubt in doubts:
            self._on(Event.MISPLACED)
            self.get_logger().error(f"{doubt}: {REMEDIES[self._config.home]}")
        self._look_for_doubt()

    def _look_for_doubt(self) -> None:
        if self._pusher.mode is Mode.ALARM or self._pusher.doubt is not None:
            self._on(Event.UNSURE)

    def _fail(self, error: PusherError) -> None:
        """End what is under way, log the error once, and connect again later if the connection is lost."""
        lost = self._pusher.mode is Mode.DISCONNECTED
        self._blame(error.fault, str(error))
        self._problem, self._fault = error, error.fault
        self._connection.log_error(error, lost)
        if lost:
            self._lose(Event.LOST)
        else:  # the controller may be silent for a while now
            self._on(Event.FAILED)
            self._look_for_doubt()
            # the stamp is that of the report: the pusher may have gone on since
            self._publish(self._report._replace(speed=0.0, mode=self._pusher.mode))

    def _lose(self, event: Event) -> None:
        """The connection is lost; remember where the pusher rested."""
        self._connection.lost(self._report, self._rests)
        self._report = self._report._replace(speed=0.0, mode=Mode.DISCONNECTED)
        self._on(event)

    def _explained(self, mode: Mode) -> str:
        """A mode, what went wrong, and what to do about it; for people."""
        remedy = REMEDIES[self._config.home] if mode is Mode.ALARM and lost_track(self._state) else None
        if mode is Mode.HOLD and Hold.HELD in self._state:
            remedy = f"{self._held}: nothing moves until a reset"
        return ": ".join(str(text) for text in (mode.value, self._problem, remedy) if text is not None)

    def _publish(self, report: PusherReport) -> None:
        mode, known = shown(self._state, report.mode), Position.KNOWN in self._state
        in_doubt = mode is Mode.DISCONNECTED or not known or self._pusher.doubt is not None
        newest = report is self._report and report.mode is not Mode.DISCONNECTED
        push_id = self._push.push_id if self._push is not None and Task.PUSHING in self._state else PusherState.NO_PUSH
        self._topics.publish(report, mode, in_doubt, 0.0 if newest else clock() - self._reported, push_id)
        self._topics.tell(self._fault if known or self._fault is not PusherFault.NONE else PusherFault.POSITION)

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
            response.message = self._needs.disabled or self._explained(shown(self._state, self._pusher.mode))
        return response

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._halt()
        response.success, response.message = True, STOPPED
        return response

    def _health(self) -> Health:
        active = Life.ACTIVE in self._state
        mode = shown(self._state, self._pusher.mode) if active else self._pusher.mode
        level = {Mode.DISCONNECTED: Level.ERROR, Mode.ALARM: Level.ERROR, Mode.HOLD: Level.WARN}.get(mode, Level.OK)
        message = mode.value if level is Level.OK else self._explained(mode)
        if not active and (Life.UNCONFIGURED in self._state or level is Level.OK):
            level, message = Level.WARN, self._not_active
        values = {"state": self._lifecycle_state, "controller": self._pusher.name,
                  "mode": mode.value, "fault": self._fault.value, "reports dropped": self._pusher.dropped,
                  "last problem": self._problem or "none", "last refusal": self._topics.refusal}  # fmt: skip
        return Health(level, message, values)

    # The push action

    def _on_goal(self, push: Push.Goal) -> GoalResponse:
        if (reason := self._refusal(push)) is None:
            return GoalResponse.ACCEPT
        self._topics.refusal = reason
        self.get_logger().warning(f"push {push.push_id} rejected: {reason}")
        return GoalResponse.REJECT

    def _refusal(self, push: Push.Goal) -> str | None:
        """Why a goal is rejected; None for a good one."""
        # only the first report after connecting says where the pusher is
        mode = Mode.DISCONNECTED if self._report.mode is Mode.DISCONNECTED else shown(self._state, self._pusher.mode)
        if self._push is not None:
            return f"push {self._push.goal.request.push_id} is under way"
        if Life.ACTIVE not in self._state:
            return self._not_active
        if step(ACTUATOR, self._state, Event.GOAL, self._facts()) is None:
            return self._needs.disabled or f"the pusher must be idle, it is {self._explained(mode)}"
        return impossible(push, self._config, self._pusher.limits, self._report.position)

    def _on_accepted(self, goal: ServerGoalHandle) -> None:
        push = goal.request
        if push.speed > (fastest := self._pusher.limits.max_speed):
            self.get_logger().warning(f"push {push.push_id} is slower than asked: the controller allows {fastest:.4f} m/s")
        self._problem, self._fault = None, PusherFault.NONE
        self._push = UnderWay(goal, clock(), self._report.position)
        if not self._on(Event.GOAL):  # to answer takes a moment, in which the enable may have been withdrawn
            self._push.why = self._needs.disabled or "the pusher is no longer ready"
            self._push.conclude(self._report.position)
        self._connection.keep(math.nan)
        goal.execute()

    def _on_cancel(self, _: ServerGoalHandle) -> CancelResponse:
        self._on(Event.CANCEL)
        return CancelResponse.ACCEPT

    async def _execute(self, goal: ServerGoalHandle) -> Push.Result:
        """Wait until a push has ended, and tell its client; until then, there is no other."""
        assert self._push is not None
        push = self._push
        result = await push.end
        self._push = None
        return push.closed(result)


def main() -> None:
    run_node(ActuatorNode, winds_up=True, niceness=URGENT)
