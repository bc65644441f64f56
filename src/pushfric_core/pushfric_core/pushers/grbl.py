"""The dialect of a GRBL 1.1 controller (Arduino GRBL, grblHAL, FluidNC) on a serial port.

A stroke is a stream of short jogs (`$J=`). Each states all of its modes (G21 G90), so no modal state is relied on. No feed
override changes a jog, and a feed hold cancels it.
"""

import math

from pushfric_core.pushers.axis_reports import AXES, MM, MM_PER_MINUTE, STATE_MODES
from pushfric_core.pushers.clock import clock
from pushfric_core.pushers.dialect import Dialect, Event, Settings, number
from pushfric_core.pushers.driver import Script
from pushfric_core.pushers.grbl_protocol import ALARMS, RealTime, decode, work_offset_of
from pushfric_core.pushers.pusher import Halted, Held, Limits, Mode, NotConnected, Timeout
from pushfric_core.pushers.serial_line import Refused
from pushfric_core.pushers.serial_pusher import ASKED_FOR_TWO_ALIKE, SerialPusher

RESET_AGAIN = 1.0  # [s]
RESET_PATIENCE = 6.0  # a greeting after a reset may take this long [s]
INCH = 25.4  # [mm]


class Grbl(Dialect):
    """GRBL 1.1; settings have the names of GRBL, such as $100."""

    sign_of_life = "Ctrl-X in a terminal at that baud rate must bring a greeting"
    question, full_feed = RealTime.ASK.value, RealTime.FULL_FEED.value
    homing_line, unlock_line = "$H", "$X"

    def decode(self, raw: bytes) -> Event | None:
        return decode(raw)

    def piece(self, axis: str, target: float, feed: float) -> str:
        return f"$J=G21G90{axis}{target:.3f}F{feed:.3f}"

    def hold(self, homing: bool) -> bytes:
        return RealTime.HOLD.value

    def last_words(self, homing: bool) -> bytes:
        # a hold cancels a jog; only a reset ends a homing cycle
        return RealTime.HOLD.value + (RealTime.RESET.value if homing else b"")

    def halted(self, code: int | None) -> Halted:
        return Halted("ALARM" if code is None else f"ALARM:{code} {ALARMS.get(code, '(not of GRBL 1.1)')}")

    # Settings

    @staticmethod
    def settings_of(axis: str) -> tuple[str, str, str, str]:
        travel, speed, acceleration, steps = (f"${first + AXES.index(axis)}" for first in (130, 110, 120, 100))
        return travel, speed, acceleration, steps

    def limits(self, settings: Settings, axis: str) -> Limits:
        length, speed, acceleration, _ = (number(settings, name) for name in self.settings_of(axis))
        travel = math.inf
        if settings.get("$20", "0") != "0":
            # homing ends this far inside the travel
            homes = int(number(settings, "$22", 0.0)) & 1  # grblHAL says more in the other bits
            travel = (length - (number(settings, "$27", 0.0) if homes else 0.0)) * MM
        return Limits(travel, speed * MM_PER_MINUTE, acceleration * MM)

    def wrong_setting(self, settings: Settings, axis: str) -> str | None:
        travel, *positive = self.settings_of(axis)
        for name in ("$20", "$22", "$27", *sorted(positive), travel):
            text = settings.get(name)
            try:
                value = float(text or "nan")
            except ValueError:
                continue  # such as n/a: the firmware keeps it elsewhere
            if text and not (0 <= value < math.inf and (value > 0 or name not in positive)):
                shown = text if len(text) <= 20 else f"{text[:20]}..."
                return f"{name}={shown}, expected {'a positive number' if name in positive else '0 or more'}"
        return None

    # Scripts

    def connect(self, pusher: SerialPusher) -> Script:
        yield from self._await_greeting(pusher)
        status = yield from pusher.come_to_rest()
        if status.state not in ("Idle", "Alarm"):
            if pusher.looks:
                return
            if pusher.doubt is None:  # otherwise it was this driver that held it
                pusher.suspect(f"held at the controller: it reported {status.state} when it was found")
            yield from self.reset(pusher)  # nothing moves any more, and only now are lines read
            if pusher.axis.mode is Mode.HOLD:
                raise NotConnected(f"held at the controller at {pusher.line.path}: it reads nothing until it is released")
        try:
            yield from pusher.command("$I")
        except Timeout:
            if pusher.looks:
                raise
            # if a jog ends just as it is cancelled, GRBL 1.1h reports Idle and reads no line until a reset
            pusher.suspect("it read lines only after a reset")
            yield from self.reset(pusher)
            yield from pusher.command("$I")
        if pusher.version.startswith("Grbl 0."):
            raise NotConnected(f"{pusher.name} is too old, expected Grbl 1.1")
        # FluidNC's $20 is that of X; it answers "$/axes/y/soft_limits=true"
        is_fluid = "FluidNC" in pusher.version and pusher.axis.index > 0
        own_limits = (f"$/axes/{pusher.axis.letter.lower()}/soft_limits",) if is_fluid else ()
        yield from pusher.ask_for_settings("$$", *own_limits)
        pusher.axis.unit = INCH if pusher.settings.get("$13") == "1" else 1.0
        yield from self._ask_for_offset(pusher)
        pusher.axis.believe_next()  # now that the unit of reports is known
        yield from pusher.find_place()
        if pusher.restarted:
            pusher.suspect("the controller restarted by itself: its reset input, or its supply")
            pusher.restarted = False

    def _await_greeting(self, pusher: SerialPusher) -> Script:
        """Wait for the greeting of a board that boots when its port is opened, or the answer of one that runs already."""
        deadline = clock() + pusher.serial.connect_timeout
        while not pusher.line.greetings and not pusher.axis.statuses:
            if clock() > deadline:
                if pusher.looks:
                    raise NotConnected(f"no GRBL controller answers at {pusher.line.path}, {pusher.serial.baud} baud")
                break
            pusher.request()
            yield
        if pusher.version.startswith("Grbl 0."):
            raise NotConnected(f"{pusher.name} is too old, expected Grbl 1.1")
        if not pusher.line.greetings and not pusher.axis.statuses:
            # after a limit, and while it homes, GRBL ignores everything but a reset
            pusher.suspect("it answered only after a reset")
            pusher.hold()
            try:
                yield from self.reset(pusher)
            except Timeout as error:
                raise NotConnected(f"no GRBL controller answers at {pusher.line.path}, {pusher.serial.baud} baud") from error

    def _ask_for_offset(self, pusher: SerialPusher) -> Script:
        """Ask for the parts of the work offset until two answers agree, or one agrees with a report or with what is known.

        If a controller does not name the parts, the offset of two reports that agree is taken.
        """
        axis = pusher.axis
        known = before = axis.offset
        for _ in range(ASKED_FOR_TWO_ALIKE):
            try:
                told = yield from pusher.ask_values("$#", "$G")
            except Refused:
                return
            offset = work_offset_of(told)
            if any(axis.agree(offset, other) for other in (before, axis.claimed)) or not told.keys() - {"$G"}:
                break
            before = offset
        else:
            raise NotConnected(f"{pusher.name}: its offsets ($#) came {ASKED_FOR_TWO_ALIKE} times, each time different")
        if known is not None and offset is not None and not axis.agree(offset, known):
            pusher.suspect(f"a reset changed its work offset from {axis.shown(known)} to {axis.shown(offset)}")
            axis.believe_next()
        axis.offset, axis.claimed = offset or known, None

    def reset(self, pusher: SerialPusher) -> Script:
        """Raises Timeout if the controller does not answer afterwards."""
        if pusher.line.pending is not None and "FluidNC" in pusher.version:
            # it would carry out that line after the reset; where it is held by then, it refuses it
            unasked = pusher.line.unasked
            yield from self._restart(pusher, RealTime.HOLD.value)
            refused_by = clock() + RESET_AGAIN
            while pusher.line.unasked == unasked and clock() < refused_by:
                yield
        yield from self._restart(pusher)
        settled = clock() + RESET_AGAIN
        while pusher.line.owed and clock() < settled:  # a second reset would wipe out what is sent now
            yield
        status = yield from pusher.report()
        if status.state not in STATE_MODES:  # it reads no line until it is released
            if pusher.recovering:
                raise Held(f"held at the controller: {pusher.holding(status)}; release it, then reset")
        elif pusher.axis.offset is not None:  # a reset ends shifts (G92) and may choose another coordinate system
            yield from self._ask_for_offset(pusher)
            yield from pusher.report()

    def _restart(self, pusher: SerialPusher, then: bytes = b"") -> Script:
        """Reset the controller and send at once what comes then. Raises Timeout if no greeting comes."""
        # for half a second, while it reports its alarm, GRBL drops a reset
        dropped = pusher.axis.status is not None and pusher.axis.status.state == "Alarm"
        before = pusher.line.greetings
        pusher.line.discard()  # a reset wipes out what was sent
        pusher.line.restart(RealTime.RESET.value + then)
        again, deadline = clock() + RESET_AGAIN, clock() + RESET_PATIENCE
        while pusher.line.greetings == before and clock() < deadline:
            if dropped and clock() > again:
                pusher.line.restart(RealTime.RESET.value + then)
                dropped = False
            yield
        if pusher.line.greetings == before:  # whatever it reports then, it may have restarted unheard
            raise Timeout(f"no greeting within {RESET_PATIENCE:g} s of a reset")
