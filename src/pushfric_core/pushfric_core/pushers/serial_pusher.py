"""The common part of all drivers of a controller on a serial port: a stroke is a stream of short pieces.

The controller never has more of a stroke than it moves through in the time `ahead`, judged by the positions that it reports. If
this process dies, hangs or loses the line, the pusher therefore stops after that time. Flow control is send-and-wait: a line is
sent only after the controller has answered the last one.
"""

import math
import statistics
from abc import abstractmethod
from collections.abc import Callable, Generator, Mapping
from typing import TYPE_CHECKING, ClassVar

from pushfric_core.pushers.axis_reports import MM, STATE_MODES, AxisReports, StatusReport, moves
from pushfric_core.pushers.clock import clock
from pushfric_core.pushers.driver import STOPPING, Driver, Phase, Role, Script
from pushfric_core.pushers.pusher import (
    Halted,
    Held,
    Limits,
    Mode,
    NotConnected,
    NotReady,
    PusherConfig,
    PusherReport,
    Timeout,
)
from pushfric_core.pushers.serial_line import WIPED, Refused, SerialLine, identity_of
from pushfric_core.pushers.serial_settings import AXES, SerialSettings
from pushfric_core.pushers.states import Homing, State
from pushfric_core.pushers.stroke import Stroke

if TYPE_CHECKING:
    pass

ANSWER_TIMEOUT = 3.0  # [s], as all below
HOMING_TIMEOUT = 180.0
ASK_EVERY = 0.05  # while a script waits for reports
ASK_MOVING = 0.025  # in a stroke
ASK_AGAIN = 0.25  # a question that was not answered
ASK_AGAIN_MOVING = 0.06
STANDS = 1.0  # a pusher that stands still in mid-stroke
SILENCE = 2.0  # at rest, unless the setting silence allows more
ASKED_FOR_TWO_ALIKE = 6  # settings and offsets, which have no checksum
REPORTS_UNTIL_PLACE = 62  # GRBL's offset comes with every 30th report at the latest, and counts once it has come twice
REFUSED_OFTEN = 5  # this many pieces may be refused, and sent again, in one stroke

INPUTS = {"D": "door", "H": "feed hold", "R": "reset", "E": "emergency stop", "M": "motor fault"}
"""Inputs by which a person, or the wiring, holds a controller, by the letters of its reports."""


