"""The pusher and the object, as their reports show them to the experiment."""

import math
import time
from collections.abc import Callable

from pushfric_core.cell.node_settings import PlanConfig
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Pose, wrap
from pushfric_core.pushers.pusher import PusherFault
from pushfric_core.trajectories.samples import PoseSample
from pushfric_core.trajectories.trajectory import Trajectory
from pushfric_core.vision.sighting import NO_OBJECT
from pushfric_msgs.msg import PusherState

LET_LIE = "let it lie still"
HIDDEN = "the object is not seen; let the camera see it, or press Skip to bring the pusher back"
REMEDY = "check that the camera gives new images, its calibration and time_offset, and line_origin"

OUTDATED = 1.5
"""A pose as old as this says nothing of now; the page of a run shows none that is older [s of wall time]."""

PAUSES = {PusherFault.TIME.value, PusherFault.OWNER.value, PusherFault.NODES.value}
"""Why a pusher stopped when a process, this one included, or the controller stood still."""

IN_ALARM = "it is in alarm: mend what it reports, see that it is free to move, then press Reset"

HINDRANCES = {
    PusherState.MODE_DISCONNECTED: "no controller answers: is it switched on, and plugged in?",
    PusherState.MODE_HOMING: "it seeks its home switch",
    PusherState.MODE_RUNNING: "",  # for a moment only
    PusherState.MODE_HOLD: "it is held by its controller, or its actuator is not active: press Reset when it is free to move",
    PusherState.MODE_ALARM: IN_ALARM,
}
"""Why a pusher in this mode cannot push, and what the operator can do about it."""


class ReportedPusher:
    """The state of the pusher, and whether it can push.

    Args:
        lost_result: a pusher that idles or is silent for longer has forgotten its goal [s of wall time].
        serves: whether its action server is available.
    Attributes:
        state: its last report.
        fault: why it stopped; empty if it did not.
        blind: it stands where it was stopped because the object was not seen.
    """

    def __init__(self, lost_result: float, serves: Callable[[], bool]) -> None:
        self._limit, self._serves = lost_result, serves
        self._heard = -math.inf  # when its last report came; this and the next in wall time [s]
        self._idle_since: float | None = None
        self.state = PusherState(push_id=PusherState.NO_PUSH)
        self.fault, self.blind = "", False

    def report(self, state: PusherState) -> None:
        self.state, self._heard = state, time.monotonic()
        if state.mode != PusherState.MODE_IDLE or state.push_id != PusherState.NO_PUSH:
            self._idle_since = None
        elif self._idle_since is None:
            self._idle_since = self._heard

    def report_fault(self, fault: str) -> None:
        self.fault = "" if fault == PusherFault.NONE.value else fault

    def has_goal(self) -> None:
        """Take it that the actuator has a goal, though it may wait for signs of life."""
        self._idle_since = None

    def excuse(self, stood_still: float) -> None:
        """Leave out a time in which this process stood still, and could hear nobody [s]."""
        now = time.monotonic()
        self._heard = min(now, self._heard + stood_still)
        self._idle_since = self._idle_since and min(now, self._idle_since + stood_still)

    def hindrance(self) -> str | None:
        """Why it cannot move; None if it can."""
        if self._silent:
            return "it does not report"
        if self.was_stopped:
            return "it was stopped: press Reset, or call ./pushfric reset, when it is free to move"
        if self.state.mode != PusherState.MODE_IDLE:
            return HINDRANCES.get(self.state.mode, f"it reports an unknown mode, {self.state.mode}")
        return None if self._serves() else "its action server is not available"

    @property
    def was_stopped(self) -> bool:
        return self.state.mode == PusherState.MODE_HOLD and self.fault == PusherFault.STOPPED.value

    def explained(self) -> bool:
        """Whether it is known by now if it stopped for a pause alone."""
        return self.fault not in ("", *PAUSES) or self.hindrance() in (None, IN_ALARM)

    def forgotten(self) -> str:
        """How it has shown that it forgot its goal: it idles, or it does not report at all; empty: it has not."""
        now = time.monotonic()
        if self._silent:
            return f"its last report came {now - self._heard:.1f} s ago; lost_result is {self._limit:g} s"
        if self._idle_since is not None and now - self._idle_since > self._limit:
            return f"it has reported for {now - self._idle_since:.1f} s that it idles; lost_result is {self._limit:g} s"
        return ""

    @property
    def _silent(self) -> bool:
        return time.monotonic() - self._heard > self._limit


class SeenObject:
    """Where the object lies, and whether it does what the pusher makes it do.

    Args:
        outline: of the object.
        config: when it counts as placed, and when as lost.
    Attributes:
        poses: that show whether it lies still: of the last `still` seconds [ns], and the last one before.
        following: judges whether the poses of the present push are possible.
    """

    def __init__(self, outline: Outline, config: PlanConfig) -> None:
        self._outline, self._config = outline, config
        self._seen = -math.inf  # when it was last seen [s of wall time]
        self.poses: list[tuple[int, Pose]] = []
        self.follow()

    def follow(self) -> None:
        """Follow a new push."""
        self.following = Trajectory(self._outline, tolerance=self._config.follow_tolerance)

    def report(self, sample: PoseSample) -> None:
        self.following.add_pose(sample)
        self._seen = time.monotonic()
        kept = [(t, p) for t, p in self.poses if t < sample.stamp] + [sample]
        # the last pose before that time stays, however few frames come
        before = sum(t <= sample.stamp - int(self._config.still * 1e9) for t, _ in kept)
        self.poses = kept[max(before - 1, 0) :]

    def excuse(self, stood_still: float) -> None:
        """Leave out a time in which this process stood still, and could see nothing [s]."""
        self._seen = min(time.monotonic(), self._seen + stood_still)

    @property
    def unseen(self) -> bool:
        return self._ago > self._config.lost_object

    @property
    def _ago(self) -> float:
        return time.monotonic() - self._seen

    @property
    def astray(self) -> str | None:
        """Why a push of it must not go on; None if it may."""
        if self.unseen:
            return f"the object was not seen for {self._ago:.2f} s; lost_object is {self._config.lost_object:g} s"
        contradiction = self.following.contradiction
        return contradiction and f"{contradiction}; {REMEDY}"

    def misplaced(self, wanted: Pose, no_pose: str) -> str | None:
        """The fault of its placement; LET_LIE: it has just come to its place; None: it lies still there.

        Args:
            wanted: where it is to lie.
            no_pose: why there are no poses, as the tracker says; empty if there are.
        """
        if not self.poses or self.unseen or self._ago > OUTDATED:
            why = "" if no_pose == NO_OBJECT else no_pose  # that needs no explanation
            return why if not self.poses else ": ".join(filter(None, ("it is not seen", why)))
        stamp, last = self.poses[-1]
        off, turn = math.hypot(last.x - wanted.x, last.y - wanted.y), wrap(wanted.theta - last.theta)
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
            for _, p in self.poses
        )
        long_enough = stamp - self.poses[0][0] >= int(self._config.still * 1e9)
        return None if still and long_enough else LET_LIE
