"""The common part of all drivers of a controller on a serial port: a stroke is a stream of short pieces.

The controller never has more of a stroke than it moves through in the time `ahead`, judged by the positions that it reports. If
this process dies, hangs or loses the line, the pusher therefore stops after that time. Flow control is send-and-wait: a line is
sent only after the controller has answered the last one.
"""

import contextlib
import math
import os
import statistics
from abc import abstractmethod
from collections import deque
from collections.abc import Generator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

from pushfric_core.pushers.clock import clock
from pushfric_core.pushers.driver import Driver, Script
from pushfric_core.pushers.driver_states import Phase, Role
from pushfric_core.pushers.push_states import Homing
from pushfric_core.pushers.pusher import (
    Halted,
    Held,
    Jumped,
    LeftTheWay,
    Mode,
    NotConnected,
    NotReady,
    PusherConfig,
    PusherError,
    PusherReport,
    Timeout,
)
from pushfric_core.pushers.serial_port import identity_of, open_port, write_all
from pushfric_core.pushers.serial_settings import AXES, SerialSettings, check_axis
from pushfric_core.pushers.state_table import State
from pushfric_core.pushers.stroke import Plausibility, Stroke

if TYPE_CHECKING:
    import serial

WIPED = "wiped out by a reset"

ANSWER_TIMEOUT = 3.0  # [s], as all below
HOMING_TIMEOUT = 180.0
ASK_EVERY = 0.05  # while a script waits for reports
ASK_MOVING = 0.025  # in a stroke
ASK_AGAIN = 0.25  # a question that was not answered
ASK_AGAIN_MOVING = 0.06
STANDS = 1.0  # a pusher that stands still in mid-stroke
SILENCE = 2.0  # at rest, unless the setting silence allows more
LONGEST_LINE = 4096  # [bytes]
ASKED_FOR_TWO_ALIKE = 6  # settings and offsets, which have no checksum
STILL = 0.05  # another axis that is reported farther from its place than this has moved [mm]
REPORTS_UNTIL_PLACE = 62  # GRBL's offset comes with every 30th report at the latest, and counts once it has come twice
REFUSED_OFTEN = 5  # this many pieces may be refused, and sent again, in one stroke
IMPOSSIBLE_FEED = 1.5  # times the controller's greatest speed
UNKNOWN_SPEED = 1.0  # greatest speed of a controller that does not say [m/s]
MM = 1e-3  # [m]
MM_PER_MINUTE = MM / 60  # [m/s]

# in any other state (Hold, Door, Check ...) the pusher rests and accepts no motion: HOLD
STATE_MODES = {
    "Idle": Mode.IDLE, "Run": Mode.RUNNING, "Jog": Mode.RUNNING, "Home": Mode.HOMING, "Alarm": Mode.ALARM, "Sleep": Mode.ALARM,
}  # fmt: skip
INPUTS = {"D": "door", "H": "feed hold", "R": "reset", "E": "emergency stop", "M": "motor fault"}
"""Inputs by which a person, or the wiring, holds a controller, by the letters of its reports."""


class Refused(PusherError):
    """The controller did not accept a line."""

    passing = False
    """Whether the same line may be accepted a little later."""


@dataclass(frozen=True)
class StatusReport:
    """A controller's report of itself, in its units (mm or inch, per minute)."""

    state: str  # as GRBL names them: Idle, Run, Hold, Jog, Alarm, Door, Check, Home, Sleep; grblHAL also Tool
    substate: int | None = None  # Hold:0 at rest, Hold:1 braking; Door:0-3
    machine_position: tuple[float, ...] | None = None  # MPos
    work_position: tuple[float, ...] | None = None  # WPos
    work_offset: tuple[float, ...] | None = None  # WCO = MPos - WPos
    buffer: tuple[int, ...] | None = None  # Bf: free blocks of the planner, free bytes of the receiver
    line: int | None = None  # Ln
    feed: float | None = None  # F, FS
    spindle: float | None = None  # FS [1/min]
    pins: str = ""  # Pn: active inputs, X Y Z for limit switches
    overrides: tuple[int, ...] | None = None  # Ov: feed, rapids, spindle [%]
    accessories: str = ""  # A
    others: dict[str, str] = field(default_factory=dict)  # fields of other firmware


