"""Driver of a pusher behind a GRBL 1.1 controller (Arduino GRBL, grblHAL, FluidNC) on a serial port.

A stroke is a stream of short jogs (`$J=`). Each states all of its modes (G21 G90), so no modal state is relied on. No feed
override changes a jog, and a feed hold cancels it.
"""

import math

from pushfric_core.pushers.axis_reports import MM, MM_PER_MINUTE, STATE_MODES, StatusReport
from pushfric_core.pushers.clock import clock
from pushfric_core.pushers.driver import Phase, Role, Script
from pushfric_core.pushers.grbl_protocol import (
    ALARM,
    AXIS_SOFT_LIMITS,
    BUILD,
    ERROR,
    GREETING,
    HOLDS,
    MODES,
    PARAMETER,
    SETTING,
    Alarm,
    CommandRefused,
    RealTime,
    parse_status,
    work_offset_of,
)
from pushfric_core.pushers.pusher import Halted, Held, Jumped, Limits, Mode, NotConnected, Timeout
from pushfric_core.pushers.serial_line import WIPED
from pushfric_core.pushers.serial_pusher import (
    ASKED_FOR_TWO_ALIKE,
    SerialPusher,
)
from pushfric_core.pushers.serial_settings import AXES

RESET_AGAIN = 1.0  # [s]
RESET_PATIENCE = 6.0  # a greeting after a reset may take this long [s]
OFFSET_ROUNDING = 2e-3  # a sum of rounded numbers [mm]
INCH = 25.4  # [mm]
ECHOED = b"".join(command.value for command in RealTime)
"""The characters that a terminal in between may echo, even in the middle of a line."""


