"""A GRBL 1.1 controller with one motor, simulated on a pseudo-terminal: bytes in and out in real time, motion in any clock."""

import math
import re
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from pushfric_core.simulated.carriage import CarriageMotion, blended
from pushfric_core.simulated.serial_controller import SerialController

GREETING = "\r\nGrbl 1.1h ['$' for help]"
UNLOCK = "[MSG:'$H'|'$X' to unlock]"
HELP = "[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]"
PLANNER_BLOCKS, RECEIVER_BYTES, LONGEST_LINE = 15, 128, 79
WCO_EVERY, OVERRIDES_EVERY = {True: 10, False: 30}, {True: 10, False: 20}  # reports; at rest, in motion
INCH = 25.4  # [mm]
PULL_OFF, SEEK_RATE = 1.0, 1500.0  # homing [mm], [mm/min]
MINUTE = 60.0  # [s]
AXES = "XYZ"
OVERRIDES: dict[int, tuple[str, int, bool]] = {
    0x90: ("feed", 100, False), 0x91: ("feed", 10, True), 0x92: ("feed", -10, True), 0x93: ("feed", 1, True),
    0x94: ("feed", -1, True), 0x95: ("rapid", 100, False), 0x96: ("rapid", 50, False), 0x97: ("rapid", 25, False),
}  # fmt: skip
"""Real-time bytes of the overrides: what they change, by or to how many percent, and whether these are added."""
LEAST_FEED, MOST_FEED = 10, 200  # overrides [%]
WORDS = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")
GROUPS: dict[str, dict[float, str]] = {
    "G": {0: "motion", 1: "motion", 2: "motion", 3: "motion", 80: "motion", 4: "dwell", 53: "dwell", 17: "plane", 18: "plane",
          19: "plane", 20: "units", 21: "units", 40: "cutter", 49: "tool", 61: "control", 90: "distance", 91: "distance",
          93: "feed mode", 94: "feed mode", **dict.fromkeys(range(54, 60), "coordinates")},
    "M": {0: "stop", 2: "stop", 30: "stop", **dict.fromkeys((3, 4, 5), "spindle"), 8: "coolant", 9: "coolant"},
}  # fmt: skip
"""Modal groups. Offsets, probing and arcs are missing: a line that asks for them is an unknown command, or lacks a centre."""
OFFSETS = ["G54", "G55", "G56", "G57", "G58", "G59", "G28", "G30", "G92"]
TOLD = {
    "$#": [*(f"[{name}:0.000,0.000,0.000]" for name in OFFSETS), "[TLO:0.000]", "[PRB:0.000,0.000,0.000:0]"],
    "$I": ["[VER:1.1h.20190830:]", "[OPT:V,15,128]"],
    "$N": ["$N0=", "$N1="],
}
"""The answers that never change to lines that ask for something."""
HELD = {"Hold": 1, "Door": 2}  # what each reports while it brakes
MOST_LINES, MOST_TOOLS = 10_000_000, 255
WHOLE = {0, 1, 2, 3, 4, 5, 6, 10, 13, 20, 21, 22, 23, 26, 30, 31, 32}
"""Settings that are whole numbers."""
SHORTEST_PULSE = 3  # $0 [us]


class Block(NamedTuple):
    """A planned line: where to [mm, of the carriage] and how fast [mm/s]."""

    target: float
    speed: float
    jog: bool = False  # which no feed override changes
    rapid: bool = False