class SerialPusher(Driver):
    """A Pusher: one linear axis of a controller on a serial port.

    Stroke position 0 is where the axis rests after homing; without homing, the zero of the controller's work coordinates.
    """

    def __init__(
        self,
        port: str,
        baud: int = SerialSettings.baud,
        axis: str = SerialSettings.axis,
        home: bool = PusherConfig.home,
        greeting_timeout: float = SerialSettings.connect_timeout,
        ahead: float = SerialSettings.ahead,
        silence: float = SerialSettings.silence,
        real_time_factor: float = SerialSettings.real_time_factor,
        only_look: bool = False,
    ) -> None:
        """Nothing is opened yet.

        Args:
            port: of the controller, such as /dev/ttyUSB0.
            baud: [bit/s]
            axis: X, Y, Z, A, B or C, with a minus sign if the stroke runs towards negative coordinates.
            home: `recover` seeks the home switch; otherwise it unlocks an alarm.
            greeting_timeout: how long a controller may take to boot [s].
            ahead: if nothing more is sent, the pusher goes on for this long and then brakes [s of real time].
            silence: a controller that says nothing for this long while it moves is stopped [s].
            real_time_factor: seconds of the controller in one of real time; 1 for any but a simulated one.
            only_look: never move, hold or reset the controller, and send it no line while it moves.
        Raises:
            ValueError: axis is not one of these.
        """
        check_axis(axis)
        self._path, self._baud, self._greeting_timeout = port, baud, greeting_timeout
        self._ahead, self._factor = ahead, real_time_factor
        self._letter, self._sign = axis[-1], -1 if axis[0] == "-" else 1
        self._index = AXES.index(self._letter)
        self._zero = 0.0  # work coordinate of stroke position 0 [mm]
        self._port: serial.Serial | None = None
        self._damaged = 0  # reports
        self._plausibility = Plausibility()
        super().__init__(
            silence,
            max(SILENCE, silence) + self.deaf_after_stop,
            Homing.HOMES if home else Homing.UNLOCKS,
            Role.LOOKS if only_look else Role.DRIVES,
        )

    def _forget(self) -> None:
        super()._forget()
        self._buffer = b""
        self._asked_last = 0.0  # when the question behind the newest report was sent
        self._believed = 0  # reports
        self._feed = math.inf  # in the last report [m/s]
        self._place: tuple[float, ...] | None = None  # of all axes in the last report
        self._still: tuple[float, ...] | None = None  # where the other axes must stay
        self._strayed = False  # whether the last report said that one of them had moved
        self._held: str | None = None  # what holds the controller, unless it is this driver
        self._limits = ""  # pins that were active when the stroke began
        self._latencies: deque[float] = deque(maxlen=9)  # of the last answers to ? [s]
        self._plausibility.forget()
        self._status: StatusReport | None = None
        self._statuses = 0
        self._offset: tuple[float, ...] | None = None
        self._last: PusherReport | None = None
        self._fresh: PusherReport | None = None
        self._stamp: int | None = None
        self._asked: float | None = None  # when the last question was sent, if it is unanswered
        self._last_ask = -math.inf
        self._silent_since: float | None = None
        self._pending: str | None = None  # the line sent and not answered yet
        self._sent_at = 0.0
        self._answer: Refused | str | None = None
        self._settings: dict[int | str, str] = {}
        self._version = ""

    # What differs between controllers

    sign_of_life: ClassVar[str]
    """A trial for a person in a terminal, and what must be seen."""

    idle_reports = 10
    """This many in a row that say so, away from the target, mean that a motion ended early."""

    deaf_after_stop = 0.0
    """The controller may answer nothing for this long after a stop [s]."""

    @staticmethod
    @abstractmethod
    def settings_of(axis: str) -> tuple[str, str, str]:
        """The firmware's names of the greatest travel, speed and acceleration of an axis."""

    @property
    def unit(self) -> float:
        """Unit of positions in reports [mm]; settings and commands are always in mm."""
        return 1.0

    @property
    @abstractmethod
    def _resolution(self) -> float:
        """How near the controller gets to a target [m]."""

    @abstractmethod
    def _last_words(self, homing: bool) -> bytes:
        """The mechanism that stops the pusher when the port is left in mid-motion."""

    @abstractmethod
    def _send_question(self) -> None:
        """Ask for a report. Raises NotConnected."""

    @abstractmethod
    def _piece(self, position: float, speed: float) -> str:
        """The line that moves the pusher on to a stroke position [m] at a speed [m/s]."""

    @abstractmethod
    def _take(self, raw: bytes) -> None:
        """Take one line from the controller, whatever it is."""

    @abstractmethod
    def _halted(self) -> Halted:
        """Why the controller that reports an alarm has stopped."""

    @property
    @abstractmethod
    def _homing_line(self) -> str:
        """The line that seeks the home switch."""

    @abstractmethod
    def _ensure_full_feed(self) -> None:
        """Let the controller move as fast as it is told. Raises NotConnected."""

    @abstractmethod
    def _take_offset(self, status: StatusReport) -> None:
        """Take what a report says of the work offset, if the controller has one."""

    @property
    def _reported(self) -> Mode:
        """The mode of the last report."""
        return Mode.DISCONNECTED if self._status is None else STATE_MODES.get(self._status.state, Mode.HOLD)

    @property
    def name(self) -> str:
        return f"{self._version or 'no controller'} at {self._path}"

    @property
    def place(self) -> str:
        return identity_of(self._path)

    @property
    def dropped(self) -> int:
        return self._damaged + self._plausibility.dropped

    def _open(self) -> None:
        if not os.path.exists(self._path):
            raise NotConnected(f"no serial port at {self._path}")
        try:
            self._port = open_port(self._path, self._baud)
        except OSError as error:
            raise NotConnected(f"cannot open {self._path}: {error}") from error

    def _leave(self, before: State, in_motion: bool) -> None:
        port, self._port = self._port, None
        if port is None:
            return
        with contextlib.suppress(OSError):  # the port may be gone already
            if in_motion:  # a hold cancels a jog; only a reset ends a homing cycle
                write_all(port, self._last_words(Phase.HOMING in before))
        port.close()

    def _start(self, position: float, speed: float) -> Stroke:
        """Raises NotReady if the controller answers too late."""
        latency = statistics.median(self._latencies or [0.0])
        if latency > self._silence:
            raise NotReady(f"the controller at {self._path} answers after {latency:.2f} s; silence is {self._silence:g} s")
        assert self._last is not None
        assert self._status is not None
        self._limits = self._status.pins
        # a longer silence is allowed on a busy machine, to each piece
        ahead, wait = self._ahead * self._factor, max(0.0, self._silence - SerialSettings.silence)
        return Stroke(self._last.position, position, speed, self.limits.acceleration, ahead, wait, latency * self._factor)

    def ask(self, stamp: int) -> None:
        if self._connected and Phase.HOMING not in self._state:
            self._ask(stamp)

    # Bytes, lines, meaning

    def _write(self, data: bytes) -> None:
        if self._port is None:
            raise NotConnected(f"{self._path} is not open")
        try:
            write_all(self._port, data)
        except OSError as error:
            self._drop()
            raise NotConnected(f"lost {self._path}: {error}") from error

    def _hear(self) -> None:
        if self._port is None:
            raise NotConnected(f"{self._path} is not open")
        self._fresh = None
        try:
            self._buffer += self._port.read(LONGEST_LINE)
        except OSError as error:
            raise NotConnected(f"lost {self._path}: {error}") from error
        *lines, self._buffer = self._buffer.split(b"\n")
        self._buffer = self._buffer[-LONGEST_LINE:]  # noise without an end of line
        for line in lines:
            self._take(line)

    def _take_status(self, status: StatusReport) -> None:
        """Take a status report; one that cannot be true changes nothing."""
        now = clock()
        # the report answers the first open question or an earlier one, so the pusher was there at that time or later
        asked = self._silent_since if self._silent_since is not None else self._asked_last
        position, place = status.work_position, status.machine_position or status.work_position
        if place is not None and not self._others_are_still(place):
            self._stamp = self._asked = None
            self._last_ask = -math.inf
            return
        self._take_offset(status)
        if position is None and place is not None:
            zero = self._offset or (0.0,) * (self._index + 1)
            position = tuple(m - o for m, o in zip(place, zero, strict=False))
        stamp = self._now_stamp if self._stamp is None else self._stamp
        if position is not None and len(position) > self._index:
            # rounded to the nanometre, far below a report's last digit, so that nothing is shown as -0.000
            here = round(self._sign * (position[self._index] * self.unit - self._zero) * MM, 9) + 0.0
            if not self._can_be_true(here, status, asked, now):
                self._stamp = self._asked = None
                return
            # in these states grblHAL reports no feed while it brakes, and the programmed feed at rest
            feed = None if status.state in ("Hold", "Door") else status.feed
            report = PusherReport(here, self._speed(here, feed, stamp, moves(status)), self.mode, stamp)
        else:
            report = None
        if self._silent_since is not None:
            self._latencies.append(now - self._silent_since)
        self._stamp = self._asked = self._silent_since = None
        self._status, self._statuses, self._place, self._asked_last = status, self._statuses + 1, place, asked
        if status.overrides and status.overrides[0] != 100 and Phase.STREAMING in self._state:
            self._ensure_full_feed()
        self._hear_of_hold(self._holding(status))
        if report is not None:
            self._fresh = self._last = report._replace(mode=self.mode)
            self._believed += 1

    def _hear_of_hold(self, why: str | None) -> None:
        """Take what the controller says it is held by, unless this driver holds it; it counts once."""
        if self._role is Role.DRIVES and self._state & {Phase.RESTING, Phase.STREAMING}:
            before, self._held = self._held, why
            if why is not None and before is None:
                self._trouble = self._trouble or Held(f"held at the controller: {why}")

    def _holding(self, status: StatusReport) -> str | None:
        """The hold that a report shows: the controller does not move, although this driver has not told it so; or None."""
        if status.state not in STATE_MODES:
            return f"it reports {status.state}"
        for pin, name in INPUTS.items():
            if pin in status.pins:
                return f"its {name} input is active"
        streams = Phase.STREAMING in self._state and status.state != "Alarm"
        if streams and (reached := set(status.pins) & set(AXES) - set(self._limits)):
            return f"its limit input {min(reached)} became active"
        return None

    def _others_are_still(self, place: tuple[float, ...]) -> bool:
        """Whether the other axes are where they were; two reports in a row that they are not are the end of any motion."""
        if Phase.RECOVERING in self._state:  # a person has looked
            self._still = None
        still = self._still
        if still is None or Phase.HOMING in self._state or self._role is Role.LOOKS:
            return True
        if len(place) != len(still):
            self._damaged += 1
            return False
        away = [abs(now - before) * self.unit for now, before in zip(place, still, strict=True)]
        away[self._index] = 0.0
        axis = away.index(max(away))
        if away[axis] <= STILL:
            self._strayed = False
            return True
        self._damaged += 1
        if self._strayed and self._connected:
            went = f"from {still[axis] * self.unit:.3f} mm to {place[axis] * self.unit:.3f} mm"
            self._trouble = self._trouble or LeftTheWay(f"axis {AXES[axis]} went {went}; only {self._letter} may move")
            self._still = None
        self._strayed = True
        return False

    def _can_be_true(self, position: float, status: StatusReport, asked: float, now: float) -> bool:
        if self._state & {Phase.HOMING, Phase.RECOVERING}:  # positions start again, or somebody has looked
            self._plausibility.forget()
        greatest = self.limits.max_speed
        limit = greatest if math.isfinite(greatest) else UNKNOWN_SPEED
        speed = math.inf if status.feed is None else status.feed * self.unit * MM_PER_MINUTE
        if limit * IMPOSSIBLE_FEED < speed < math.inf:
            self._damaged += 1
            return False
        if status.state in ("Hold", "Door"):  # grblHAL reports no feed while it brakes, and the programmed feed at rest
            speed = 0.0 if (status.state, status.substate) == ("Hold", 0) else math.inf
        before, self._feed = self._feed, speed
        reported = min(limit, max(before, self._feed))
        stroke = self._stroke
        fastest, forward = (reported, 0.0) if stroke is None else (min(limit, stroke.speed), stroke.forward)
        # a pusher that rests, as two reports in a row say, and has not been sent anywhere cannot be elsewhere
        capable = limit if reported or stroke is not None else 0.0
        fastest, reported, capable = (speed * self._factor for speed in (fastest, reported, capable))
        believed, jumped_from = self._plausibility.judge(position, asked, now, fastest, reported, capable, forward)
        if jumped_from is not None and self._connected:
            jump = f"it was at {jumped_from:.4f} m and then, at once, at {position:.4f} m"
            self._trouble = self._trouble or Jumped(f"the controller at {self._path} cannot be believed: {jump}")
        return believed

    def _speed(self, position: float, feed: float | None, stamp: int | None, moving: bool) -> float:
        """The controller's feed with the sign of the motion; without a feed, the difference of the positions.

        While the controller says that it moves, two equal positions do not mean rest, but reports of one moment.
        """
        if self._last is None:
            return 0.0
        moved = position - self._last.position
        if feed is not None:
            way = moved or self._last.speed  # without a difference, both reports are of the same moment
            return math.copysign(feed * self.unit * MM_PER_MINUTE, way) + 0.0 if way else 0.0
        if moving and not moved:
            return self._last.speed
        if stamp is None or self._last.stamp is None or stamp <= self._last.stamp:
            return 0.0
        return moved / ((stamp - self._last.stamp) * 1e-9)

    def _newest(self) -> PusherReport | None:
        return self._fresh

    @property
    def _silent(self) -> float:
        if self._silent_since is None or self._state & {Phase.BRAKING, Phase.HOMING}:
            return 0.0
        return clock() - self._silent_since

    def _ask(self, stamp: int | None) -> None:
        now = clock()
        again = ASK_AGAIN_MOVING if Phase.STREAMING in self._state else ASK_AGAIN
        if self._asked is not None and now - self._asked < again:
            return
        self._send_question()
        self._stamp, self._asked, self._last_ask = stamp, now, now
        self._silent_since = self._silent_since or now

    def _come_to_rest(self) -> Generator[None, None, StatusReport]:
        """Hold a moving pusher, at its first report, and wait until it rests; with only_look, do neither."""
        status = self._status or (yield from self._report())
        while True:
            before = self._place
            if not moves(status):
                again = yield from self._report()
                same = before is not None and before == self._place
                if again.state == status.state == "Alarm" or (same and not moves(again)):
                    return again
                status = again
            self._suspect("it moved when it was found")
            if self._role is Role.LOOKS:
                return status
            self.hold()
            status = yield from self._report()

    def _ask_for_settings(self, *lines: str) -> Script:
        """Ask for the settings until two answers agree: they say what a report means, and have no checksum."""
        before: dict[int | str, str] | None = None
        for _ in range(ASKED_FOR_TWO_ALIKE):
            self._settings = {}
            for line in lines:
                yield from self._command(line)
            if self._settings == before:
                return
            before = self._settings
        asked = f"{self.name}: its settings ({lines[0]}) came"
        raise NotConnected(f"{asked} {ASKED_FOR_TWO_ALIKE} times, each time different")

    def _find_place(self) -> Script:
        """Wait until two reports in a row give the same place of all axes, at rest, because one may be damaged."""
        before: tuple[float, ...] | None = None
        for _ in range(REPORTS_UNTIL_PLACE):
            status = yield from self._report()
            known = status.work_position is not None or self._offset is not None
            here = self._place if known and self._last is not None and not moves(status) else None
            if here is not None and here == before:
                self._still, self._strayed = here, False
                self._held = self._holding(status)
                if self._held is not None and Phase.CONNECTING not in self._state:
                    raise Held(f"held at the controller: {self._held}; release it, then reset")
                if self._held is not None:
                    self._suspect(f"held at the controller: {self._held}")
                return
            before = here

    def _seek_home(self) -> Script:
        yield from self._command(self._homing_line, HOMING_TIMEOUT)
        yield from self._find_place()
        if self._last is not None:
            self._zero += self._sign * self._last.position / MM
        self._plausibility.forget()

    def _streaming(self) -> Script:
        """Send the pieces of a stroke, as there is room for them, until the pusher rests at its end."""
        assert self._last is not None
        assert self._stroke is not None
        stroke = self._stroke
        self._ensure_full_feed()
        self._answer, began, waits = None, clock(), False
        moved, place = began, self._last.position
        idle, short, seen, believed, patience = 0, False, self._statuses, self._believed, REFUSED_OFTEN
        while True:
            now = clock()
            if self._pending is not None and (waited := now - self._sent_at) > self._silence:
                line, self._pending = self._pending, None
                raise Timeout(f'no answer to "{line}" for {waited:.2f} s; silence is {self._silence:g} s')
            if isinstance(self._answer, Refused):
                if not self._answer.passing or not patience:
                    raise self._answer
                # a piece that arrives at the very end of the one before runs as an ordinary line, and blocks jogs until its end
                self._answer, patience, waits = None, patience - 1, True
                stroke.take_back()
            if self._pending is None:
                stroke.accept(now)
            if self._believed > believed:
                believed = self._believed
                if self._last.position != place:
                    moved, place = now, self._last.position
                assert self._status is not None
                stroke.check(self._last.position, self._last.speed)
                if self._status.feed is not None and stroke.is_slowed(self._last.position, self._last.speed, self._asked_last):
                    raise Held(f"held at the controller: the pusher slowed down at {self._last.position:.4f} m")
            if now - moved > max(STANDS, self._silence):
                raise Held(f"held at the controller: the pusher stands still at {place:.4f} m")
            stroke.check_time(now - began)
            waits = waits and (self._status is None or self._status.state != "Idle" or self._statuses == seen)
            if self._pending is None and self._statuses > seen:
                seen = self._statuses
                assert self._status is not None
                if self.mode is Mode.ALARM:  # the line with its number was lost
                    raise self._halted()
                # right after its `ok` a controller may still report that it idles where it was
                idle = idle + 1 if self._status.state == "Idle" else 0
                short = abs(self._last.position - stroke.sent) > self._resolution
                if idle and stroke.all_sent and not short:
                    return
                if idle >= self.idle_reports:
                    rests = f"the pusher rests at {self._last.position:.4f} m"
                    raise Held(f"held at the controller, or a line was lost: {rests}, was sent to {stroke.sent:.4f} m")
            stands = waits or (idle and short)
            if self._pending is None and not stands and (end := stroke.next_piece(self._last.position)) is not None:
                self._send_line(self._piece(end, stroke.speed))
                idle, seen = 0, self._statuses
            if now - self._last_ask >= ASK_MOVING:
                self._ask(self._now_stamp)
            yield

    def _braking(self) -> Script:
        """Wait for the end of a feed hold: a reset before it costs the position. A stuck controller is reset anyway."""
        braking = self.limits.max_speed / self.limits.acceleration
        deadline = clock() + 1 + (braking if math.isfinite(braking) else 0)
        before = None
        while clock() < deadline:
            try:
                status = yield from self._report()
            except Timeout:
                return
            moving = moves(status)
            place = status.machine_position or status.work_position
            if not moving and place == before:
                return
            if status.state in ("Run", "Jog"):
                self.hold()  # a line that was on its way starts a motion again; a second hold does no harm
            before = None if moving else place

    def _send_line(self, line: str) -> None:
        self._pending, self._answer, self._sent_at = line, None, clock()
        self._write(line.encode() + b"\n")

    def _command(self, line: str, timeout: float = ANSWER_TIMEOUT) -> Script:
        self._send_line(line)
        deadline = clock() + timeout
        while self._answer is None or self._answer == WIPED:
            if clock() > deadline:
                self._pending = None
                raise Timeout(f'no answer to "{line}" within {timeout:g} s')
            if self._answer == WIPED:
                self._send_line(line)
            if clock() - self._last_ask >= ASK_AGAIN:
                self._ask(None)  # some firmware reads its input only while more arrives
            yield
        if isinstance(self._answer, Refused):
            raise self._answer

    def _report(self) -> Generator[None, None, StatusReport]:
        seen = self._statuses
        deadline = clock() + self._patience
        while self._statuses == seen or self._status is None:
            if clock() > deadline:
                raise Timeout(f"no answer to ? within {self._patience:g} s")
            if clock() - self._last_ask >= ASK_EVERY:
                self._ask(None)
            yield
        return self._status


def moves(status: StatusReport) -> bool:
    """Whether a controller that says this moves."""
    return status.state in ("Run", "Jog", "Home") or (status.state, status.substate) in (("Hold", 1), ("Door", 2), ("Door", 3))