class Grbl(SerialPusher):
    """A Pusher: one linear axis of a GRBL 1.1 controller."""

    sign_of_life = "Ctrl-X in a terminal at that baud rate must bring a greeting"
    _restarted = False  # by itself, in the last connection

    def _forget(self) -> None:
        super()._forget()
        self._greetings = 0
        self._owed = 0  # greetings, for resets that were sent
        self._unasked = 0  # answers to a line from before a reset, or about the controller's own memory
        self._claimed_offset: tuple[float, ...] | None = None  # reported, and not confirmed yet
        self._parameters: dict[str, str] = {}  # answers to $#
        self._modes = ""  # answer to $G

    @staticmethod
    def settings_of(axis: str) -> tuple[str, str, str]:
        index = AXES.index(axis)
        return f"${130 + index}", f"${110 + index}", f"${120 + index}"

    # What is sent

    def send(self, *commands: RealTime) -> None:
        """Send real-time commands, at once. Raises NotConnected."""
        self._line.write(b"".join(command.value for command in commands))

    def hold(self, homing: bool = False) -> None:
        self.send(RealTime.HOLD)

    def _last_words(self, homing: bool) -> bytes:
        # a hold cancels a jog; only a reset ends a homing cycle
        return RealTime.HOLD.value + (RealTime.RESET.value if homing else b"")

    def _send_question(self) -> None:
        self.send(RealTime.ASK)

    def _ensure_full_feed(self) -> None:
        self.send(RealTime.FULL_FEED)

    def _halted(self) -> Halted:
        return Alarm(None if self._axis.status is None else self._axis.status.substate)

    @property
    def limits(self) -> Limits:
        travel = math.inf
        if self._settings.get(20, "0") != "0":
            # homing ends this far inside the travel
            homes = int(self._setting(22, 0.0)) & 1  # grblHAL says more in the other bits
            pull_off = self._setting(27, 0.0) if homes else 0.0
            travel = (self._axis_setting(130) - pull_off) * MM
        return Limits(travel, self._axis_setting(110) * MM_PER_MINUTE, self._axis_setting(120) * MM)

    def _axis_setting(self, first: int) -> float:
        """Infinite if the firmware keeps it elsewhere."""
        return self._setting(first + self._axis.index, math.inf)

    def _setting(self, number: int, otherwise: float) -> float:
        try:
            return float(self._settings[number])
        except (KeyError, ValueError):
            return otherwise

    def _take(self, raw: bytes) -> None:
        """Take one line; startup lines, echoes, feedback and noise are ignored."""
        line, pending = raw.translate(None, ECHOED).decode("ascii", errors="replace").strip(), self._line.pending
        if (greeting := GREETING.search(line)) is not None:  # a restart may cut off another line
            self._take_greeting(greeting[1])
        elif (status := parse_status(line)) is not None:
            self._take_status(status)
        elif line.startswith("<"):
            self._axis.damaged += 1
        elif (error := ERROR.fullmatch(line)) is not None or line == "ok":
            if pending is not None:
                self._line.answered(line if error is None else CommandRefused(pending, int(error[1])))
                self._owed = 0  # so every greeting that was due before it has come
            else:
                self._unasked += 1
        elif (alarm := ALARM.fullmatch(line)) is not None:
            self._axis.status = StatusReport("Alarm")
            self._blame(Alarm(int(alarm[1])))  # a restart may bring an alarm of its own
        elif (held := HOLDS.match(line)) is not None:
            self._hear_of_hold(f'it says "{held[1]}"')
        elif (build := BUILD.match(line)) is not None:
            self._version = f"Grbl {build[1]}"
        elif (setting := SETTING.match(line)) is not None and pending == "$$":
            self._settings[int(setting[1])] = setting[2]
        elif (own := AXIS_SOFT_LIMITS.fullmatch(line)) is not None and pending == line.partition("=")[0]:
            self._settings[20] = str(int(own[1] == "true"))
        elif (parameter := PARAMETER.fullmatch(line)) is not None and pending == "$#":
            self._parameters[parameter[1]] = parameter[2]
        elif (modes := MODES.fullmatch(line)) is not None and pending == "$G":
            self._modes = modes[1]

    def _take_greeting(self, version: str) -> None:
        self._greetings += 1
        self._version = self._version or f"Grbl {version}"  # $I says more than the greeting
        if self._line.pending is not None:
            self._line.answered(WIPED)
        if self._owed:
            self._owed -= 1
        else:
            self._restarted |= self._connected
            self._trouble = NotConnected(f"the controller at {self._line.path} restarted")

    def _take_offset(self, status: StatusReport) -> None:
        """Take the work offset of a report. It displaces all positions, so a new one must come twice to mean anything."""
        offset = status.work_offset
        if offset is None:
            return
        again, self._claimed_offset = _agree(offset, self._claimed_offset, self._axis.unit), offset
        if self._axis.offset is None:
            self._axis.offset = offset if again else None
        elif again and not _agree(offset, self._axis.offset, self._axis.unit):
            before, now = (_shown(one, self._axis.unit) for one in (self._axis.offset, offset))
            self._trouble = self._trouble or Jumped(
                f"the work offset of {self._line.path} is ({now}) mm now, it was ({before}) mm"
            )

    # Scripts

    def _connecting(self) -> Script:
        yield from self._await_greeting()
        status = yield from self._come_to_rest()
        if status.state not in ("Idle", "Alarm"):
            if self._role is Role.LOOKS:
                return
            if self.doubt is None:  # otherwise it was this driver that held it
                self._suspect(f"held at the controller: it reported {status.state} when it was found")
            yield from self._reset()  # nothing moves any more, and only now are lines read
            if self._reported is Mode.HOLD:
                raise NotConnected(f"held at the controller at {self._line.path}: it reads nothing until it is released")
        try:
            yield from self._command("$I")
        except Timeout:
            if self._role is Role.LOOKS:
                raise
            # if a jog ends just as it is cancelled, GRBL 1.1h reports Idle and reads no line until a reset
            self._suspect("it read lines only after a reset")
            yield from self._reset()
            yield from self._command("$I")
        if self._version.startswith("Grbl 0."):
            raise NotConnected(f"{self.name} is too old, expected Grbl 1.1")
        # FluidNC's $20 is that of X; it answers "$/axes/y/soft_limits=true"
        own_limits = (
            [f"$/axes/{self._axis.letter.lower()}/soft_limits"] if "FluidNC" in self._version and self._axis.index else []
        )
        yield from self._ask_for_settings("$$", *own_limits)
        self._check_settings()
        self._axis.unit = INCH if self._settings.get(13) == "1" else 1.0
        yield from self._ask_for_offset()
        self._axis.believe_next()  # now that the unit of reports is known
        yield from self._find_place()
        if self._restarted:
            self._suspect("the controller restarted by itself: its reset input, or its supply")
            self._restarted = False

    def _await_greeting(self) -> Script:
        """Wait for the greeting of a board that boots when its port is opened, or the answer of one that runs already."""
        deadline = clock() + self._serial.connect_timeout
        while not self._greetings and not self._axis.statuses:
            if clock() > deadline:
                if self._role is Role.LOOKS:
                    raise NotConnected(f"no GRBL controller answers at {self._line.path}, {self._serial.baud} baud")
                break
            self._ask(None)
            yield
        if self._version.startswith("Grbl 0."):
            raise NotConnected(f"{self.name} is too old, expected Grbl 1.1")
        if not self._greetings and not self._axis.statuses:
            # after a limit, and while it homes, GRBL ignores everything but a reset
            self._suspect("it answered only after a reset")
            self.send(RealTime.HOLD)
            try:
                yield from self._reset()
            except Timeout as error:
                raise NotConnected(f"no GRBL controller answers at {self._line.path}, {self._serial.baud} baud") from error

    def _ask_for_offset(self) -> Script:
        """Ask for the parts of the work offset until two answers agree, or one agrees with a report or with what is known.

        If a controller does not name the parts, the offset of two reports that agree is taken.
        """
        known = before = self._axis.offset
        for _ in range(ASKED_FOR_TWO_ALIKE):
            self._parameters, self._modes = {}, ""
            try:
                yield from self._command("$#")
                yield from self._command("$G")
            except CommandRefused:
                return
            offset = work_offset_of(self._parameters, self._modes)
            if any(_agree(offset, other, self._axis.unit) for other in (before, self._claimed_offset)) or not self._parameters:
                break
            before = offset
        else:
            raise NotConnected(f"{self.name}: its offsets ($#) came {ASKED_FOR_TWO_ALIKE} times, each time different")
        if known is not None and offset is not None and not _agree(offset, known, self._axis.unit):
            was, now = (_shown(one, self._axis.unit) for one in (known, offset))
            self._suspect(f"a reset changed its work offset from ({was}) mm to ({now}) mm")
            self._axis.believe_next()
        self._axis.offset, self._claimed_offset = offset or known, None

    def _check_settings(self) -> None:
        """Raises NotConnected if a setting that matters has an impossible value."""
        must_be_positive = {100 + self._axis.index, 110 + self._axis.index, 120 + self._axis.index}
        for number in sorted(must_be_positive | {20, 22, 27, 130 + self._axis.index}):
            text = self._settings.get(number)
            try:
                value = float(text or "nan")
            except ValueError:
                continue  # such as n/a: the firmware keeps it elsewhere
            if text and not (0 <= value < math.inf and (value > 0 or number not in must_be_positive)):
                shown = text if len(text) <= 20 else f"{text[:20]}..."
                expected = "a positive number" if number in must_be_positive else "0 or more"
                raise NotConnected(f"{self.name} is set to ${number}={shown}, expected {expected}")

    def _unlock(self) -> Script:
        if self.mode is Mode.ALARM:
            yield from self._command("$X")
        yield from super()._unlock()

    @property
    def _homing_line(self) -> str:
        return "$H"

    def _piece(self, position: float, speed: float) -> str:
        # adding 0.0 turns -0.0 into 0.0
        target = round(self._axis.zero + self._axis.sign * position / MM, 3) + 0.0
        return f"$J=G21G90{self._axis.letter}{target:.3f}F{speed / MM_PER_MINUTE:.3f}"

    @property
    def _resolution(self) -> float:
        """How near the controller gets to a target [m]: a motor step, or the last digit of a report in inches."""
        return max(0.02, 1 / self._axis_setting(100)) * MM

    def _reset(self) -> Script:
        """Raises Timeout if the controller does not answer afterwards."""
        if self._line.pending is not None and "FluidNC" in self._version:
            # it would carry out that line after the reset; where it is held by then, it refuses it
            unasked = self._unasked
            yield from self._restart(RealTime.HOLD)
            refused_by = clock() + RESET_AGAIN
            while self._unasked == unasked and clock() < refused_by:
                yield
        yield from self._restart()
        settled = clock() + RESET_AGAIN
        while self._owed and clock() < settled:  # a second reset would wipe out what is sent now
            yield
        status = yield from self._report()
        if status.state not in STATE_MODES:  # it reads no line until it is released
            if Phase.RECOVERING in self._state:
                raise Held(f"held at the controller: {self._holding(status)}; release it, then reset")
        elif self._axis.offset is not None:  # a reset ends shifts (G92) and may choose another coordinate system
            yield from self._ask_for_offset()
            yield from self._report()

    def _restart(self, *then: RealTime) -> Script:
        """Reset the controller and send at once what comes then. Raises Timeout if no greeting comes."""
        # for half a second, while it reports its alarm, GRBL drops a reset
        dropped = self._axis.status is not None and self._axis.status.state == "Alarm"
        before = self._greetings
        self._line.discard()  # a reset wipes out what was sent
        self._send_reset(*then)
        again, deadline = clock() + RESET_AGAIN, clock() + RESET_PATIENCE
        while self._greetings == before and clock() < deadline:
            if dropped and clock() > again:
                self._send_reset(*then)
                dropped = False
            yield
        if self._greetings == before:  # whatever it reports then, it may have restarted unheard
            raise Timeout(f"no greeting within {RESET_PATIENCE:g} s of a reset")

    def _send_reset(self, *then: RealTime) -> None:
        self.send(RealTime.RESET, *then)
        self._owed += 1


def _agree(offset: tuple[float, ...] | None, other: tuple[float, ...] | None, unit: float) -> bool:
    if offset is None or other is None or len(offset) != len(other):
        return False
    return all(abs(one - another) * unit <= OFFSET_ROUNDING for one, another in zip(offset, other, strict=True))


def _shown(offset: tuple[float, ...], unit: float) -> str:
    return ", ".join(f"{value * unit:.3f}" for value in offset)
