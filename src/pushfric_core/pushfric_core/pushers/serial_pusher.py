"""The common part of all drivers of a controller on a serial port: a stroke is a stream of short pieces.

The controller never has more of a stroke than it moves through in the time `ahead`, judged by the positions that it reports. If
this process dies, hangs or loses the line, the pusher therefore stops after that time. Flow control is send-and-wait: a line is
sent only after the controller has answered the last one.
"""

import math
import statistics
from collections.abc import Callable, Generator, Mapping
from dataclasses import replace
from functools import partial

from pushfric_core.pushers.axis_reports import AXES, MM, MM_PER_MINUTE, STATE_MODES, AxisReports, StatusReport, moves
from pushfric_core.pushers.clock import clock
from pushfric_core.pushers.dialect import Alarmed, Answer, Event, Garbled, Greeting, HeldBy, Values, Version, number
from pushfric_core.pushers.driver import STOPPING, Driver, Phase, Role, Script
from pushfric_core.pushers.pusher import Held, Limits, Mode, NotConnected, NotReady, PusherConfig, PusherReport, Timeout
from pushfric_core.pushers.serial_line import WIPED, Refused, SerialLine, identity_of
from pushfric_core.pushers.serial_settings import SerialSettings
from pushfric_core.pushers.states import Homing, State
from pushfric_core.pushers.stroke import Stroke

ANSWER_TIMEOUT = 3.0  # [s], as all below
HOMING_TIMEOUT = 180.0
REST_TIMEOUT = 30.0  # for a pusher that moves when it is found, and is held
ASK_EVERY = 0.05  # while a script waits for reports
ASK_MOVING = 0.025  # in a stroke
ASK_AGAIN = 0.25  # a question that was not answered
ASK_AGAIN_MOVING = 0.06
STANDS = 1.0  # a pusher that stands still in mid-stroke
SILENCE = 2.0  # at rest, unless the setting silence allows more
ASKED_FOR_TWO_ALIKE = 6  # settings and offsets, which have no checksum
REPORTS_UNTIL_PLACE = 62  # GRBL's offset comes with every 30th report at the latest, and counts once it has come twice
SMALLEST = 0.02  # the last digit of a report in inches; or a motor step, if that is more [mm]
REFUSED_OFTEN = 5  # this many pieces may be refused, and sent again, in one stroke

INPUTS = {"D": "door", "H": "feed hold", "R": "reset", "E": "emergency stop", "M": "motor fault"}
"""Inputs by which a person, or the wiring, holds a controller, by the letters of its reports."""


