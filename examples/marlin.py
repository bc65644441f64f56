"""A driver of your own for a line protocol: a pusher behind a controller with the firmware Marlin 2, on a serial port.

A package registers `MarlinConfig` as an entry point of the group pushfric.pushers, `marlin = marlin:MarlinConfig`; then a
cell's file chooses it with `pusher: {driver: marlin, port: ...}`. docs/safety.md says what was run. See what it does:

pushfric rehearse --driver marlin --set port=/dev/ttyUSB0 --set baud=250000 --stroke 0.06

Build the firmware with axes that may move before homing, and no filament sensor.

A stroke is a stream of short lines (`G1`). Each line has a number and a checksum, so the controller refuses a damaged one and
asks for it again. Marlin has no jog that can be cancelled and no feed hold: the pusher stops because its planner never holds
more than the next pieces of the stroke, or at once by a quick stop (`M410`), which does not brake: positions remain true as
long as the motor can stop from that speed without losing a step. `M112` ends a homing cycle; only a new start of the controller
ends what follows.

The position comes from `M114 R`, for which the firmware must be built with M114_REALTIME: any other tells where the last line
will end. The driver sees this by the first pieces of a stroke, and goes no further.
"""

import functools
import math
import operator
import re
from collections import deque
from dataclasses import dataclass

from pushfric_core.pushers.axis_reports import MM, MM_PER_MINUTE, StatusReport, moves
from pushfric_core.pushers.clock import clock
from pushfric_core.pushers.driver import Phase, Role, Script
from pushfric_core.pushers.pusher import Halted, Limits, NotConnected, NotReady, Timeout
from pushfric_core.pushers.serial_config import SerialConfig
from pushfric_core.pushers.serial_line import Refused
from pushfric_core.pushers.serial_pusher import SerialPusher
from pushfric_core.pushers.stroke import Plausibility

QUESTION, STOP, KILL = "M114 R", "M410", "M112"
WHO = "M115"
MODES = ("M84 S0", "G21", "G90", "M220 S100")
"""Before each stroke: keep the motors on, millimetres, absolute positions, the feed as it is told."""
ASK_WHO_EVERY = 0.5  # [s]
BEGINS_WITHIN = 0.3  # it waits 0.1 s before it carries out the first line [s]
MOST_UNANSWERED = 2  # questions; the controller keeps four lines, and reads a stop only if there is room
REST_WITHIN = 5.0  # [s]
MEASURED_OVER = 0.3  # a speed is measured over this time [s]

POSITION = re.compile(r"X:(-?\d+\.\d+) Y:(-?\d+\.\d+) Z:(-?\d+\.\d+)(?: [A-Z]:-?\d+\.\d+)* Count .*", re.ASCII)
FIRMWARE = re.compile(r"FIRMWARE_NAME:(Marlin [^( ]{1,40})")
RESEND = re.compile(r"Resend: ?(\d{1,9})", re.ASCII)
SETTING = re.compile(r"(?:echo:)?\s*(M(?:92|201|203|204)) (.{1,200})")
WORD = re.compile(r"([A-Z])(\d{1,9}(?:\.\d{1,6})?)", re.ASCII)


class Damaged(Refused):
    """The controller got a damaged line, and asks for it again."""

    passing = True