class SerialPusher(Driver):
    """A Pusher: one linear axis of a controller on a serial port.

    Stroke position 0 is where the axis rests after homing; without homing, the zero of the controller's work coordinates.
    """

    def __init__(self, settings: SerialSettings, home: bool = PusherConfig.home, only_look: bool = False) -> None:
        """Nothing is opened yet.

        Args:
            settings: of the port and of the axis.
            home: `recover` seeks the home switch; otherwise it unlocks an alarm.
            only_look: never move, hold or reset the controller, and send it no line while it moves.
        """
        self._serial, self._line = settings, SerialLine(settings.port, settings.baud)
        self._axis = AxisReports(settings.axis, settings.real_time_factor, self._blame)
        super().__init__(
            settings.silence,
            max(SILENCE, settings.silence) + self.deaf_after_stop,
            Homing.HOMES if home else Homing.UNLOCKS,
            Role.LOOKS if only_look else Role.DRIVES,
        )

    def _forget(self) -> None:
        super()._forget()
        self._line.forget()
        self._axis.forget()
        self._held: str | None = None  # what holds the controller, unless it is this driver
        self._limits = ""  # pins that were active when the stroke began
        self._fresh: PusherReport | None = None
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

    def _ensure_full_feed(self) -> None:
        """Let the controller move as fast as it is told, if it has an override. Raises NotConnected."""

    def _scripts(self) -> Mapping[Phase, Callable[[], Script]]:
        return {
            Phase.CONNECTING: self._connecting,
            Phase.STREAMING: self._streaming,
            Phase.BRAKING: self._braking,
            Phase.RESETTING: self._reset,
            Phase.RECOVERING: self._reset,
            Phase.HOMING: self._seek_home,
            Phase.UNLOCKING: self._unlock,
        }

    @abstractmethod
    def _connecting(self) -> Script: ...

    @abstractmethod
    def _reset(self) -> Script: ...

    def _unlock(self) -> Script:
        """Nothing is locked."""
        yield from self._find_place()

    @property
    @abstractmethod
    def limits(self) -> Limits: ...

    def _take_offset(self, status: StatusReport) -> None:
        """Take what a report says of the work offset, if the controller has one."""

    @property
    def _reported(self) -> Mode:
        return self._axis.mode

    @property
    def name(self) -> str:
        return f"{self._version or 'no controller'} at {self._line.path}"

    @property
    def place(self) -> str:
        return identity_of(self._line.path)

    @property
    def dropped(self) -> int:
        return self._axis.dropped

    def _open(self) -> None:
        self._line.open()

    def _leave(self, before: State, in_motion: bool) -> None:
        self._line.close(self._last_words(Phase.HOMING in before) if in_motion else b"")

    def _start(self, position: float, speed: float) -> Stroke:
        """Raises NotReady if the controller answers too late."""
        latency = statistics.median(self._line.latencies or [0.0])
        if latency > self._silence:
            raise NotReady(f"the controller at {self._line.path} answers after {latency:.2f} s; silence is {self._silence:g} s")
        assert self._axis.last is not None
        assert self._axis.status is not None
        self._limits = self._axis.status.pins
        wait = max(0.0, self._silence - SerialSettings.silence)  # allowed on a busy machine, to each piece
        ahead, latency = (seconds * self._serial.real_time_factor for seconds in (self._serial.ahead, latency))
        return Stroke(self._axis.last.position, position, speed, self.limits.acceleration, ahead, wait, latency)

    def ask(self, stamp: int) -> None:
        if self._connected and Phase.HOMING not in self._state:
            with self._left_if_lost():
                self._ask(stamp)

    # Bytes, lines, meaning

    def _hear(self) -> None:
        self._fresh = None
        for line in self._line.read():
            self._take(line)

    def _take_status(self, status: StatusReport) -> None:
        """Take a status report; one that cannot be true changes nothing."""
        now, asked, axis = clock(), self._line.report_since, self._axis
        if self._state & {Phase.HOMING, Phase.RECOVERING}:  # positions start again, or a person has looked
            axis.still = None
            axis.believe_next()
        if not axis.others_are_still(status):
            self._line.misheard()
            return
        self._take_offset(status)
        position, stamp = axis.position_of(status), self._now_stamp if self._line.stamp is None else self._line.stamp
        if position is not None:
            if not axis.can_be_true(position, status, asked, now, self.limits.max_speed, self._stroke):
                self._line.misheard()
                return
            # in these states grblHAL reports no feed while it brakes, and the programmed feed at rest
            feed = None if status.state in ("Hold", "Door") else status.feed
            speed = self._speed(position, feed, stamp, moves(status))
        self._line.reported(now)
        axis.heard(status)
        if status.overrides and status.overrides[0] != 100 and Phase.STREAMING in self._state:
            self._ensure_full_feed()
        self._hear_of_hold(self._holding(status))
        if position is not None:
            self._fresh = PusherReport(position, speed, self.mode, stamp)
            axis.believe(self._fresh)

    def _hear_of_hold(self, why: str | None) -> None:
        """Take what the controller says it is held by, unless this driver holds it; it counts once."""
        if self._role is Role.DRIVES and self._state & {Phase.RESTING, Phase.STREAMING, *STOPPING}:
            before, self._held = self._held, why
            if why is not None and before is None:
                self._blame(Held(f"held at the controller: {why}"))

    def _holding(self, status: StatusReport) -> str | None:
        """The hold that a report shows: the controller does not move, although this driver has not told it so; or None."""
        own = status.state == "Hold" and not STOPPING.isdisjoint(self._state)
        if status.state not in STATE_MODES and not own:
            return f"it reports {status.state}"
        for pin, name in INPUTS.items():
            if pin in status.pins:
                return f"its {name} input is active"
        streams = Phase.STREAMING in self._state and status.state != "Alarm"
        if streams and (reached := set(status.pins) & set(AXES) - set(self._limits)):
            return f"its limit input {min(reached)} became active"
        return None

    def _speed(self, position: float, feed: float | None, stamp: int | None, moving: bool) -> float:
        """See AxisReports.speed."""
        return self._axis.speed(position, feed, stamp, moving)

    def _newest(self) -> PusherReport | None:
        return self._fresh

    @property
    def _silent(self) -> float:
        since = self._line.silent_since
        return 0.0 if since is None or self._state & {Phase.BRAKING, Phase.HOMING} else clock() - since

    def _ask(self, stamp: int | None) -> None:
        if self._line.may_ask(ASK_AGAIN_MOVING if Phase.STREAMING in self._state else ASK_AGAIN):
            self._send_question()
            self._line.asked(stamp)

    def _come_to_rest(self) -> Generator[None, None, StatusReport]:
        """Hold a moving pusher, at its first report, and wait until it rests; with only_look, do neither."""
        status = self._axis.status or (yield from self._report())
        while True:
            before = self._axis.place
            if not moves(status):
                again = yield from self._report()
                same = before is not None and before == self._axis.place
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
            known = status.work_position is not None or self._axis.offset is not None
            here = self._axis.place if known and self._axis.last is not None and not moves(status) else None
            if here is not None and here == before:
                if self._role is Role.DRIVES:  # otherwise somebody else may move them
                    self._axis.stay()
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
        if self._axis.last is not None:
            self._axis.zero += self._axis.sign * self._axis.last.position / MM
        self._axis.believe_next()

    def _streaming(self) -> Script:
        """Send the pieces of a stroke, as there is room for them, until the pusher rests at its end."""
        assert self._stroke is not None
        stroke, line, axis = self._stroke, self._line, self._axis
        self._ensure_full_feed()
        line.answer, began, waits = None, clock(), False
        moved, place = began, stroke.start
        idle, short, seen, believed, patience = 0, False, axis.statuses, axis.believed, REFUSED_OFTEN
        while True:
            now, last = clock(), axis.last
            assert last is not None
            if line.pending is not None and (waited := now - line.sent_at) > self._silence:
                raise Timeout(f'no answer to "{line.pending}" for {waited:.2f} s; silence is {self._silence:g} s')
            if isinstance(line.answer, Refused):
                if not line.answer.passing or not patience:
                    raise line.answer
                # a piece that arrives at the very end of the one before runs as an ordinary line, and blocks jogs until its end
                line.answer, patience, waits = None, patience - 1, True
                stroke.take_back()
            if line.pending is None:
                stroke.accept(now)
            if axis.believed > believed:
                believed = axis.believed
                if last.position != place:
                    moved, place = now, last.position
                assert axis.status is not None
                stroke.check(last.position, last.speed)
                slowed = stroke.is_slowed(last.position, last.speed, line.reported_of)
                if slowed and axis.status.feed is not None:
                    raise Held(f"held at the controller: the pusher slowed down at {last.position:.4f} m")
            if now - moved > max(STANDS, self._silence):
                raise Held(f"held at the controller: the pusher stands still at {place:.4f} m")
            stroke.check_time(now - began)
            waits = waits and (axis.status is None or axis.status.state != "Idle" or axis.statuses == seen)
            if line.pending is None and axis.statuses > seen:
                seen = axis.statuses
                assert axis.status is not None
                if self.mode is Mode.ALARM:  # the line with its number was lost
                    raise self._halted()
                # right after its `ok` a controller may still report that it idles where it was
                idle = idle + 1 if axis.status.state == "Idle" else 0
                short = abs(last.position - stroke.sent) > self._resolution
                if idle and stroke.all_sent and not short:
                    return
                if idle >= self.idle_reports:
                    rests = f"the pusher rests at {last.position:.4f} m"
                    raise Held(f"held at the controller, or a line was lost: {rests}, was sent to {stroke.sent:.4f} m")
            stands = waits or (idle and short)
            if line.pending is None and not stands and (end := stroke.next_piece(last.position)) is not None:
                self._send_line(self._piece(end, stroke.speed))
                idle, seen = 0, axis.statuses
            if now - line.asked_at >= ASK_MOVING:
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
            moving, place = moves(status), self._axis.place
            if not moving and place == before:
                return
            if status.state in ("Run", "Jog"):
                self.hold()  # a line that was on its way starts a motion again; a second hold does no harm
            before = None if moving else place

    def _send_line(self, line: str) -> None:
        self._line.send(line, line.encode() + b"\n")

    def _command(self, text: str, timeout: float = ANSWER_TIMEOUT) -> Script:
        self._send_line(text)
        line, deadline = self._line, clock() + timeout
        while line.answer is None or line.answer == WIPED:
            if clock() > deadline:
                line.pending = None
                raise Timeout(f'no answer to "{text}" within {timeout:g} s')
            if line.answer == WIPED:
                self._send_line(text)
            if clock() - line.asked_at >= ASK_AGAIN:
                self._ask(None)  # some firmware reads its input only while more arrives
            yield
        if isinstance(line.answer, Refused):
            raise line.answer

    def _report(self) -> Generator[None, None, StatusReport]:
        seen = self._axis.statuses
        deadline = clock() + self._patience
        while self._axis.statuses == seen or self._axis.status is None:
            if clock() > deadline:
                raise Timeout(f"no answer to ? within {self._patience:g} s")
            if clock() - self._line.asked_at >= ASK_EVERY:
                self._ask(None)
            yield
        return self._axis.status
