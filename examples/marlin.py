"""A dialect of your own for a serial controller: a pusher behind one with the firmware Marlin 2.

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
from dataclasses import dataclass

from pushfric_core.pushers.axis_reports import MM, StatusReport, moves
from pushfric_core.pushers.clock import clock
from pushfric_core.pushers.dialect import Alarmed, Answer, Dialect, Event, Greeting, Settings, Values, Version, number
from pushfric_core.pushers.driver import Script
from pushfric_core.pushers.pusher import Halted, Limits, NotConnected, Timeout
from pushfric_core.pushers.serial_config import SerialConfig
from pushfric_core.pushers.serial_pusher import SerialPusher

STOP, KILL, WHO = b"M410\n", b"M112\n", b"M115\n"
ASK_WHO_EVERY = 0.5  # [s]
BEGINS_WITHIN = 0.3  # it waits 0.1 s before it carries out the first line [s]
REST_WITHIN = 5.0  # [s]

POSITION = re.compile(r"X:(-?\d+\.\d+) Y:(-?\d+\.\d+) Z:(-?\d+\.\d+)(?: [A-Z]:-?\d+\.\d+)* Count .*", re.ASCII)
FIRMWARE = re.compile(r"FIRMWARE_NAME:(Marlin [^( ]{1,40})")
RESEND = re.compile(r"Resend: ?(\d{1,9})", re.ASCII)
SETTING = re.compile(r"(?:echo:)?\s*(M(?:92|201|203|204)) (.{1,200})")
WORD = re.compile(r"([A-Z])(\d{1,9}(?:\.\d{1,6})?)", re.ASCII)


class Marlin(Dialect):
    """Marlin 2, axes X, Y and Z; settings have names such as "M203 X"."""

    sign_of_life = "M115 in a terminal at that baud rate must bring FIRMWARE_NAME"
    question = b"M114 R\n"
    homing_line = "G28 {axis}"
    before_stroke = ("M84 S0", "G21", "G90", "M220 S100")
    """Keep the motors on, millimetres, absolute positions, the feed as it is told."""
    in_order = True
    only_positions = True
    needs_for_truth = "M114_REALTIME"
    idle_reports = 40  # it waits before it begins, and says nothing of it
    deaf_after_stop = 2.0

    def decode(self, raw: bytes) -> Event | None:
        line = raw.decode("ascii", errors="replace").strip()
        event: Event | None = None
        if (position := POSITION.fullmatch(line)) is not None:
            event = StatusReport("", work_position=tuple(map(float, position.groups())))
        elif line.startswith("ok"):
            event = Answer()
        elif (firmware := FIRMWARE.match(line)) is not None:
            event = Version(firmware[1])
        elif (resend := RESEND.match(line)) is not None:
            event = Answer("came damaged", passing=True, resend=int(resend[1]))
        elif line == "start":
            event = Greeting()
        elif line.startswith("Error:") and "halted" in line:
            event = Alarmed()
        elif (setting := SETTING.match(line)) is not None:
            event = Values("M503", {f"{setting[1]} {letter}": value for letter, value in WORD.findall(setting[2])})
        return event

    def piece(self, axis: str, target: float, feed: float) -> str:
        return f"G1 {axis}{target:.3f} F{feed:.3f}"

    def hold(self, homing: bool) -> bytes:
        return KILL if homing else STOP

    def line(self, text: str, number: int) -> bytes:
        numbered = f"N{number} {text}".encode()
        return b"%b*%d\n" % (numbered, functools.reduce(operator.xor, numbered))

    def halted(self, code: int | None) -> Halted:
        return Halted("Marlin was halted: switch the controller off and on")

    @staticmethod
    def settings_of(axis: str) -> tuple[str, str, str, str]:
        return f"{axis}_MAX_POS", f"M203 {axis}", f"M201 {axis}", f"M92 {axis}"

    def limits(self, settings: Settings, axis: str) -> Limits:
        feed, *accelerations = (number(settings, name) for name in (f"M203 {axis}", f"M201 {axis}", "M204 T"))
        return Limits(max_speed=feed * MM, acceleration=min(accelerations) * MM)

    def wrong_setting(self, settings: Settings, axis: str) -> str | None:
        for line in ("M92", "M201", "M203"):
            if not 0 < (value := number(settings, f"{line} {axis}")) < math.inf:
                return f"{line} {axis}{value:g}, expected a positive number"
        return None

    # Scripts

    def connect(self, pusher: SerialPusher) -> Script:
        deadline, again = clock() + pusher.serial.connect_timeout, 0.0
        while not pusher.version:
            if clock() > deadline:
                halted = "; if it was halted (M112), switch it off and on"
                raise NotConnected(f"no Marlin controller answers at {pusher.line.path}, {pusher.serial.baud} baud{halted}")
            if clock() > again:
                again = clock() + ASK_WHO_EVERY
                pusher.line.write(b"\n")  # ends what the line may have brought before
                pusher.line.say(WHO)
            yield
        found = clock()
        yield from pusher.come_to_rest()
        if not pusher.looks:
            yield from self.reset(pusher)
        yield from pusher.ask_for_settings("M503")
        while clock() < found + BEGINS_WITHIN:
            yield
        yield from pusher.come_to_rest()
        yield from pusher.find_place()

    def reset(self, pusher: SerialPusher) -> Script:
        # what is not answered yet still will be, before what follows: its answer must not count as another line's
        pusher.line.discard()
        pusher.line.number = -1
        yield from pusher.command("M110 N0")
        yield from pusher.report()

    def brake(self, pusher: SerialPusher) -> Script:
        """Wait until it rests. Even if the stop was lost, the planner soon runs dry; if it does not, only a kill is left."""
        deadline = clock() + REST_WITHIN
        status = yield from pusher.report()
        while moves(status):
            if clock() > deadline:
                pusher.line.say(KILL)
                raise Timeout(f"{pusher.name} still moves {REST_WITHIN:g} s after it was told to stop, and was killed (M112)")
            status = yield from pusher.report()


@dataclass(frozen=True)
class MarlinConfig(SerialConfig):
    """The settings of the driver in a cell's file: a controller with Marlin 2, built with M114_REALTIME."""

    firmware = "Marlin"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.axis[-1] not in "XYZ":
            raise ValueError(f"axis must be X, Y or Z, or one of them with a minus sign, got {self.axis!r}")

    def dialect(self) -> Dialect:
        """See SerialConfig."""
        return Marlin()
