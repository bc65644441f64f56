"""The reports of the actuator: the state of the pusher on its topics, and the end of a push to its client."""

import math
from dataclasses import dataclass, field

from geometry_msgs.msg import Point, Vector3
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import String

from pushfric_core.geometry.planar import TABLE
from pushfric_core.pushers.pusher import Limits, Mode, PusherConfig, PusherFault, PusherReport
from pushfric_core.pushers.states import READY, Life, Position, State
from pushfric_core.pushers.stroke import unevenness
from pushfric_msgs.action import Push
from pushfric_msgs.msg import PusherState
from pushfric_ros.messages.conversions import stamp_to_msg
from pushfric_ros.node_kit.diagnostics import Diagnostics
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE

ROUNDING = 1e-5  # tolerance of positions [m]
SLOWEST_PUSH = 1e-5  # controllers write a lower speed as none [m/s]
UNEVEN = 0.05  # a speed that varies by more than this is worth a note; a share of the mean


@dataclass
class UnderWay:
    """A push, from its acceptance until its client has been told how it ended."""

    goal: ServerGoalHandle
    accepted: float  # when [s]
    start: float  # of the stroke [m]
    end: Future = field(default_factory=Future)  # its result, but for the outcome
    course: list[PusherReport] = field(default_factory=list)  # reports of the stroke
    turned: float | None = None  # where the way back began [m]
    why: str | None = None  # it was ended before its time

    @property
    def push_id(self) -> int:
        """Its number, while it moves forward; a way back has none."""
        return PusherState.NO_PUSH if self.goal.request.distance < 0 else int(self.goal.request.push_id)

    def travelled(self, position: float) -> float:
        """The length of its stroke, if the pusher stands at a position [m]."""
        return (position if self.turned is None else self.turned) - self.start

    def conclude(self, position: float) -> None:
        """It has ended, with the pusher at a position [m]: its client is told."""
        uneven = unevenness(self.course, self.start, self.start + self.goal.request.distance)
        note = f", unevenly: its speed varied by {100 * uneven:.0f} %" if uneven > UNEVEN else ""
        self.end.set_result(Push.Result(travelled=self.travelled(position), message=self.why or f"reached{note}"))

    def closed(self, result: Push.Result) -> Push.Result:
        """Close the goal; the result with its outcome."""
        if self.why is not None:
            result.outcome = Push.Result.OUTCOME_ABORTED
            self.goal.abort()
        elif self.goal.is_cancel_requested:
            result.outcome, result.message = Push.Result.OUTCOME_CANCELED, "stopped on request"
            self.goal.canceled()
        else:
            result.outcome = Push.Result.OUTCOME_REACHED
            self.goal.succeed()
        return result


def impossible(push: Push.Goal, config: PusherConfig, limits: Limits, position: float) -> str | None:
    """Why a pusher with these limits that stands at a position [m] cannot carry out a goal; None for a good one."""
    if push.push_id < PusherState.NO_PUSH:
        return f"push_id must be 0 or more, or {PusherState.NO_PUSH} for a jog, got {push.push_id}"
    if push.distance == 0 or not math.isfinite(push.distance):
        return f"distance must be a length, negative for the way back, got {push.distance} m"
    if abs(push.distance) > config.max_distance:
        return f"distance must be at most max_distance {config.max_distance} m, got {push.distance} m"
    if push.distance < 0 and push.retract:
        return f"retract must be false for a way back, got {push.retract}"
    if not SLOWEST_PUSH <= push.speed <= config.max_speed:
        return f"speed must be at least {SLOWEST_PUSH:g} m/s and at most max_speed {config.max_speed} m/s, got {push.speed} m/s"
    end, reach = position + push.distance, min(config.stroke, limits.travel)
    if end > reach + ROUNDING:
        return f"it would end at {end:.4f} m, beyond the stroke of {reach} m"
    if push.distance < 0 and end < -ROUNDING:
        return f"it would end at {end:.4f} m, before the stroke's beginning at 0 m"
    return None


def shown(state: State, mode: Mode) -> Mode:
    """The mode as others see it: idle means ready to move."""
    if mode not in (Mode.IDLE, Mode.HOLD) or (mode is Mode.IDLE and state >= READY):
        return mode
    return Mode.ALARM if lost_track(state) else Mode.HOLD


def lost_track(state: State) -> bool:
    """Whether only a person can say where the pusher stands, or homing."""
    return Life.ACTIVE in state and Position.KNOWN not in state


class StateTopics:
    """The topics `pusher_state` and `pusher_fault`.

    Attributes:
        refusal: why the last goal that was rejected was, for the diagnostics: the answer to a goal has no room for it.
    """

    def __init__(self, node: Node, config: PusherConfig, topics: Diagnostics) -> None:
        self._clock, self._line = node.get_clock(), config.line
        self._state = topics.advertise(PusherState, "pusher_state", RELIABLE)
        self._newest_stamp = 0  # of the states that were published [ns]
        self._fault = topics.advertise(String, "pusher_fault", LATCHED)
        self._told: PusherFault | None = None
        self.refusal = "none"

    def publish(self, report: PusherReport, mode: Mode, in_doubt: bool, age: float, push_id: int) -> None:
        """Publish a report.

        Args:
            report: of the pusher.
            mode: as others are to see it.
            in_doubt: whether it may stand elsewhere.
            age: of the report [s].
            push_id: of the push that moves forward now.
        """
        now = self._clock.now().nanoseconds
        stamp = now if report.stamp is None else report.stamp
        if self._newest_stamp <= now:  # the clock has not gone back
            # the answer to an earlier request may come after a state of a pusher that could not be asked: it still rested then
            stamp = max(stamp, self._newest_stamp)
        self._newest_stamp = stamp
        (x, y), (along_x, along_y) = self._line.origin, self._line.direction
        msg = PusherState(
            mode=getattr(PusherState, f"MODE_{mode.name}"),
            position=report.position,
            speed=report.speed,
            tip=Point(x=x + report.position * along_x, y=y + report.position * along_y),
            direction=Vector3(x=along_x, y=along_y),
            tip_radius=self._line.tip_radius,
            in_doubt=in_doubt,
            age=age,
            push_id=push_id,
        )
        msg.header.stamp, msg.header.frame_id = stamp_to_msg(stamp), TABLE
        self._state.publish(msg)

    def tell(self, fault: PusherFault) -> None:
        """Publish a fault, if it is another one."""
        if fault is not self._told:
            self._told = fault
            self._fault.publish(String(data=fault.value))
