"""The GRBL 1.1 parser: status reports, errors, alarms and real-time commands on the serial line."""

import re
from collections.abc import Mapping
from enum import Enum

from pushfric_core.pushers.axis_reports import StatusReport
from pushfric_core.pushers.dialect import Alarmed, Answer, Event, Garbled, Greeting, HeldBy, Values, Version

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


ECHOED = b"".join(command.value for command in RealTime)
"""The characters that a terminal in between may echo, even in the middle of a line."""


def decode(raw: bytes) -> Event | None:
    """The meaning of a line; startup lines, echoes, feedback and noise have none."""
    line = raw.translate(None, ECHOED).decode("ascii", errors="replace").strip()
    event: Event | None = None
    if (greeting := GREETING.search(line)) is not None:  # a restart may cut off another line
        event = Greeting(f"Grbl {greeting[1]}")
    elif (status := parse_status(line)) is not None:
        event = status
    elif line.startswith("<"):
        event = Garbled()
    elif line == "ok":
        event = Answer()
    elif (error := ERROR.fullmatch(line)) is not None:
        code = int(error[1])
        event = Answer(f"refused: error:{code} {ERRORS.get(code, '(not of GRBL 1.1)')}", code == NOT_IDLE)
    elif (alarm := ALARM.fullmatch(line)) is not None:
        event = Alarmed(int(alarm[1]))
    elif (held := HOLDS.match(line)) is not None:
        event = HeldBy(f'it says "{held[1]}"')
    elif (build := BUILD.match(line)) is not None:
        event = Version(f"Grbl {build[1]}")
    elif (setting := SETTING.match(line)) is not None:
        event = Values("$$", {f"${int(setting[1])}": setting[2]})
    elif (own := AXIS_SOFT_LIMITS.fullmatch(line)) is not None:
        event = Values(line.partition("=")[0], {"$20": str(int(own[1] == "true"))})
    elif (parameter := PARAMETER.fullmatch(line)) is not None:
        event = Values("$#", {parameter[1]: parameter[2]})
    elif (modes := MODES.fullmatch(line)) is not None:
        event = Values("$G", {"$G": modes[1]})
    return event


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
        text = fields.get(key)
        return None if text is None else tuple(_number(number) for number in text.split(","))

    try:
        for unread in ("Bf", "Ln"):  # damaged there, it may be damaged elsewhere
            numbers(unread)
        return StatusReport(
            state=state,
            substate=None if substate is None else int(substate),
            machine_position=numbers("MPos"),
            work_position=numbers("WPos"),
            work_offset=numbers("WCO"),
            feed=(numbers("FS") or numbers("F") or (None,))[0],
            pins=fields.get("Pn", ""),
            overrides=numbers("Ov"),
        )
    except ValueError:
        return None  # bytes were lost inside a number; the next report is a twentieth of a second away


def work_offset_of(told: Mapping[str, str]) -> tuple[float, ...] | None:
    """The work offset as the sum of its parts; None if they are not all there.

    Args:
        told: what the controller answers to `$#`, by name, and what it answers to `$G`.
    Returns:
        The offset of each axis, in the unit of reports.
    """
    systems = [word for word in told.get("$G", "").split() if re.fullmatch(r"G5[4-9](\.\d)?", word)]
    if len(systems) != 1 or not {*systems, "G92", "TLO"} <= told.keys():
        return None
    try:
        system, shift, tool = ([_number(text) for text in told[name].split(",")] for name in (*systems, "G92", "TLO"))
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