class SimulatedGrbl(SerialController):
    """GRBL 1.1h on a board with one carriage on axis X, home switch at the negative end.

    Its answers are those of GRBL 1.1h to the byte, as far as a pusher needs them; offsets, arcs, probing and spindle are
    missing. Opening the port restarts the controller, as the DTR line of most boards does, unless `restarts` is false; the
    coordinates survive. The methods under "Faults" make it fail on request; FaultyLine makes the line fail. Use it as a context
    manager, or between `start` and `close`.
    """

    def __init__(self, clock: Callable[[], float], travel: float = 0.1, max_speed: float = 0.1, acceleration: float = 0.5,
                 homing: bool = False, restarts: bool = True) -> None:  # fmt: skip
        """The carriage stands at its home end.

        Args:
            clock: time in which the carriage moves [s]; may run at any rate, or pause.
            travel: greatest distance of the carriage from its home end [m].
            max_speed: of the carriage [m/s].
            acceleration: of the carriage [m/s^2].
            homing: the controller boots locked until it is homed, and enforces the travel ($20, $22).
            restarts: it restarts whenever its port is opened; otherwise it goes on with whatever it does.
        """
        super().__init__(restarts)
        self._clock = clock
        per_axis = {100: 250.0, 110: max_speed * 1000 * MINUTE, 120: acceleration * 1000, 130: travel * 1000}
        self._settings = {
            0: "10", 1: "25", 2: "0", 3: "0", 4: "0", 5: "0", 6: "0", 10: "3", 11: "0.010", 12: "0.002", 13: "0",
            20: str(int(homing)), 21: "1", 22: str(int(homing)), 23: "1", 24: "25.000", 25: f"{SEEK_RATE:.3f}", 26: "250",
            27: f"{PULL_OFF:.3f}", 30: "1000", 31: "0", 32: "0",
            **{first + axis: f"{value:.3f}" for first, value in per_axis.items() for axis in range(len(AXES))},
        }  # fmt: skip
        self._asked_at = 0.0  # [s]
        self._carriage = 0.0  # where it rests, or the motion begins [mm]
        self._motion: CarriageMotion | None = None
        self._plan: deque[Block] = deque()
        self._ends: deque[float] = deque()  # when each block is done, as planned [s]
        self._held_in_reset = False  # by its input
        self._restart(keep_coordinates=False)

    def _restart(self, keep_coordinates: bool) -> None:
        locked = self._state in ("Alarm", "Sleep") if keep_coordinates else self._settings[22] != "0"
        self._state: str = "Alarm" if locked else "Idle"
        if not keep_coordinates:
            self._offset = -self._carriage  # machine coordinate of the carriage's 0 [mm]
        self._plan.clear()
        self._ends.clear()
        self._canceling = False  # a jog
        self._percent = {"feed": 100, "rapid": 100}  # overrides
        self._lines = deque([""])  # the last one is still being received
        self._asked = self._deaf = False
        self._owed = False  # an `ok` for the line that hit a soft limit; it comes with the reset
        self._until_wco = self._until_overrides = 0  # reports
        self._feed: float | None = None  # [mm/min]
        self._modes = {"motion": 0, "coordinates": 54, "plane": 17, "units": 21, "distance": 90, "feed mode": 94, "spindle": 5,
                       "coolant": 9}  # fmt: skip
        self._say(GREETING)
        if locked:
            self._say(UNLOCK)

    def position(self) -> float:
        """The carriage's present distance from its home end [m]."""
        with self._lock:
            return self._now()[0] / 1000

    def unasked(self) -> float:
        """For how long nobody has asked for the position of a carriage that moves [s]; 0 if it rests, or nobody is there."""
        with self._lock:
            return self._clock() - self._asked_at if self._motion is not None and self.opened else 0.0

    # Faults

    def reset(self) -> None:
        """Power fails for a moment: the carriage stops at once, the controller boots and has forgotten where it is."""
        with self._lock:
            self._halt()
            self._restart(keep_coordinates=False)

    def alarm(self, code: int) -> None:
        """The carriage stops at once with ALARM:code."""
        with self._lock:
            self._halt()
            self._plan.clear()
            self._state = "Alarm"
            self._say(f"ALARM:{code}")
            if code in (1, 2):
                self._deaf = True
                self._say("[MSG:Reset to continue]")

    def hold_in_reset(self, held: bool) -> None:
        with self._lock:
            self._held_in_reset = held
            if held:
                self._advance()
                if self._motion is not None:
                    self._boot()

    def hit_limit(self) -> None:
        """A hard limit switch closes."""
        self.alarm(1)

    # Bytes

    def _receive(self, data: bytes) -> None:
        """Real-time bytes are picked out wherever they stand; the rest becomes lines."""
        # ! ~ Ctrl-X, the door, the end of a jog
        at_once = {0x21: self._hold, 0x7E: self._resume, 0x18: self._boot, 0x84: self._open_door, 0x85: self._cancel_jog}
        with self._lock:
            # several resets that come together count as one
            for byte in data.replace(b"\x18\x18", b"\x18"):
                self._advance()
                match byte:
                    case 0x3F:  # ?
                        self._asked, self._asked_at = True, self._clock()
                    case _ if byte in at_once:
                        at_once[byte]()
                    case _ if byte in OVERRIDES:
                        self._override(*OVERRIDES[byte])
                    case 0x0A | 0x0D:
                        self._lines.append("")
                    case _ if byte < 0x80:
                        self._lines[-1] += chr(byte)
                # during the homing cycle GRBL does not report; after a limit it accepts only a reset
                if self._asked and self._state != "Home" and not self._deaf:
                    self._asked = False
                    self._say(self._report())

    def _report(self) -> str:
        carriage, speed = self._now()
        substate = "" if self._state not in HELD else f":{HELD[self._state] if self._motion else 0}"
        inches, mask = self._settings[13] != "0", int(self._settings[10])
        unit, digits = (INCH, 4) if inches else (1.0, 3)
        nowhere = f"{0:.{digits}f}"
        kind = "MPos" if mask & 1 else "WPos"
        fields = [self._state + substate, f"{kind}:{(carriage + self._offset) / unit:.{digits}f},{nowhere},{nowhere}"]
        if mask & 2:
            fields.append(f"Bf:{PLANNER_BLOCKS - len(self._plan)},{RECEIVER_BYTES - len(self._lines[-1])}")
        fields.append(f"FS:{abs(speed) * MINUTE / unit:.{int(inches)}f},0")
        pins = "X" * (not -PULL_OFF < carriage < self._travel + PULL_OFF) + "R" * self._held_in_reset
        if pins:
            fields.append(f"Pn:{pins}")
        at_rest = self._motion is None
        if self._until_wco > 0:
            self._until_wco -= 1
        else:
            self._until_wco, self._until_overrides = WCO_EVERY[at_rest] - 1, max(1, self._until_overrides)
            fields.append(f"WCO:{nowhere},{nowhere},{nowhere}")
        if self._until_overrides > 0:
            self._until_overrides -= 1
        else:
            self._until_overrides = OVERRIDES_EVERY[at_rest] - 1
            fields.append(f"Ov:{self._percent['feed']},{self._percent['rapid']},100")
        return f"<{'|'.join(fields)}>"

    # Motion

    def _now(self) -> tuple[float, float]:
        """Position [mm] and speed [mm/s] of the carriage."""
        self._advance()
        return self._motion.at(self._clock()) if self._motion else (self._carriage, 0.0)

    def _advance(self) -> float:
        """Carry out everything that was due up to the present time; return that time [s]."""
        now = self._clock()
        while self._motion is not None:
            carriage = self._motion.at(min(now, self._motion.end))[0]
            if not -PULL_OFF <= carriage <= self._travel + PULL_OFF and self._state != "Home":
                self.hit_limit()
                break
            if self._motion.end > now:
                while self._ends and self._ends[0] <= now:
                    self._ends.popleft()
                    self._plan.popleft()
                break
            self._carriage, self._motion = carriage, None
            self._ends.clear()
            if self._state == "Home":
                self._offset = PULL_OFF - self._travel
                self._state = "Idle"
                self._respond(0)
            elif self._canceling:
                self._canceling = False
                self._state = "Idle"
            elif self._state in ("Run", "Jog"):
                self._carriage = self._plan[-1].target if self._plan else carriage
                self._plan.clear()
                self._state = "Idle"
        return now

    def _set_out(self, now: float) -> None:
        """Plan the way through all blocks, from the carriage's present position and speed.

        Args:
            now: the time up to which all is carried out: a block that ended meanwhile would lie behind the carriage [s].
        """
        if not self._plan:
            self._state = "Idle"
            return
        position, speed = self._motion.at(now) if self._motion else (self._carriage, 0.0)
        lines = [(block.target, self._speed_of(block)) for block in self._plan]
        self._motion, ends = blended(now, position, speed, lines, self._acceleration)
        self._ends = deque(ends)

    def _speed_of(self, block: Block) -> float:
        percent = 100 if block.jog else self._percent["rapid" if block.rapid else "feed"]
        return min(block.speed * percent / 100, self._fastest)

    def _override(self, what: str, percent: int, added: bool) -> None:
        before = self._percent[what]
        self._percent[what] = min(max(before + percent, LEAST_FEED), MOST_FEED) if added else percent
        self._until_overrides = 0
        if self._state == "Run":
            self._set_out(self._advance())

    def _halt(self) -> None:
        self._carriage = self._motion.at(self._clock())[0] if self._motion else self._carriage
        self._motion = None

    def _brake(self) -> None:
        if self._motion is not None:
            now = self._clock()
            position, speed = self._motion.at(now)
            pull = math.copysign(self._acceleration, -speed)
            self._motion = CarriageMotion(now, position, speed, ((abs(speed) / self._acceleration, pull),))
        self._ends.clear()

    def _hold(self) -> None:
        if self._state == "Jog":
            self._cancel_jog()
        elif self._state in ("Run", "Idle"):
            self._brake()
            self._state = "Hold"

    def _resume(self) -> None:
        if self._state == "Hold" and self._motion is None:
            self._state = "Run"
            self._set_out(self._clock())

    def _open_door(self) -> None:
        """As the safety door's input does; it is closed again at once."""
        if self._state in ("Run", "Jog", "Hold", "Idle"):
            self._plan.clear()
            self._brake()
            self._state, self._canceling = "Door", False

    def _cancel_jog(self) -> None:
        if self._state == "Jog" and not self._canceling:
            self._canceling = True
            self._plan.clear()
            self._brake()

    def _boot(self) -> None:
        with self._lock:
            if self._owed:
                self._respond(0)
            if self._motion is not None:
                code = 6 if self._state == "Home" else 3
                self._halt()
                self._say(f"ALARM:{code}")
                self._state = "Alarm"
            self._restart(keep_coordinates=True)

    # Lines

    def _go_on(self) -> None:
        self._advance()
        self._execute_lines()

    def _execute_lines(self) -> None:
        """Execute lines in order while the plan has room; not in a hold, while homing, or before the reset after a limit."""
        while len(self._lines) > 1 and self._listens and len(self._plan) < PLANNER_BLOCKS:
            line = re.sub(r"\(.*?\)|;.*|\s", "", self._lines.popleft()).upper()
            if len(line) > LONGEST_LINE:
                self._respond(11)
            elif line.startswith("$"):
                self._system(line)
            elif line and self._state in ("Alarm", "Jog"):
                self._respond(9)
            else:
                code = self._gcode(line) if line else 0
                self._owed = self._deaf
                if not self._owed:
                    self._respond(code)

    @property
    def _listens(self) -> bool:
        return not self._deaf and not self._canceling and self._state not in (*HELD, "Home", "Sleep")

    def _respond(self, code: int) -> None:
        if code >= 0:  # otherwise the answer has already been sent
            self._say(f"error:{code}" if code else "ok")

    def _system(self, line: str) -> None:
        code = 0
        assignment = re.fullmatch(r"\$(\d*)=(.*)", line)
        if line.startswith("$J="):
            code = self._gcode(line[3:], jog=True) if self._state in ("Idle", "Jog") else 8
        elif line in ("$", "$G"):
            self._say(HELP if line == "$" else self._shown_modes())
        elif line == "$X":
            if self._state == "Alarm":
                self._state = "Idle"
                self._say("[MSG:Caution: Unlocked]")
        elif line == "$C":
            code = self._check()
        elif line == "$$" and self._state not in ("Run", "Hold"):
            for number, value in sorted(self._settings.items()):
                self._say(f"${number}={value}")
        elif self._state not in ("Idle", "Alarm"):
            code = 8
        elif line in TOLD:
            for text in TOLD[line]:
                self._say(text)
        elif line == "$SLP":
            self._respond(0)
            self._say("[MSG:Sleeping]")
            self._state = "Sleep"
            return
        elif line == "$H" and self._settings[22] != "0":
            self._home()
            return  # `ok` follows when it is done
        elif line == "$H":
            code = 5
        elif assignment is not None:
            code = self._set(assignment[1], assignment[2])
        else:
            code = 3
        self._respond(code)

    def _check(self) -> int:
        """Enter the mode in which lines are checked and nothing moves; leave it with a reset."""
        if self._state == "Check":
            self._say("[MSG:Disabled]")
            self._respond(0)
            self._state = "Idle"
            self._restart(keep_coordinates=True)
            return -1
        if self._state != "Idle":
            return 8
        self._state = "Check"
        self._say("[MSG:Enabled]")
        return 0

    def _set(self, number: str, text: str) -> int:
        if not number or re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)", text) is None:
            return 2
        value, which = float(text), int(number)
        if value < 0:
            return 4
        if which not in self._settings:
            return 3
        if which == 0 and value < SHORTEST_PULSE:
            return 6
        if which == 20 and value and self._settings[22] == "0":
            return 10
        self._settings[which] = f"{value:.0f}" if which in WHOLE else f"{value:.3f}"
        self._until_wco = 0 if which in (10, 13) else self._until_wco
        return 0

    def _shown_modes(self) -> str:
        modes = self._modes
        feed = (self._feed or 0) / (INCH if modes["units"] == 20 else 1.0)
        words = " ".join(f"G{modes[name]}" for name in ("motion", "coordinates", "plane", "units", "distance", "feed mode"))
        return f"[GC:{words} M{modes['spindle']} M{modes['coolant']} T0 F{feed:.0f} S0]"

    def _home(self) -> None:
        """Move to the switch and back off it, in one motion."""
        self._state = "Home"
        rate = SEEK_RATE / MINUTE
        there_and_back = [(-PULL_OFF, rate), (0.0, rate)]
        self._motion, _ = blended(self._clock(), self._carriage, 0.0, there_and_back, self._acceleration)

    def _gcode(self, line: str, jog: bool = False) -> int:
        """Parse a block, plan its motion; 0 or the code of an error."""
        if not line:
            return 22
        words = WORDS.findall(line)
        if "".join(letter + number for letter, number in words) != line:
            return 2 if line[0].isalpha() else 1
        modes: dict[str, int] = {}  # by modal group
        values: dict[str, float] = {}
        for letter, text in words:
            value = float(text)
            if letter in GROUPS:
                if int(value) in GROUPS[letter] and value != int(value):
                    return 23
                group = GROUPS[letter].get(value)
                if group is None:
                    return 23 if letter == "M" and value != int(value) else 20
                if group in modes:
                    return 24 if group == "motion" else 21
                modes[group] = int(value)
            elif letter not in AXES + "FIJKLNPRST":
                return 20
            elif letter in values:
                return 25
            elif value < 0 and letter in "FNPST":
                return 4
            else:
                values[letter] = value
        if values.get("N", 0) > MOST_LINES:
            return 27
        if values.get("T", 0) > MOST_TOOLS:
            return 38
        machine = modes.get("dwell") == 53
        if jog and not modes.keys() <= {"units", "distance", *["dwell"] * machine}:
            return 16
        dwells = modes.get("dwell") == 4
        if dwells and "P" not in values:
            return 28
        moves = any(axis in values for axis in AXES) and not dwells
        now = self._modes | modes
        if moves and not jog and now["motion"] in (2, 3):
            return 35
        if set(values) & set("IJKLR" + "P" * (not dwells) + "ST" * jog):
            return 36
        units = INCH if now["units"] == 20 else 1.0
        rapid = not jog and now["motion"] != 1
        feed = values["F"] * units if "F" in values else None if jog else self._feed
        if moves and not rapid and not feed:
            return 22
        if not jog:
            self._feed = feed
            self._modes |= {group: mode for group, mode in modes.items() if group in self._modes}
            if modes.get("stop") in (2, 30):
                self._say("[MSG:Pgm End]")
                self._modes |= {"motion": 1, "plane": 17, "distance": 90, "feed mode": 94, "coordinates": 54}
        if not moves or self._state == "Check":
            return 0
        return self._plan_to(values, units, machine or now["distance"] == 90, None if rapid else feed, jog)

    def _plan_to(self, values: dict[str, float], units: float, absolute: bool, feed: float | None, jog: bool) -> int:
        """Queue the carriage's part of a move; no motor turns for the other axes."""
        if "X" not in values:
            return 0
        now = self._advance()
        before = self._plan[-1].target if self._plan else self._carriage
        wanted = values["X"] * units + (-self._offset if absolute else before)
        steps = float(self._settings[100])
        target = math.floor(wanted * steps + 0.5) / steps if steps > 0 else wanted
        machine = target + self._offset
        if self._settings[20] != "0" and not -self._travel - 1e-9 <= machine <= 1e-9:
            if jog:
                return 15
            self.alarm(2)
            return 0
        if target == before:
            return 0  # no step to make
        speed = self._fastest if feed is None else feed / MINUTE
        self._plan.append(Block(target, speed, jog, feed is None))
        if self._state in ("Idle", "Run", "Jog"):
            self._state = "Jog" if jog else "Run"
            self._set_out(now)
        return 0

    @property
    def _fastest(self) -> float:
        return float(self._settings[110]) / MINUTE

    @property
    def _travel(self) -> float:
        return float(self._settings[130])

    @property
    def _acceleration(self) -> float:
        return max(float(self._settings[120]), 1e-3)