class SerialPusher(Driver):
    """A Pusher: one linear axis of a controller on a serial port.

    Stroke position 0 is where the axis rests after homing; without homing, the zero of the controller's work coordinates. The
    public names that `Pusher` does not have are for the scripts of dialects.
    """

    def __init__(self, config: SerialSettings, home: bool = PusherConfig.home, only_look: bool = False) -> None:
        """Nothing is opened yet.

        Args:
            config: of the port and of the axis.
            home: `recover` seeks the home switch; otherwise it unlocks an alarm.
            only_look: never move, hold or reset the controller, and send it no line while it moves.
        """
        self.serial, self._dialect = config, config.dialect()
        self.line = SerialLine(config.port, config.baud, self._dialect.in_order)
        self.axis = AxisReports(config.axis, config.real_time_factor, self._blame)
        self.restarted = False
        """The controller did so by itself, in the last connection."""
        super().__init__(
            config.silence,
            max(SILENCE, config.silence) + self._dialect.deaf_after_stop,
            Homing.HOMES if home else Homing.UNLOCKS,
            Role.LOOKS if only_look else Role.DRIVES,
        )

    def _forget(self) -> None:
        super()._forget()
        self.line.forget()
        self.axis.forget()
        self._held: str | None = None  # what holds the controller, unless it is this driver
        self._pins = ""  # inputs that were active when the stroke began
        self._fresh: PusherReport | None = None
        self.settings: dict[str, str] = {}
        """The controller's."""
        self._told: dict[str, str] = {}  # in answer to the last line that asks for something
        self.version = ""
        """The name of what answered."""

    def _scripts(self) -> Mapping[Phase, Callable[[], Script]]:
        return {
            Phase.CONNECTING: partial(self._dialect.connect, self),
            Phase.STREAMING: self._streaming,
            Phase.BRAKING: partial(self._dialect.brake, self),
            Phase.RESETTING: partial(self._dialect.reset, self),
            Phase.RECOVERING: partial(self._dialect.reset, self),
            Phase.HOMING: self._seek_home,
            Phase.UNLOCKING: self._unlock,
        }

    @property
    def limits(self) -> Limits:
        return self._dialect.limits(self.settings, self.axis.letter)

    @property
    def looks(self) -> bool:
        """Whether it never interferes."""
        return self._role is Role.LOOKS

    @property
    def recovering(self) -> bool:
        """Whether a person has asked for the reset that is under way."""
        return Phase.RECOVERING in self._state

    @property
    def _reported(self) -> Mode:
        return self.axis.mode

    @property
    def name(self) -> str:
        return f"{self.version or 'no controller'} at {self.line.path}"

    @property
    def place(self) -> str:
        return identity_of(self.line.path)

    @property
    def dropped(self) -> int:
        return self.axis.dropped

    def _open(self) -> None:
        self.line.open()

    def _leave(self, before: State, in_motion: bool) -> None:
        self.line.close(self._dialect.last_words(Phase.HOMING in before) if in_motion else b"")

    def hold(self, homing: bool = False) -> None:
        self.line.say(self._dialect.hold(homing))

    def _start(self, position: float, speed: float) -> Stroke:
        """Raises NotReady if the controller answers too late."""
        latency = statistics.median(self.line.latencies or [0.0])
        if latency > self._silence:
            raise NotReady(f"the controller at {self.line.path} answers after {latency:.2f} s; silence is {self._silence:g} s")
        assert self.axis.last is not None
        assert self.axis.status is not None
        self._pins = self.axis.status.pins
        wait = max(0.0, self._silence - SerialSettings.silence)  # allowed on a busy machine, to each piece
        ahead, latency = (seconds * self.serial.real_time_factor for seconds in (self.serial.ahead, latency))
        return Stroke(self.axis.last.position, position, speed, self.limits.acceleration, ahead, wait, latency)

    def ask(self, stamp: int) -> None:
        if self._connected and Phase.HOMING not in self._state:
            with self._left_if_lost():
                self.request(stamp)

    # Bytes, lines, meaning

    def _hear(self) -> None:
        self._fresh = None
        for line in self.line.read():
            self._take(self._dialect.decode(line))

    def _take(self, event: Event | None) -> None:
        """Take what the controller says, if it means anything."""
        match event:
            case StatusReport():
                self._take_status(event)
            case Garbled():
                self.axis.damaged += 1
            case Answer(refusal, passing, resend):
                if resend is not None:
                    self.line.number = resend - 1
                    self.line.threw_away()
                if not refusal:
                    self.line.accepted()
                else:
                    self.line.answered(Refused(f'"{self.line.pending}" {refusal}', passing))
            case Greeting(version):
                self.version = self.version or version  # it may say more when it is asked
                if not self.line.greeted():
                    self.restarted |= self._connected
                    self._blame(NotConnected(f"the controller at {self.line.path} restarted"))
            case Alarmed(code):
                self.axis.status = StatusReport("Alarm")
                self._blame(self._dialect.halted(code))  # a restart may bring an alarm of its own
            case HeldBy(why):
                self._hear_of_hold(why)
            case Version(name):
                self.version = name
            case Values(line, values) if line == self.line.pending:
                self._told.update(values)

    def _take_status(self, status: StatusReport) -> None:
        """Take a status report; one that cannot be true changes nothing."""
        self.line.report_came()
        now, asked, axis = clock(), self.line.report_since, self.axis
        if self._dialect.only_positions:
            status = replace(status, state="Idle" if axis.place in (None, status.work_position) else "Run")
        if self._state & {Phase.HOMING, Phase.RECOVERING}:  # positions start again, or a person has looked
            axis.still = None
            axis.believe_next()
        if not axis.others_are_still(status):
            self.line.misheard()
            return
        if status.work_offset is not None:
            axis.take_offset(status.work_offset, self.line.path)
        position, stamp = axis.position_of(status), self._now_stamp if self.line.stamp is None else self.line.stamp
        if position is None and Phase.STREAMING in self._state:  # it was known, so bytes are damaged: where does it rest?
            axis.damaged += 1
            self.line.misheard()
            return
        if position is not None:
            if not axis.can_be_true(position, status, asked, now, self.limits.max_speed, self._stroke):
                self.line.misheard()
                return
            # in these states grblHAL reports no feed while it brakes, and the programmed feed at rest
            feed = None if status.state in ("Hold", "Door") else status.feed
            speed = axis.speed(position, feed, stamp, moves(status))
            if self._dialect.only_positions:
                speed = axis.proven_speed(position, asked, now, moves(status))
        self.line.reported(now)
        axis.heard(status)
        if status.overrides and int(status.overrides[0]) != 100 and Phase.STREAMING in self._state:
            self.line.say(self._dialect.full_feed)
        self._hear_of_hold(self.holding(status))
        if position is not None:
            self._fresh = PusherReport(position, speed, self.mode, stamp)
            axis.believe(self._fresh)
            self._check_truth(position, now)

    def _check_truth(self, position: float, now: float) -> None:
        """See that a report says where the pusher is, not where it will be."""
        stroke, needs = self._stroke, self._dialect.needs_for_truth
        if not needs or stroke is None or stroke.began is None or Phase.STREAMING not in self._state:
            return
        elapsed = self.serial.real_time_factor * (now - stroke.began)
        if (gone := abs(position - stroke.start)) > stroke.farthest(elapsed):
            went = f"{gone / MM:.1f} mm after {elapsed:.2f} s of a stroke at {stroke.speed / MM:g} mm/s"
            self._blame(NotReady(f"{self.name} reports {went}: its firmware needs {needs}, or the pusher was moved"))

    def _hear_of_hold(self, why: str | None) -> None:
        """Take what the controller says it is held by, unless this driver holds it; it counts once."""
        if self._role is Role.DRIVES and self._state & {Phase.RESTING, Phase.STREAMING, *STOPPING}:
            before, self._held = self._held, why
            if why is not None and before is None:
                self._blame(Held(f"held at the controller: {why}"))

    def holding(self, status: StatusReport) -> str | None:
        """The hold that a report shows: the controller does not move, although this driver has not told it so; or None."""
        own = status.state == "Hold" and not STOPPING.isdisjoint(self._state)
        if status.state not in STATE_MODES and not own:
            return f"it reports {status.state}"
        for pin, name in INPUTS.items():
            if pin in status.pins:
                return f"its {name} input is active"
        streams = Phase.STREAMING in self._state and status.state != "Alarm"
        if streams and (reached := set(status.pins) & set(AXES) - set(self._pins)):
            return f"its limit input {min(reached)} became active"
        return None

    def _newest(self) -> PusherReport | None:
        return self._fresh

    @property
    def _silent(self) -> float:
        since = self.line.silent_since
        return 0.0 if since is None or self._state & {Phase.BRAKING, Phase.HOMING} else clock() - since

    def request(self, stamp: int | None = None) -> None:
        """Ask for a report, unless one is due."""
        if self.line.may_ask(ASK_AGAIN_MOVING if Phase.STREAMING in self._state else ASK_AGAIN):
            self.line.ask(self._dialect.question, stamp)

    # Parts of scripts

    def come_to_rest(self) -> Generator[None, None, StatusReport]:
        """Hold a moving pusher, at its first report, and wait until it rests; with only_look, do neither."""
        deadline = clock() + REST_TIMEOUT
        status = self.axis.status or (yield from self.report())
        while True:
            if clock() > deadline:
                raise Timeout(f"no two reports in a row gave the same place at rest within {REST_TIMEOUT:g} s")
            before = self.axis.place
            if not moves(status):
                again = yield from self.report()
                same = before is not None and before == self.axis.place
                if again.state == status.state == "Alarm" or (same and not moves(again)):
                    return again
                status = again
            self.suspect("it moved when it was found")
            if self.looks:
                return status
            self.hold()
            status = yield from self.report()

    def ask_values(self, *lines: str) -> Generator[None, None, dict[str, str]]:
        """The values that the controller tells in answer to these lines."""
        self._told = {}
        for line in lines:
            yield from self.command(line)
        return self._told

    def ask_for_settings(self, *lines: str) -> Script:
        """Ask for the settings until two answers agree: they say what a report means, and have no checksum.

        Raises NotConnected if they never agree, or if a setting that matters has an impossible value.
        """
        before: dict[str, str] | None = None
        for _ in range(ASKED_FOR_TWO_ALIKE):
            self.settings = yield from self.ask_values(*lines)
            if self.settings == before:
                break
            before = self.settings
        else:
            asked = f"{self.name}: its settings ({lines[0]}) came"
            raise NotConnected(f"{asked} {ASKED_FOR_TWO_ALIKE} times, each time different")
        if (wrong := self._dialect.wrong_setting(self.settings, self.axis.letter)) is not None:
            raise NotConnected(f"{self.name} is set to {wrong}")

    def find_place(self) -> Script:
        """Wait until two reports in a row give the same place of all axes, at rest, because one may be damaged."""
        before: tuple[float, ...] | None = None
        for _ in range(REPORTS_UNTIL_PLACE):
            status = yield from self.report()
            known = status.work_position is not None or self.axis.offset is not None
            here = self.axis.place if known and self.axis.last is not None and not moves(status) else None
            if here is not None and here == before:
                if self._role is Role.DRIVES:  # otherwise somebody else may move them
                    self.axis.stay()
                self._held = self.holding(status)
                if self._held is not None and Phase.CONNECTING not in self._state:
                    raise Held(f"held at the controller: {self._held}; release it, then reset")
                if self._held is not None:
                    self.suspect(f"held at the controller: {self._held}")
                return
            before = here

    def _seek_home(self) -> Script:
        yield from self.command(self._dialect.homing_line.format(axis=self.axis.letter), HOMING_TIMEOUT)
        yield from self.find_place()
        if self.axis.last is not None:
            self.axis.zero += self.axis.sign * self.axis.last.position / MM
        self.axis.believe_next()

    def _unlock(self) -> Script:
        if self._dialect.unlock_line and self.mode is Mode.ALARM:
            yield from self.command(self._dialect.unlock_line)
        yield from self.find_place()

    def _streaming(self) -> Script:
        """Send the pieces of a stroke, as there is room for them, until the pusher rests at its end."""
        assert self._stroke is not None
        stroke, line, axis = self._stroke, self.line, self.axis
        for text in self._dialect.before_stroke:
            yield from self.command(text)
        if self._dialect.full_feed:
            line.say(self._dialect.full_feed)
        stroke.began = began = clock()
        line.answer, waits = None, False
        moved, place, steps = began, stroke.start, number(self.settings, self._dialect.settings_of(axis.letter)[3])
        resolution = max(SMALLEST, 1 / steps) * MM
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
                    raise self._dialect.halted(axis.status.substate)
                # right after its `ok` a controller may still report that it idles where it was
                idle = idle + 1 if axis.status.state == "Idle" else 0
                short = abs(last.position - stroke.sent) > resolution
                if idle and stroke.all_sent and not short:
                    return
                if idle >= self._dialect.idle_reports:
                    rests = f"the pusher rests at {last.position:.4f} m"
                    raise Held(f"held at the controller, or a line was lost: {rests}, was sent to {stroke.sent:.4f} m")
            stands = waits or (idle and short)
            if line.pending is None and not stands and (end := stroke.next_piece(last.position)) is not None:
                self._send_line(self._dialect.piece(axis.letter, axis.coordinate_of(end), stroke.speed / MM_PER_MINUTE))
                idle, seen = 0, axis.statuses
            if now - line.asked_at >= ASK_MOVING:
                self.request(self._now_stamp)
            yield

    def brake(self) -> Script:
        """Wait for the end of a feed hold: a reset before it costs the position. A stuck controller is reset anyway."""
        braking = self.limits.max_speed / self.limits.acceleration
        deadline = clock() + 1 + (braking if math.isfinite(braking) else 0)
        before = None
        while clock() < deadline:
            try:
                status = yield from self.report()
            except Timeout:
                return
            moving, place = moves(status), self.axis.place
            if not moving and place == before:
                return
            if status.state in ("Run", "Jog"):
                self.hold()  # a line that was on its way starts a motion again; a second hold does no harm
            before = None if moving else place

    def _send_line(self, line: str) -> None:
        data = line.encode() + b"\n"
        if not self.looks:
            self.line.number += 1
            data = self._dialect.line(line, self.line.number)
        self.line.send(line, data)

    def command(self, text: str, timeout: float = ANSWER_TIMEOUT) -> Script:
        self._send_line(text)
        line, deadline = self.line, clock() + timeout
        while line.answer is None or line.answer == WIPED:
            if clock() > deadline:
                line.pending = None
                raise Timeout(f'no answer to "{text}" within {timeout:g} s')
            if line.answer == WIPED:
                self._send_line(text)
            if clock() - line.asked_at >= ASK_AGAIN:
                self.request()  # some firmware reads its input only while more arrives
            yield
        if isinstance(line.answer, Refused):
            raise line.answer

    def report(self) -> Generator[None, None, StatusReport]:
        seen = self.axis.statuses
        deadline = clock() + self._patience
        while self.axis.statuses == seen or self.axis.status is None:
            if clock() > deadline:
                raise Timeout(f"no answer to ? within {self._patience:g} s")
            if clock() - self.line.asked_at >= ASK_EVERY:
                self.request()
            yield
        return self.axis.status
