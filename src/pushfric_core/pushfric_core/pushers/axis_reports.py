"""The reports of a controller: where one axis is, as far as they can be true, and whether the others are still."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from pushfric_core.pushers.pusher import Jumped, LeftTheWay, Mode, PusherError, PusherReport
from pushfric_core.pushers.stroke import Plausibility, Stroke

AXES = "XYZABC"
STILL = 0.05  # another axis that is reported farther from its place than this has moved [mm]
IMPOSSIBLE_FEED = 1.5  # times the controller's greatest speed
UNKNOWN_SPEED = 1.0  # greatest speed of a controller that does not say [m/s]
OFFSET_ROUNDING = 2e-3  # a sum of rounded numbers [mm]
MEASURED_OVER = 0.3  # a speed that no report says is measured over this time [s]
MM = 1e-3  # [m]
MM_PER_MINUTE = MM / 60  # [m/s]

# in any other state (Hold, Door, Check ...) the pusher rests and accepts no motion: HOLD
STATE_MODES = {
    "Idle": Mode.IDLE, "Run": Mode.RUNNING, "Jog": Mode.RUNNING, "Home": Mode.HOMING, "Alarm": Mode.ALARM, "Sleep": Mode.ALARM,
}  # fmt: skip


@dataclass(frozen=True)
class StatusReport:
    """A controller's report of itself, in its units (mm or inch, per minute)."""

    state: str  # as GRBL names them: Idle, Run, Hold, Jog, Alarm, Door, Check, Home, Sleep; grblHAL also Tool
    substate: int | None = None  # Hold:0 at rest, Hold:1 braking; Door:0-3
    machine_position: tuple[float, ...] | None = None  # MPos
    work_position: tuple[float, ...] | None = None  # WPos
    work_offset: tuple[float, ...] | None = None  # WCO = MPos - WPos
    feed: float | None = None  # F, FS
    pins: str = ""  # Pn: active inputs, X Y Z for limit switches
    overrides: tuple[float, ...] | None = None  # Ov: feed, rapids, spindle [%]


def moves(status: StatusReport) -> bool:
    """Whether a controller that says this moves."""
    return status.state in ("Run", "Jog", "Home") or (status.state, status.substate) in (("Hold", 1), ("Door", 2), ("Door", 3))


