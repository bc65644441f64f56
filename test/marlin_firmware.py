"""A controller with Marlin 2.1 and one motor, simulated on a pseudo-terminal; see `SimulatedGrbl`."""

import functools
import operator
import re
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from pushfric_core.simulated.carriage import CarriageMotion, blended
from pushfric_core.simulated.serial_controller import SerialController

FIRMWARE = "FIRMWARE_NAME:Marlin 2.1.2.1 (May 16 2023 12:00:00) PROTOCOL_VERSION:1.0 MACHINE_TYPE:SimRap 1.4 EXTRUDER_COUNT:1"
PLANNER_BLOCKS = 16
FIRST_MOVE_DELAY = 0.1  # from the first line of a motion to its begin [s]
QUICK_STOP_LASTS = 1.0  # nothing is read or answered for so long [s]
STEPS = 80.0  # [1/mm]
HOMING_SPEED = 25.0  # [mm/s]
MINUTE = 60.0  # [s]
WORDS = re.compile(r"([A-Z])([-+]?\d*\.?\d+)")


class Block(NamedTuple):
    """A planned line: where to [mm], and how fast [mm/s]."""

    target: float
    speed: float


class SimulatedMarlin(SerialController):
    """Marlin 2.1 on a board with one carriage on axis X, its home switch at 0.

    Its answers are those of Marlin 2.1.2.1, compiled for a computer, as far as a pusher needs them.
    """

    def __init__(self, clock: Callable[[], float], real_positions: bool = True) -> None:
        """The carriage stands at 0. The controller restarts whenever its port is opened.

        Args:
            clock: time in which the carriage moves [s].
            real_positions: the firmware was built with M114_REALTIME; otherwise it reports where the last line will end.
        """
        super().__init__(restarts=True)
        self._clock = clock
        self._max_speed, self._acceleration, self._real = 100.0, 500.0, real_positions  # [mm/s], [mm/s^2]
        self._carriage = 0.0  # where it rests, or the motion begins [mm]
        self._motion: CarriageMotion | None = None
        self._plan: deque[Block] = deque()
        self._ends: deque[float] = deque()  # when each block is done, as planned [s]
        self._deaf_until = 0.0  # [s]
        self._halted = False
        self._restart()

    def position(self) -> float:
        """The carriage's present distance from 0 [m]."""
        with self._lock:
            return self._now()[0] / 1000

    # Faults

    def hold_in_reset(self, held: bool) -> None:
        """It has no such input."""

    def kill(self, why: str) -> None:
        """The firmware halts, as it does when something is wrong with a heater."""
        with self._lock:
            self._halt()
            self._halted, self._homing = True, False
            self._say(f"echo:{why}")
            self._say("Error:Printer halted. kill() called!")

    # Bytes

    def _boot(self) -> None:
        with self._lock:
            self._halt()
            self._restart()

    def _restart(self) -> None:
        self._halted = self._homing = False
        self._absolute, self._percent, self._feed, self._last_number = True, 100.0, 25.0, 0
        self._line, self._lines = b"", deque[str]()
        self._zero = self._carriage  # coordinate of the place at which it was switched on [mm]
        self._deaf_until = 0.0
        for line in ("start", " Marlin 2.1.2.1", "echo: Last Updated: 2023-05-16 | Author: (none, default config)"):
            self._say(line)

    def _receive(self, data: bytes) -> None:
        with self._lock:
            *lines, self._line = (self._line + data).split(b"\n")
            self._lines.extend(line.decode("ascii", errors="replace").strip() for line in lines)

    def _go_on(self) -> None:
        now = self._advance()
        if self._homing and self._motion is None:
            self._homing, self._zero = False, 0.0
            self._say("ok")
        if self._homing and "M112" in self._lines:  # nothing else is read meanwhile
            self._execute("M112")
        while self._lines and self._listens(now):
            line = self._lines.popleft()
            wrong, command = self._checked(line)
            if wrong:
                self._say(f"Error:{wrong}, Last Line: {self._last_number}")
                self._lines.clear()
                self._say(f"Resend: {self._last_number + 1}")
                self._say("ok")
            elif command:
                self._execute(command)

    def _listens(self, now: float) -> bool:
        return not (self._halted or self._homing or now < self._deaf_until or len(self._plan) >= PLANNER_BLOCKS - 1)

    def _checked(self, line: str) -> tuple[str, str]:
        """What is wrong with the number or the checksum of a line, and its command."""
        text, _, checksum = line.rpartition("*")
        number = re.match(r"N(-?\d+) ?", text)
        if not line.startswith("N"):
            return "", line
        if number is None:
            return "No Checksum with line number", ""
        if int(number[1]) != self._last_number + 1 and "M110" not in text:
            return "Line Number is not Last Line Number+1", ""
        if checksum != str(functools.reduce(operator.xor, text.encode())):
            return "checksum mismatch", ""
        self._last_number = int(number[1])
        return "", text[number.end() :]

    def _execute(self, command: str) -> None:
        name, _, rest = command.partition(" ")
        words = {letter: float(value) for letter, value in WORDS.findall(rest)}
        match name:
            case "M114":
                here = self._now()[0] if self._real and "R" in rest else self._planned
                x = here - self._zero
                self._say(f"X:{x:.2f} Y:0.00 Z:0.00 E:0.00 Count X:{x * STEPS:.0f} Y:0 Z:0")
            case "M115":
                self._say(FIRMWARE)
                self._say("Cap:EMERGENCY_PARSER:0")
            case "M503":
                self._say(f"echo:  M92 X{STEPS:.2f} Y{STEPS:.2f} Z400.00 E500.00")
                self._say(f"echo:  M203 X{self._max_speed:.2f} Y{self._max_speed:.2f} Z5.00 E25.00")
                self._say(f"echo:  M201 X{self._acceleration:.2f} Y{self._acceleration:.2f} Z100.00 E10000.00")
                self._say("echo:  M204 P3000.00 R3000.00 T3000.00")
            case "M110":
                self._last_number = int(words.get("N", 0))
            case "M410":
                self._halt()
                self._deaf_until = self._clock() + QUICK_STOP_LASTS
            case "M112":
                self.kill("M112 Shutdown")
                return
            case "M220":
                self._percent = words.get("S", self._percent)
            case "G90" | "G91":
                self._absolute = name == "G90"
            case "G28":
                self._to(0.0, HOMING_SPEED)
                self._homing = True
                return  # `ok` follows when it is done
            case "G0" | "G1":
                self._feed = words.get("F", self._feed * MINUTE) / MINUTE
                if "X" in words:
                    origin = self._zero if self._absolute else self._planned
                    self._to(origin + words["X"], self._feed * self._percent / 100)
            case "G21" | "M84":
                pass
            case _:
                self._say(f'echo:Unknown command: "{command}"')
        self._say("ok")

    # Motion

    @property
    def _planned(self) -> float:
        """Where the last line ends [mm]."""
        return self._plan[-1].target if self._plan else self._now()[0]

    def _to(self, target: float, speed: float) -> None:
        """Plan a line."""
        now = self._advance()
        target = round(target * STEPS) / STEPS
        if target == self._planned or speed <= 0:
            return
        self._plan.append(Block(target, min(speed, self._max_speed)))
        waits = self._motion is None or now < self._motion.begin
        begin = now if not waits else now + FIRST_MOVE_DELAY if self._motion is None else self._motion.begin
        position, speed = self._motion.at(now) if self._motion is not None else (self._carriage, 0.0)
        self._motion, ends = blended(begin, position, speed, list(self._plan), self._acceleration)
        self._ends = deque(ends)

    def _now(self) -> tuple[float, float]:
        """Position [mm] and speed [mm/s] of the carriage."""
        now = self._advance()
        return self._motion.at(now) if self._motion is not None else (self._carriage, 0.0)

    def _advance(self) -> float:
        """Carry out all that was due; return the present time [s]."""
        now = self._clock()
        while self._ends and self._ends[0] <= now:
            self._ends.popleft()
            self._carriage = self._plan.popleft().target
        if not self._plan:
            self._motion = None
        return now

    def _halt(self) -> None:
        self._carriage = self._now()[0]
        self._motion = None
        self._plan.clear()
        self._ends.clear()