class Marlin(SerialPusher):
    """A Pusher: one of the axes X, Y and Z of a controller with Marlin 2."""

    sign_of_life = "M115 in a terminal at that baud rate must bring FIRMWARE_NAME"
    idle_reports = 40  # it waits before it begins, and says nothing of it
    deaf_after_stop = 2.0

    def _forget(self) -> None:
        super()._forget()
        self._number = 0  # of the last line
        self._unanswered: deque[tuple[str, float]] = deque()  # lines and when they were sent [s]; answered in this order
        self._track: deque[tuple[float, float, float]] = deque()  # when asked, when heard [s], position [m]
        self._began: float | None = None  # when the first piece of a stroke was sent [s]

    @staticmethod
    def settings_of(axis: str) -> tuple[str, str, str]:
        return f"{axis}_MAX_POS", f"M203 {axis}", f"M201 {axis}"

    @property
    def limits(self) -> Limits:
        feed, acceleration = self._setting("M203", self._axis.letter), self._setting("M201", self._axis.letter)
        return Limits(max_speed=feed * MM, acceleration=min(acceleration, self._setting("M204", "T")) * MM)

    def _setting(self, line: str, letter: str) -> float:
        return float(self._settings.get(f"{line} {letter}", "inf"))

    @property
    def _resolution(self) -> float:
        return max(0.02, 1 / self._setting("M92", self._axis.letter)) * MM

    # What is sent

    def hold(self, homing: bool = False) -> None:
        self._send(KILL if homing else STOP)

    def _last_words(self, homing: bool) -> bytes:
        return f"{KILL if homing else STOP}\n".encode()

    def _send_question(self) -> None:
        if sum(line == QUESTION for line, _ in self._unanswered) < MOST_UNANSWERED:
            self._send(QUESTION)

    def _send(self, line: str) -> None:
        """Send a line that asks or stops, and so needs no protection."""
        self._unanswered.append((line, clock()))
        self._line.write(line.encode() + b"\n")

    def _send_line(self, line: str) -> None:
        self._unanswered.append((line, clock()))
        if self._role is Role.LOOKS:
            super()._send_line(line)
            return
        self._number += 1
        numbered = f"N{self._number} {line}".encode()
        self._line.send(line, b"%b*%d\n" % (numbered, functools.reduce(operator.xor, numbered)))

    @property
    def _homing_line(self) -> str:
        return f"G28 {self._axis.letter}"

    def _piece(self, position: float, speed: float) -> str:
        target = round(self._axis.zero + self._axis.sign * position / MM, 3) + 0.0  # 0.0 turns -0.0 into 0.0
        return f"G1 {self._axis.letter}{target:.3f} F{speed / MM_PER_MINUTE:.3f}"

    # What it says

    def _take(self, raw: bytes) -> None:
        """Take one line; what is not named here means nothing to a pusher."""
        line = raw.decode("ascii", errors="replace").strip()
        if (position := POSITION.fullmatch(line)) is not None:
            self._take_position(tuple(map(float, position.groups())))
        elif line.startswith("ok"):
            if self._unanswered:
                self._answered("ok")
        elif (firmware := FIRMWARE.match(line)) is not None:
            self._version = firmware[1]
        elif (resend := RESEND.match(line)) is not None:
            self._number = int(resend[1]) - 1
            if (line := self._line.pending) is not None:  # the `ok` that follows is that of the line that it refused
                self._line.answered(Damaged(f'"{line}" came damaged'))
        elif line == "start":
            self._trouble = NotConnected(f"the controller at {self._line.path} restarted")
        elif line.startswith("Error:") and "halted" in line:
            self._axis.status = StatusReport("Alarm")
            self._blame(self._halted())
        elif (setting := SETTING.match(line)) is not None and self._line.pending == "M503":
            self._settings.update({f"{setting[1]} {letter}": value for letter, value in WORD.findall(setting[2])})

    def _answered(self, answer: str) -> None:
        """The oldest line has been carried out, or planned."""
        if self._unanswered.popleft()[0] == self._line.pending:
            self._line.answered(answer)

    def _take_position(self, place: tuple[float, ...]) -> None:
        while self._unanswered and self._unanswered[0][0] != QUESTION:  # lines are answered in their order
            self._answered("ok")
        if self._unanswered:  # the line knows only of the last question, which a later report answers
            self._line.silent_since = self._unanswered[0][1]
        believed = self._axis.believed
        self._take_status(StatusReport("Idle" if self._axis.place in (None, place) else "Run", work_position=place))
        if self._axis.believed > believed and self._axis.last is not None:
            self._check_real(self._axis.last.position)

    def _check_real(self, position: float) -> None:
        """See that a report tells where the pusher is, not where it is going."""
        stroke = self._stroke
        if stroke is None or Phase.STREAMING not in self._state or self._began is None:
            return
        gone, elapsed = abs(position - stroke.start), self._serial.real_time_factor * (clock() - self._began)
        if gone > Plausibility.MARGIN * stroke.speed * elapsed + Plausibility.SLACK:
            why = "its firmware needs M114_REALTIME, or the pusher was moved"
            went = f"{gone / MM:.1f} mm after {elapsed:.2f} s of a stroke at {stroke.speed / MM:g} mm/s"
            self._blame(NotReady(f"{self.name} reports {went}: {why}"))

    def _halted(self) -> Halted:
        return Halted("Marlin was halted: switch the controller off and on")

    def _speed(self, position: float, feed: float | None, stamp: int | None, moving: bool) -> float:
        """The least speed that the reports of the last MEASURED_OVER prove, because a report may be late."""
        now = clock()
        if not moving:
            self._track.clear()
        while self._track and now - self._track[0][1] > MEASURED_OVER:
            self._track.popleft()
        self._track.append((self._line.report_since, now, position))
        asked, _, before = self._track[0]
        return (position - before) / (now - asked) if moving and now > asked else 0.0

    # Scripts

    def _connecting(self) -> Script:
        yield from self._ask_who()
        found = clock()
        yield from self._come_to_rest()
        if self._role is Role.DRIVES:
            yield from self._reset()
        yield from self._ask_for_settings("M503")
        for line in ("M92", "M201", "M203"):
            if not 0 < (value := self._setting(line, self._axis.letter)) < math.inf:
                raise NotConnected(f"{self.name} is set to {line} {self._axis.letter}{value:g}, expected a positive number")
        while clock() < found + BEGINS_WITHIN:
            yield
        yield from self._come_to_rest()
        yield from self._find_place()

    def _ask_who(self) -> Script:
        deadline, again = clock() + self._serial.connect_timeout, 0.0
        while not self._version:
            if clock() > deadline:
                halted = "; if it was halted (M112), switch it off and on"
                raise NotConnected(f"no Marlin controller answers at {self._line.path}, {self._serial.baud} baud{halted}")
            if clock() > again:
                again = clock() + ASK_WHO_EVERY
                self._line.write(b"\n")  # ends what the line may have brought before
                self._send(WHO)
            yield
        self._trouble = None  # that it started is no news

    def _reset(self) -> Script:
        # what is not answered yet still will be, before what follows: its answer must not count as another line's
        self._line.discard()
        self._number = -1
        yield from self._command("M110 N0")
        yield from self._report()

    def _braking(self) -> Script:
        """Wait until it rests. Even if the stop was lost, the planner soon runs dry; if it does not, only a kill is left."""
        deadline = clock() + REST_WITHIN
        status = yield from self._report()
        while moves(status):
            if clock() > deadline:
                self._send(KILL)
                raise Timeout(f"{self.name} still moves {REST_WITHIN:g} s after it was told to stop, and was killed (M112)")
            status = yield from self._report()

    def _streaming(self) -> Script:
        self._began = None
        for line in MODES:
            yield from self._command(line)
        self._began = clock()
        yield from super()._streaming()


@dataclass(frozen=True)
class MarlinConfig(SerialConfig):
    """The settings of the driver in a cell's file: a controller with Marlin 2, built with M114_REALTIME."""

    firmware = "Marlin"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.axis[-1] not in "XYZ":
            raise ValueError(f"axis must be X, Y or Z, or one of them with a minus sign, got {self.axis!r}")

    def driver_class(self) -> type[SerialPusher]:
        """See SerialConfig."""
        return Marlin
