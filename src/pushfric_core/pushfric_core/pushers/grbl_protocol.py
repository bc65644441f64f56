"""The GRBL 1.1 parser: status reports, errors, alarms and real-time commands on the serial line."""

import re
from collections.abc import Mapping
from enum import Enum

from pushfric_core.pushers.axis_reports import StatusReport
from pushfric_core.pushers.pusher import Halted
from pushfric_core.pushers.serial_line import Refused

ERRORS = {
    1: "Expected command letter", 2: "Bad number format", 3: "Invalid statement", 4: "Value < 0", 5: "Setting disabled",
    6: "Value < 3 usec", 7: "EEPROM read fail. Using defaults", 8: "Not idle", 9: "G-code lock", 10: "Homing not enabled",
    11: "Line overflow", 12: "Step rate > 30kHz", 13: "Check Door", 14: "Line length exceeded", 15: "Travel exceeded",
    16: "Invalid jog command", 17: "Setting disabled", 20: "Unsupported command", 21: "Modal group violation",
    22: "Undefined feed rate", **{code: f"Invalid gcode ID:{code}" for code in range(23, 39)},
    46: "Homing required (grblHAL)",
}  # fmt: skip
ALARMS = {
    1: "Hard limit", 2: "Soft limit", 3: "Abort during cycle", 4: "Probe fail", 5: "Probe fail", 6: "Homing fail",
    7: "Homing fail", 8: "Homing fail", 9: "Homing fail", 11: "Homing required (grblHAL)",
}  # fmt: skip


NOT_IDLE = 8
"""The error of a jog that came when another line was running."""


class CommandRefused(Refused):
    """The controller answered a line with error:n."""

    def __init__(self, line: str, code: int) -> None:
        super().__init__(f'"{line}" refused: error:{code} {ERRORS.get(code, "(not of GRBL 1.1)")}')
        self.code = code
        self.passing = code == NOT_IDLE


class Alarm(Halted):
    """The controller stopped with ALARM:n and refuses to move; the code is None if it is not known."""

    def __init__(self, code: int | None) -> None:
        super().__init__("ALARM" if code is None else f"ALARM:{code} {ALARMS.get(code, '(not of GRBL 1.1)')}")
        self.code = code


STATUS = re.compile(r"<([A-Za-z]+)(?::(\d{1,4}))?((?:\|[^<>|]+)*)>")
GREETING = re.compile(r"grbl(?:hal)? (\d{1,4}\.\S{1,40}) \[.*\]", re.IGNORECASE)
BUILD = re.compile(r"\[VER:([^:\]]{1,40})")
HOLDS = re.compile(r"\[MSG:(?:[A-Z]{1,5}: )?(Check Door|Emergency stop|Motor fault)[^\]]{0,80}\]", re.IGNORECASE)
"""A message about an input that holds the controller; grblHAL goes on reporting a jog meanwhile."""
SETTING = re.compile(r"\$(\d{1,4})=([^ (]*)")
PARAMETER = re.compile(r"\[(G\d\d(?:\.\d)?|TLO):([-\d.,]{1,200})\]", re.ASCII)
MODES = re.compile(r"\[GC:([ -Z]{1,200})\]")
TOOL_AXIS = 2  # whose offset a tool's length is part of, where it is one number
AXIS_SOFT_LIMITS = re.compile(r"\$/axes/[a-z]/soft_limits=(true|false)")
ERROR = re.compile(r"error:\s*(\d{1,4})")
ALARM = re.compile(r"ALARM:\s*(\d{1,4})")
NUMBER = re.compile(r"-?\d{1,7}(?:\.\d{1,6})?", re.ASCII)  # as in a report; controllers send no others

STATES = {"Idle", "Run", "Hold", "Jog", "Alarm", "Door", "Check", "Home", "Sleep", "Tool"}


class RealTime(Enum):
    """Bytes that the controller obeys at once, outside the flow of lines."""

    ASK = b"?"
    HOLD = b"!\x85"  # feed hold and jog cancel: the first stops any motion but a jog of grblHAL, the second any jog
    RESUME = b"~"
    RESET = b"\x18"
    FULL_FEED = b"\x90"  # feed override 100 %


def parse_status(line: str) -> StatusReport | None:
    """The status report in a line; None if the line holds no report, or a damaged one."""
    match = STATUS.search(line)
    if match is None:
        return None
    state, substate, rest = match.groups()
    if state not in STATES:
        return None
    fields = dict(text.partition(":")[::2] for text in rest.split("|")[1:])

    def numbers(key: str) -> tuple[float, ...] | None:
        text = fields.pop(key, None)
        return None if text is None else tuple(_number(number) for number in text.split(","))

    def integers(key: str) -> tuple[int, ...] | None:
        found = numbers(key)
        return None if found is None else tuple(int(number) for number in found)

    try:
        feed, spindle = (*(numbers("FS") or numbers("F") or (None,)), None)[:2]
        return StatusReport(
            state=state,
            substate=None if substate is None else int(substate),
            machine_position=numbers("MPos"),
            work_position=numbers("WPos"),
            work_offset=numbers("WCO"),
            buffer=integers("Bf"),
            line=(integers("Ln") or (None,))[0],
            feed=feed,
            spindle=spindle,
            pins=fields.pop("Pn", ""),
            overrides=integers("Ov"),
            accessories=fields.pop("A", ""),
            others=fields,
        )
    except ValueError:
        return None  # bytes were lost inside a number; the next report is a twentieth of a second away


def work_offset_of(parameters: Mapping[str, str], modes: str) -> tuple[float, ...] | None:
    """The work offset as the sum of its parts; None if they are not all there.

    Args:
        parameters: what the controller answers to `$#`, by name.
        modes: what it answers to `$G`.
    Returns:
        The offset of each axis, in the unit of reports.
    """
    systems = [word for word in modes.split() if re.fullmatch(r"G5[4-9](\.\d)?", word)]
    if len(systems) != 1 or not {*systems, "G92", "TLO"} <= parameters.keys():
        return None
    try:
        system, shift, tool = ([_number(text) for text in parameters[name].split(",")] for name in (*systems, "G92", "TLO"))
    except ValueError:
        return None
    if len(tool) == 1:
        tool = [tool[0] if axis == TOOL_AXIS else 0.0 for axis in range(len(system))]
    if not len(system) == len(shift) == len(tool):
        return None
    return tuple(sum(parts) for parts in zip(system, shift, tool, strict=True))


def _number(text: str) -> float:
    if NUMBER.fullmatch(text) is None:
        raise ValueError(f"not a number in a report: {text[:20]}")
    return float(text)