class AxisReports:
    """The knowledge of one axis."""

    def __init__(self, axis: str, real_time_factor: float, blame: Callable[[PusherError], None]) -> None:
        """Nothing has been heard yet.

        Args:
            axis: X, Y, Z, A, B or C, with a minus sign if the stroke runs towards negative coordinates.
            real_time_factor: seconds of the controller in one of real time.
            blame: takes an error that the reports show.
        """
        self.letter, self.sign = axis[-1], -1 if axis[0] == "-" else 1
        self.index = AXES.index(self.letter)
        self.zero = 0.0
        """Work coordinate of stroke position 0 [mm]."""
        self.damaged = 0
        """Number of reports that were damaged."""
        self._factor, self._blame = real_time_factor, blame
        self._plausibility = Plausibility()
        self.forget()

    def forget(self) -> None:
        """Nothing has been heard."""
        self.believe_next()
        self.status: StatusReport | None = None
        """The last one that can be true."""
        self.statuses = 0
        """Number of those that can be true."""
        self.last: PusherReport | None = None
        """The last one with a position that is believed."""
        self.believed = 0
        """Number of those with such a position."""
        self.place: tuple[float, ...] | None = None
        """The position of all axes in the last report, in its unit."""
        self.still: tuple[float, ...] | None = None
        """Where the other axes must stay, in the unit of reports."""
        self.offset: tuple[float, ...] | None = None
        """The work offset, in the unit of reports."""
        self.claimed: tuple[float, ...] | None = None
        """The last one that was reported; it is not confirmed yet."""
        self.unit = 1.0
        """Unit of positions in reports [mm]; settings and commands are always in mm."""
        self._strayed = False  # whether the last report said that one of the others had moved
        self._feed = math.inf  # in the last report [m/s]
        self._track: deque[tuple[float, float, float]] = deque()  # when asked, when heard [s], position [m]

    def believe_next(self) -> None:
        """The next report counts wherever it says that the axis is."""
        self._plausibility.forget()

    def stay(self) -> None:
        """From now on, the other axes must stay where they are."""
        self.still, self._strayed = self.place, False

    @property
    def dropped(self) -> int:
        """Number of reports that were damaged or cannot be true."""
        return self.damaged + self._plausibility.dropped

    def heard(self, status: StatusReport) -> None:
        """A report can be true."""
        self.status, self.statuses, self.place = status, self.statuses + 1, _place_of(status)

    def believe(self, report: PusherReport) -> None:
        """Its position is believed, too."""
        self.last, self.believed = report, self.believed + 1

    @property
    def mode(self) -> Mode:
        """The mode of the last report; DISCONNECTED without one."""
        return Mode.DISCONNECTED if self.status is None else STATE_MODES.get(self.status.state, Mode.HOLD)

    def position_of(self, status: StatusReport) -> float | None:
        """The stroke position in a report [m], if it holds one."""
        place, position = _place_of(status), status.work_position
        if position is None and place is not None:
            zero = self.offset or (0.0,) * (self.index + 1)
            position = tuple(m - o for m, o in zip(place, zero, strict=False))
        if position is None or len(position) <= self.index:
            return None
        # rounded to the nanometre, far below a report's last digit, so that nothing is shown as -0.000
        return round(self.sign * (position[self.index] * self.unit - self.zero) * MM, 9) + 0.0

    def coordinate_of(self, position: float) -> float:
        """The work coordinate of a stroke position [m], rounded as in commands [mm]."""
        return round(self.zero + self.sign * position / MM, 3) + 0.0  # 0.0 turns -0.0 into 0.0

    def take_offset(self, offset: tuple[float, ...], path: str) -> None:
        """Take the work offset in a report of the controller at `path`.

        It displaces all positions, so a new one must come twice to mean anything.
        """
        again, self.claimed = self.agree(offset, self.claimed), offset
        if self.offset is None:
            self.offset = offset if again else None
        elif again and not self.agree(offset, self.offset):
            changed = f"{self.shown(offset)} now, it was {self.shown(self.offset)}"
            self._blame(Jumped(f"the work offset of {path} is {changed}"))

    def agree(self, offset: tuple[float, ...] | None, other: tuple[float, ...] | None) -> bool:
        """Whether two offsets are there, and the same but for rounding."""
        if offset is None or other is None or len(offset) != len(other):
            return False
        return all(abs(one - another) * self.unit <= OFFSET_ROUNDING for one, another in zip(offset, other, strict=True))

    def shown(self, offset: tuple[float, ...]) -> str:
        """An offset, for people."""
        return "(" + ", ".join(f"{value * self.unit:.3f}" for value in offset) + ") mm"

    def others_are_still(self, status: StatusReport) -> bool:
        """Whether the other axes are where they were; two reports in a row that they are not are the end of any motion."""
        place, still = _place_of(status), self.still
        if place is None or still is None:
            return True
        if len(place) != len(still):
            self.damaged += 1
            return False
        away = [abs(now - before) * self.unit for now, before in zip(place, still, strict=True)]
        away[self.index] = 0.0
        axis = away.index(max(away))
        if away[axis] <= STILL:
            self._strayed = False
            return True
        self.damaged += 1
        if self._strayed:
            went = f"from {still[axis] * self.unit:.3f} mm to {place[axis] * self.unit:.3f} mm"
            self._blame(LeftTheWay(f"axis {AXES[axis]} went {went}; only {self.letter} may move"))
            self.still = None
        self._strayed = True
        return False

    def can_be_true(
        self, position: float, status: StatusReport, asked: float, now: float, greatest: float, stroke: Stroke | None
    ) -> bool:
        """Whether the pusher can be where a report says.

        Args:
            position: the one in the report [m].
            status: the report.
            asked: the latest time at which it can have been requested [s].
            now: when it was read [s].
            greatest: the controller's greatest speed; infinite if not known [m/s].
            stroke: the one under way.
        """
        limit = greatest if math.isfinite(greatest) else UNKNOWN_SPEED
        speed = math.inf if status.feed is None else status.feed * self.unit * MM_PER_MINUTE
        if limit * IMPOSSIBLE_FEED < speed < math.inf:
            self.damaged += 1
            return False
        if status.state in ("Hold", "Door"):  # grblHAL reports no feed while it brakes, and the programmed feed at rest
            speed = 0.0 if (status.state, status.substate) == ("Hold", 0) else math.inf
        before, self._feed = self._feed, speed
        reported = min(limit, max(before, self._feed))
        fastest, forward = (reported, 0.0) if stroke is None else (min(limit, stroke.speed), stroke.forward)
        # a pusher that rests, as two reports in a row say, and has not been sent anywhere cannot be elsewhere
        capable = limit if reported or stroke is not None else 0.0
        fastest, reported, capable = (speed * self._factor for speed in (fastest, reported, capable))
        believed, jumped_from = self._plausibility.judge(position, asked, now, fastest, reported, capable, forward)
        if jumped_from is not None:
            jump = f"it was at {jumped_from:.4f} m and then, at once, at {position:.4f} m"
            self._blame(Jumped(f"the controller's reports cannot be believed: {jump}"))
        return believed

    def speed(self, position: float, feed: float | None, stamp: int | None, moving: bool) -> float:
        """The controller's feed with the sign of the motion; without a feed, the difference of the positions [m/s].

        While the controller says that it moves, two equal positions do not mean rest, but reports of one moment.
        """
        if self.last is None:
            return 0.0
        moved = position - self.last.position
        if feed is not None:
            way = moved or self.last.speed  # without a difference, both reports are of the same moment
            return math.copysign(feed * self.unit * MM_PER_MINUTE, way) + 0.0 if way else 0.0
        if moving and not moved:
            return self.last.speed
        if stamp is None or self.last.stamp is None or stamp <= self.last.stamp:
            return 0.0
        return moved / ((stamp - self.last.stamp) * 1e-9)

    def proven_speed(self, position: float, asked: float, now: float, moving: bool) -> float:
        """The least speed that the positions of the last MEASURED_OVER prove, because a report may be late [m/s].

        Args:
            position: in the report [m].
            asked: the latest time at which it can have been requested [s].
            now: when it was read [s].
            moving: whether it differs from the one before.
        """
        if not moving:
            self._track.clear()
        while self._track and now - self._track[0][1] > MEASURED_OVER:
            self._track.popleft()
        self._track.append((asked, now, position))
        first, _, before = self._track[0]
        return (position - before) / (now - first) if moving and now > first else 0.0


def _place_of(status: StatusReport) -> tuple[float, ...] | None:
    return status.machine_position or status.work_position
