"""Driver of a pusher behind a GRBL 1.1 controller (Arduino GRBL, grblHAL) on a serial port.

Nothing here blocks, and there is no thread. The owner calls `poll()` a hundred times a second or more; it reads what has
arrived and takes the next step of what is under way. `ask()` requests a report. Waits are measured in real time.

A stroke is a stream of short jogs (`$J=`). The controller never has more of them than it moves through in the time `ahead`,
judged by the positions that it reports. If this process dies, hangs or loses the line, the pusher therefore stops after that
time. Each jog states all of its modes (G21 G90), so no modal state is relied on. No feed override changes a jog, and a feed
hold cancels it. Flow control is send-and-wait: a line is sent only after the controller has answered the last one.

`grbl_states.GRBL` is the table of its states: each phase is a script of commands and answers, and what happens decides which
one comes next. If anything goes wrong, `poll()` first tells the pusher to stop and then raises the error. Connecting, for the
first time or again, never moves the pusher and never ends an alarm: both wait for `recover()`.
"""

import contextlib
import math
import os
import statistics
import time
from collections import deque
from collections.abc import Generator
from typing import TYPE_CHECKING

from pushfric_core.pushers.clock import clock, suspended
from pushfric_core.pushers.grbl_protocol import (
    ALARM,
    BUILD,
    ERROR,
    GREETING,
    MODES,
    PARAMETER,
    SETTING,
    STATE_MODES,
    Alarm,
    CommandRefused,
    RealTime,
    StatusReport,
    parse_status,
    work_offset_of,
)
from pushfric_core.pushers.grbl_settings import AXES, GrblSettings, check_axis
from pushfric_core.pushers.grbl_states import AT_FIRST, GRBL, STOPPING, Action, Event, Phase, Role, Status, Trust
from pushfric_core.pushers.identity import identity_of
from pushfric_core.pushers.push_states import Homing
from pushfric_core.pushers.pusher import (
    Jumped,
    LeftTheWay,
    Limits,
    Mode,
    NotConnected,
    NotReady,
    PusherConfig,
    PusherError,
    PusherReport,
    Suspended,
    Timeout,
    TooFast,
)
from pushfric_core.pushers.serial_port import open_port, write_all
from pushfric_core.pushers.state_table import step
from pushfric_core.pushers.stroke import Plausibility, Stroke

if TYPE_CHECKING:
    import serial

Script = Generator[None, None, None]
"""A sequence of commands and answers; poll() takes it a step further."""
FINISHED = object()
WIPED = "wiped out by a reset"

ANSWER_TIMEOUT = 3.0  # [s], as all below
HOMING_TIMEOUT = 180.0
ASK_EVERY = 0.05  # while a script waits for reports
ASK_MOVING = 0.025  # in a stroke
ASK_AGAIN = 0.25  # a question that was not answered
ASK_AGAIN_MOVING = 0.06
SILENCE = 2.0  # at rest, unless the setting silence allows more
RESET_AGAIN = 1.0
RESET_PATIENCE = 6.0  # a greeting after a reset may take this long
CLOSE_TIMEOUT = 2.0
LONGEST_LINE = 4096  # [bytes]
ASKED_FOR_TWO_ALIKE = 6  # settings and offsets, which have no checksum
OFFSET_ROUNDING = 2e-3  # a sum of rounded numbers [mm]
STILL = 0.05  # another axis that is reported farther from its place than this has moved [mm]
SLEPT = 0.1  # a computer that was suspended for longer than this has lost sight of the pusher
REPORTS_UNTIL_WCO = 62  # the offset comes with every 30th report at the latest, and counts once it has come twice
IDLE_REPORTS = 10  # this many in a row away from the target mean that the motion ended early
NOT_IDLE = 8  # error
NOT_IDLE_OFTEN = 5  # this many of these errors may be waited out in one stroke
IMPOSSIBLE_FEED = 1.5  # times the controller's greatest speed
UNKNOWN_SPEED = 1.0  # greatest speed of a controller that does not say [m/s]
INCH = 25.4  # [mm]
MM = 1e-3  # [m]
MM_PER_MINUTE = MM / 60  # [m/s]
ECHOED = b"".join(command.value for command in RealTime)
"""What a terminal in between may echo, even in the middle of a line."""


class Grbl:
    """A Pusher: one linear axis of a GRBL 1.1 controller.

    Stroke position 0 is where the axis rests after homing; without homing, the zero of the controller's work coordinates.
    """

    def __init__(
        self,
        port: str,
        baud: int = GrblSettings.baud,
        axis: str = GrblSettings.axis,
        home: bool = PusherConfig.home,
        greeting_timeout: float = GrblSettings.connect_timeout,
        ahead: float = GrblSettings.ahead,
        silence: float = GrblSettings.silence,
        real_time_factor: float = GrblSettings.real_time_factor,
        only_look: bool = False,
    ) -> None:
        """Nothing is opened yet.

        Args:
            port: of the controller, such as /dev/ttyUSB0.
            baud: [bit/s]
            axis: X, Y, Z, A, B or C, with a minus sign if the stroke runs towards negative coordinates.
            home: `recover` seeks the home switch; otherwise it unlocks an alarm.
            greeting_timeout: how long a controller may take to boot [s].
            ahead: if nothing more is sent, the pusher goes on for this long and then brakes [s of real time].
            silence: a controller that says nothing for this long while it moves is stopped [s].
            real_time_factor: seconds of the controller in one of real time; 1 for any but a simulated one.
            only_look: never move, hold or reset the controller, and send it no line while it moves.
        Raises:
            ValueError: axis is not one of these.
        """
        check_axis(axis)
        self._path, self._baud, self._greeting_timeout = port, baud, greeting_timeout
        self._ahead, self._silence, self._factor = ahead, silence, real_time_factor
        self._role = Role.LOOKS if only_look else Role.DRIVES
        self._homing = Homing.HOMES if home else Homing.UNLOCKS
        self._state = AT_FIRST
        self._patience = max(SILENCE, silence)  # at rest
        self._letter, self._sign = axis[-1], -1 if axis[0] == "-" else 1
        self._index = AXES.index(self._letter)
        self._zero = 0.0  # work coordinate of stroke position 0 [mm]
        self._port: serial.Serial | None = None
        self._damaged = 0  # reports
        self._plausibility = Plausibility()
        self._forget()

    def _forget(self) -> None:
        """Forget all about the controller: nothing is known of it until it has answered."""
        self._buffer = b""
        self._script: Script | None = None  # of the phase
        self._greetings = 0
        self._owed = 0  # greetings, for resets that were sent
        self._stroke: Stroke | None = None  # until its end, or the end of the stop that broke it off
        self._doubt = ""  # why the position is in doubt, if it is
        self._polled: float | None = None  # when poll() was last called
        self._now_stamp: int | None = None
        self._asked_last = 0.0  # when the question behind the newest report was sent
        self._believed = 0  # reports
        self._feed = math.inf  # in the last report [m/s]
        self._claimed_offset: tuple[float, ...] | None = None  # reported, and not confirmed yet
        self._parameters: dict[str, str] = {}  # answers to $#
        self._modes = ""  # answer to $G
        self._place: tuple[float, ...] | None = None  # of all axes in the last report
        self._still: tuple[float, ...] | None = None  # where the other axes must stay
        self._strayed = False  # whether the last report said that one of them had moved
        self._slept = suspended()
        self._latencies: deque[float] = deque(maxlen=9)  # of the last answers to ? [s]
        self._plausibility.forget()
        self._status: StatusReport | None = None
        self._statuses = 0
        self._offset: tuple[float, ...] | None = None
        self._last: PusherReport | None = None
        self._fresh: PusherReport | None = None
        self._stamp: int | None = None
        self._asked: float | None = None  # when the last question was sent, if it is unanswered
        self._last_ask = -math.inf
        self._silent_since: float | None = None
        self._pending: str | None = None  # the line sent and not answered yet
        self._sent_at = 0.0
        self._answer: CommandRefused | str | None = None
        self._settings: dict[int, str] = {}
        self._version = ""
        self._trouble: PusherError | None = None

    # The state

    def _on(self, event: Event) -> bool:
        """Do what the table says of an event. False: it says nothing, so the event is refused. Raises NotConnected."""
        status = {Mode.IDLE: Status.IDLE, Mode.ALARM: Status.ALARM}.get(self._reported, Status.OTHER)
        following = step(GRBL, self._state, event, {status, self._role, self._homing})
        if following is None:
            return False
        before, self._state = self._state, following.state
        if Action.HOLD in following.actions:
            self.send(RealTime.HOLD)
        if any(isinstance(member, Phase) for member in self._state - before):
            self._begin()
        return True

    def _begin(self) -> None:
        """Begin the script of the phase, if it has one."""
        if self._script is not None:
            self._script.close()
        scripts = {
            Phase.CONNECTING: self._connecting,
            Phase.STREAMING: self._streaming,
            Phase.BRAKING: self._resting,
            Phase.RESETTING: self._reset,
            Phase.RECOVERING: self._reset,
            Phase.HOMING: self._seek_home,
            Phase.UNLOCKING: self._unlock,
        }
        self._script = next((script() for phase, script in scripts.items() if phase in self._state), None)
        if self._script is None:
            self._stroke = None

    def _suspect(self, why: str) -> None:
        """From now on, the position is in doubt."""
        self._doubt = why
        self._on(Event.DOUBT)

    @property
    def _connected(self) -> bool:
        return self._state.isdisjoint({Phase.CLOSED, Phase.CONNECTING})

    @property
    def _reported(self) -> Mode:
        """The mode of the last report."""
        return Mode.DISCONNECTED if self._status is None else STATE_MODES.get(self._status.state, Mode.HOLD)

    @property
    def mode(self) -> Mode:
        if not self._connected or self._status is None:
            return Mode.DISCONNECTED
        if Phase.HOMING in self._state:
            return Mode.HOMING
        if self._reported is Mode.IDLE and self.busy:  # idle means ready for a motion
            return Mode.RUNNING if Phase.STREAMING in self._state else Mode.HOLD
        return self._reported

    @property
    def busy(self) -> bool:
        return self._script is not None

    @property
    def name(self) -> str:
        return f"{self._version or 'no controller'} at {self._path}"

    @property
    def place(self) -> str:
        return identity_of(self._path)

    @property
    def doubt(self) -> str | None:
        return self._doubt if Trust.DOUBTED in self._state else None

    @property
    def dropped(self) -> int:
        return self._damaged + self._plausibility.dropped

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
        return self._setting(first + self._index, math.inf)

    def _setting(self, number: int, otherwise: float) -> float:
        try:
            return float(self._settings[number])
        except (KeyError, ValueError):
            return otherwise

    def connect(self) -> None:
        if self._port is not None:
            return
        if not os.path.exists(self._path):
            raise NotConnected(f"no serial port at {self._path}")
        self._forget()
        try:
            self._port = open_port(self._path, self._baud)
        except OSError as error:
            raise NotConnected(f"cannot open {self._path}: {error}") from error
        self._on(Event.CONNECT)

    def close(self) -> None:
        deadline = clock() + CLOSE_TIMEOUT
        # the port is being left whatever goes wrong, and _drop() sends the stop once more if it is still due
        with contextlib.suppress(PusherError):
            if self._in_motion:
                self.stop()
            while self._in_motion and clock() < deadline:
                self.poll()
                time.sleep(0.005)
        self._drop()

    def recover(self) -> None:
        if not self._connected:
            raise NotConnected(f"no controller is connected at {self._path}")
        if not self._on(Event.RECOVER):
            raise NotReady(f"the pusher's mode is {self.mode.value}, expected a pusher at rest")

    def move_to(self, position: float, speed: float) -> None:
        """See Pusher. Raises ValueError if the speed is not positive."""
        if not speed > 0:
            raise ValueError(f"speed must be positive, got {speed}")
        mode, latency = self.mode, statistics.median(self._latencies or [0.0])
        if mode is Mode.IDLE and latency > self._silence:
            raise NotReady(f"the controller at {self._path} answers after {latency:.2f} s; silence is {self._silence:g} s")
        if not self._on(Event.MOVE):
            if mode is not Mode.IDLE:
                raise NotReady(f"the pusher's mode is {mode.value}, expected idle")
            raise NotReady(f"where the pusher stands is not known until it is recovered: {self.doubt}")
        assert self._last is not None
        # a longer silence is allowed on a busy machine, to each piece
        ahead, wait = self._ahead * self._factor, max(0.0, self._silence - GrblSettings.silence)
        acceleration, latency = self.limits.acceleration, latency * self._factor
        self._stroke = Stroke(self._last.position, position, speed, acceleration, ahead, wait, latency)

    def stop(self) -> None:
        self._on(Event.STOP)

    def send(self, command: RealTime) -> None:
        """Send a real-time command. Raises NotConnected."""
        self._write(command.value)

    def ask(self, stamp: int) -> None:
        if self._connected and Phase.HOMING not in self._state:
            self._ask(stamp)

    def poll(self, stamp: int | None = None) -> PusherReport | None:
        if self._port is None:
            raise NotConnected(f"{self._path} is not open")
        self._fresh, self._now_stamp = None, stamp
        before, self._polled = self._polled, clock()
        try:
            self._read()
            if self._connected and (slept := suspended() - self._slept) > SLEPT:
                self._slept += slept
                raise Suspended(f"this computer was suspended for {slept:.1f} s")
            if Phase.STREAMING in self._state and before is not None and self._polled - before > self._silence:
                stood = f"{self._polled - before:.2f} s; silence is {self._silence:g} s"
                raise Timeout(f"this process stood still for {stood}")
            self._judge()
            self._step()
        except NotConnected:
            self._drop()
            raise
        except PusherError as error:
            if isinstance(error, Jumped | LeftTheWay | TooFast | Suspended):
                self._suspect(str(error))
            if self._connected and STOPPING.isdisjoint(self._state):
                self.stop()
                raise
            lost = NotConnected(f"{self.name}: {error}")
            self._drop()
            raise lost from error
        return self._fresh

    # What poll() does first: bytes, lines, meaning

    def _write(self, data: bytes) -> None:
        if self._port is None:
            raise NotConnected(f"{self._path} is not open")
        try:
            write_all(self._port, data)
        except OSError as error:
            self._drop()
            raise NotConnected(f"lost {self._path}: {error}") from error

    def _read(self) -> None:
        assert self._port is not None
        try:
            self._buffer += self._port.read(LONGEST_LINE)
        except OSError as error:
            raise NotConnected(f"lost {self._path}: {error}") from error
        *lines, self._buffer = self._buffer.split(b"\n")
        self._buffer = self._buffer[-LONGEST_LINE:]  # noise without an end of line
        for line in lines:
            self._take(line.translate(None, ECHOED).decode("ascii", errors="replace").strip())

    def _take(self, line: str) -> None:
        """Take one line; startup lines, echoes, feedback and noise are ignored."""
        if (greeting := GREETING.search(line)) is not None:  # a restart may cut off another line
            self._take_greeting(greeting[1])
        elif (status := parse_status(line)) is not None:
            self._take_status(status)
        elif line.startswith("<"):
            self._damaged += 1
        elif (error := ERROR.fullmatch(line)) is not None or line == "ok":
            if self._pending is not None:  # otherwise it is from before a reset, or about the controller's own memory
                self._answer = line if error is None else CommandRefused(self._pending, int(error[1]))
                self._pending, self._owed = None, 0  # so every greeting that was due before it has come
        elif (alarm := ALARM.fullmatch(line)) is not None:
            self._status = StatusReport("Alarm")
            self._trouble = self._trouble or Alarm(int(alarm[1]))  # a restart may bring an alarm of its own
        elif (build := BUILD.match(line)) is not None:
            self._version = f"Grbl {build[1]}"
        elif (setting := SETTING.match(line)) is not None and self._pending == "$$":
            self._settings[int(setting[1])] = setting[2]
        elif (parameter := PARAMETER.fullmatch(line)) is not None and self._pending == "$#":
            self._parameters[parameter[1]] = parameter[2]
        elif (modes := MODES.fullmatch(line)) is not None and self._pending == "$G":
            self._modes = modes[1]

    def _take_greeting(self, version: str) -> None:
        self._greetings += 1
        self._version = self._version or f"Grbl {version}"  # $I says more than the greeting
        self._pending, self._answer = None, WIPED if self._pending is not None else self._answer
        if self._owed:
            self._owed -= 1
        else:
            self._trouble = NotConnected(f"the controller at {self._path} restarted")

    def _take_status(self, status: StatusReport) -> None:
        """Take a status report; one that cannot be true changes nothing."""
        now = clock()
        # the report answers the first open question or an earlier one, so the pusher was there at that time or later
        asked = self._silent_since if self._silent_since is not None else self._asked_last
        position, place = status.work_position, status.machine_position or status.work_position
        if place is not None and not self._others_are_still(place):
            self._stamp = self._asked = None
            self._last_ask = -math.inf
            return
        if status.work_offset is not None:
            self._take_offset(status.work_offset)
        if position is None and place is not None:
            zero = self._offset or (0.0,) * (self._index + 1)
            position = tuple(m - o for m, o in zip(place, zero, strict=False))
        stamp = self._now_stamp if self._stamp is None else self._stamp
        if position is not None and len(position) > self._index:
            # rounded to the nanometre, far below a report's last digit, so that nothing is shown as -0.000
            here = round(self._sign * (position[self._index] * self._unit - self._zero) * MM, 9) + 0.0
            if not self._can_be_true(here, status, asked, now):
                self._stamp = self._asked = None
                return
            # in these states grblHAL reports no feed while it brakes, and the programmed feed at rest
            feed = None if status.state in ("Hold", "Door") else status.feed
            report = PusherReport(here, self._speed(here, feed, stamp, _moves(status)), self.mode, stamp)
        else:
            report = None
        if self._silent_since is not None:
            self._latencies.append(now - self._silent_since)
        self._stamp = self._asked = self._silent_since = None
        self._status, self._statuses, self._place, self._asked_last = status, self._statuses + 1, place, asked
        if status.overrides and status.overrides[0] != 100 and Phase.STREAMING in self._state:
            self.send(RealTime.FULL_FEED)
        if report is not None:
            self._fresh = self._last = report._replace(mode=self.mode)
            self._believed += 1

    def _take_offset(self, offset: tuple[float, ...]) -> None:
        """Take the work offset of a report. It displaces all positions, so a new one must come twice to mean anything."""
        again, self._claimed_offset = _agree(offset, self._claimed_offset, self._unit), offset
        if self._offset is None:
            self._offset = offset if again else None
        elif again and not _agree(offset, self._offset, self._unit):
            before, now = (_shown(one, self._unit) for one in (self._offset, offset))
            self._trouble = self._trouble or Jumped(f"the work offset of {self._path} is ({now}) mm now, it was ({before}) mm")

    def _others_are_still(self, place: tuple[float, ...]) -> bool:
        """Whether the other axes are where they were; two reports in a row that they are not are the end of any motion."""
        still = self._still
        if still is None or Phase.HOMING in self._state or self._role is Role.LOOKS:
            return True
        if len(place) != len(still):
            self._damaged += 1
            return False
        away = [abs(now - before) * self._unit for now, before in zip(place, still, strict=True)]
        away[self._index] = 0.0
        axis = away.index(max(away))
        if away[axis] <= STILL:
            self._strayed = False
            return True
        self._damaged += 1
        if self._strayed and self._connected:
            went = f"from {still[axis] * self._unit:.3f} mm to {place[axis] * self._unit:.3f} mm"
            self._trouble = self._trouble or LeftTheWay(f"axis {AXES[axis]} went {went}; only {self._letter} may move")
            self._still = None
        self._strayed = True
        return False

    def _can_be_true(self, position: float, status: StatusReport, asked: float, now: float) -> bool:
        if Phase.HOMING in self._state:  # positions start again
            self._plausibility.forget()
        greatest = self.limits.max_speed
        limit = greatest if math.isfinite(greatest) else UNKNOWN_SPEED
        speed = math.inf if status.feed is None else status.feed * self._unit * MM_PER_MINUTE
        if limit * IMPOSSIBLE_FEED < speed < math.inf:
            self._damaged += 1
            return False
        # in these states grblHAL reports no feed while it brakes
        before, self._feed = self._feed, math.inf if status.state in ("Hold", "Door") else speed
        reported = min(limit, max(before, self._feed))
        fastest = min(limit, self._stroke.speed) if self._stroke is not None else reported
        speeds = (speed * self._factor for speed in (fastest, reported, limit))
        believed, jumped_from = self._plausibility.judge(position, asked, now, *speeds)
        if jumped_from is not None and self._connected:
            jump = f"it was at {jumped_from:.4f} m and then, at once, at {position:.4f} m"
            self._trouble = self._trouble or Jumped(f"the controller at {self._path} cannot be believed: {jump}")
        return believed

    def _speed(self, position: float, feed: float | None, stamp: int | None, moves: bool) -> float:
        """The controller's feed with the sign of the motion; without a feed, the difference of the positions.

        While the controller says that it moves, two equal positions do not mean rest, but reports of one moment.
        """
        if self._last is None:
            return 0.0
        moved = position - self._last.position
        if feed is not None:
            way = moved or self._last.speed  # without a difference, both reports are of the same moment
            return math.copysign(feed * self._unit * MM_PER_MINUTE, way) + 0.0 if way else 0.0
        if moves and not moved:
            return self._last.speed
        if stamp is None or self._last.stamp is None or stamp <= self._last.stamp:
            return 0.0
        return moved / ((stamp - self._last.stamp) * 1e-9)

    @property
    def _unit(self) -> float:
        """The unit of positions in reports [mm]; settings and commands are always in mm."""
        return INCH if self._settings.get(13) == "1" else 1.0

    def _judge(self) -> None:
        """Raise what the lines just read mean for the connection; during a reset, alarms and greetings are expected."""
        trouble, self._trouble = self._trouble, None
        if not self._connected or self._state & {Phase.RESETTING, Phase.RECOVERING}:
            return
        if trouble is not None and not (Phase.BRAKING in self._state and isinstance(trouble, Alarm)):
            raise trouble
        if self._state & {Phase.BRAKING, Phase.HOMING} or self._silent_since is None:
            return
        silent = clock() - self._silent_since
        if Phase.STREAMING in self._state and silent > self._silence:
            what = f"said nothing for {silent:.2f} s in mid-stroke; silence is {self._silence:g} s"
            raise Timeout(f"the controller at {self._path} {what}")
        if silent > self._patience:
            raise NotConnected(
                f"the controller at {self._path} is silent for {silent:.1f} s, the limit is {self._patience:g} s"
            )

    def _step(self) -> None:
        while self._script is not None and next(self._script, FINISHED) is FINISHED:
            self._on(Event.DONE)

    @property
    def _in_motion(self) -> bool:
        """Whether it may be moving now or later."""
        rests = self.mode in (Mode.IDLE, Mode.ALARM) and not self.busy
        return self._role is Role.DRIVES and self._connected and not rests

    def _drop(self) -> None:
        """Leave the port; tell a pusher that may be moving to stop, although nobody can wait for it any more."""
        port, in_motion, homing = self._port, self._in_motion, Phase.HOMING in self._state
        self._forget()
        self._on(Event.LOST)
        self._port = None
        if port is None:
            return
        with contextlib.suppress(OSError):  # the port may be gone already
            if in_motion:  # a hold cancels a jog; only a reset ends a homing cycle
                write_all(port, RealTime.HOLD.value + (RealTime.RESET.value if homing else b""))
        port.close()

    def _ask(self, stamp: int | None) -> None:
        now = clock()
        again = ASK_AGAIN_MOVING if Phase.STREAMING in self._state else ASK_AGAIN
        if self._asked is not None and now - self._asked < again:
            return
        self.send(RealTime.ASK)
        self._stamp, self._asked, self._last_ask = stamp, now, now
        self._silent_since = self._silent_since or now

    # Scripts

    def _connecting(self) -> Script:
        yield from self._hear()
        status = yield from self._come_to_rest()
        if status.state not in ("Idle", "Alarm"):
            if self._role is Role.LOOKS:
                return
            yield from self._reset()  # nothing moves any more, and only now are lines read
        yield from self._command("$I")
        if self._version.startswith("Grbl 0."):
            raise NotConnected(f"{self.name} is too old, expected Grbl 1.1")
        yield from self._ask_for_settings()
        self._check_settings()
        yield from self._ask_for_offset()
        self._plausibility.forget()  # now that the unit of reports is known
        yield from self._find_place()

    def _hear(self) -> Script:
        """Wait for the greeting of a board that boots when its port is opened, or the answer of one that runs already."""
        deadline = clock() + self._greeting_timeout
        while not self._greetings and not self._statuses:
            if clock() > deadline:
                if self._role is Role.LOOKS:
                    raise NotConnected(f"no GRBL controller answers at {self._path}, {self._baud} baud")
                break
            self._ask(None)
            yield
        if self._version.startswith("Grbl 0."):
            raise NotConnected(f"{self.name} is too old, expected Grbl 1.1")
        if not self._greetings and not self._statuses:
            # after a limit, and while it homes, GRBL ignores everything but a reset
            self._suspect("it answered only after a reset")
            self.send(RealTime.HOLD)
            try:
                yield from self._reset()
            except Timeout as error:
                raise NotConnected(f"no GRBL controller answers at {self._path}, {self._baud} baud") from error

    def _come_to_rest(self) -> Generator[None, None, StatusReport]:
        """Hold a moving pusher, at its first report, and wait until it rests; with only_look, do neither."""
        status = self._status or (yield from self._report())
        while True:
            before = self._place
            if not _moves(status):
                again = yield from self._report()
                same = before is not None and before == self._place
                if again.state == status.state == "Alarm" or (same and not _moves(again)):
                    return again
                status = again
            self._suspect("it moved when it was found")
            if self._role is Role.LOOKS:
                return status
            self.send(RealTime.HOLD)
            status = yield from self._report()

    def _ask_for_settings(self) -> Script:
        """Ask for the settings until two answers agree: they say what a report means, and have no checksum."""
        before: dict[int, str] | None = None
        for _ in range(ASKED_FOR_TWO_ALIKE):
            self._settings = {}
            yield from self._command("$$")
            if self._settings == before:
                return
            before = self._settings
        raise NotConnected(f"{self.name}: its settings ($$) came {ASKED_FOR_TWO_ALIKE} times, each time different")

    def _ask_for_offset(self) -> Script:
        """Ask for the parts of the work offset until two answers agree, or one agrees with a report or with what is known.

        If a controller does not name the parts, the offset of two reports that agree is taken.
        """
        known = before = self._offset
        for _ in range(ASKED_FOR_TWO_ALIKE):
            self._parameters, self._modes = {}, ""
            try:
                yield from self._command("$#")
                yield from self._command("$G")
            except CommandRefused:
                return
            offset = work_offset_of(self._parameters, self._modes)
            if any(_agree(offset, other, self._unit) for other in (before, self._claimed_offset)) or not self._parameters:
                break
            before = offset
        else:
            raise NotConnected(f"{self.name}: its offsets ($#) came {ASKED_FOR_TWO_ALIKE} times, each time different")
        if known is not None and offset is not None and not _agree(offset, known, self._unit):
            was, now = (_shown(one, self._unit) for one in (known, offset))
            self._suspect(f"a reset changed its work offset from ({was}) mm to ({now}) mm")
            self._plausibility.forget()
        self._offset, self._claimed_offset = offset or known, None

    def _find_place(self) -> Script:
        """Wait until two reports in a row give the same place of all axes, at rest, because one may be damaged."""
        before: tuple[float, ...] | None = None
        for _ in range(REPORTS_UNTIL_WCO):
            status = yield from self._report()
            known = status.work_position is not None or self._offset is not None
            here = self._place if known and self._last is not None and not _moves(status) else None
            if here is not None and here == before:
                self._still, self._strayed = here, False
                return
            before = here

    def _check_settings(self) -> None:
        """Raises NotConnected if a setting that matters has an impossible value."""
        must_be_positive = {100 + self._index, 110 + self._index, 120 + self._index}
        for number in sorted(must_be_positive | {20, 22, 27, 130 + self._index}):
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
        yield from self._find_place()

    def _seek_home(self) -> Script:
        yield from self._command("$H", HOMING_TIMEOUT)
        yield from self._find_place()
        if self._last is not None:
            self._zero += self._sign * self._last.position / MM
        self._plausibility.forget()

    def _streaming(self) -> Script:
        """Send the pieces of a stroke, as there is room for them, until the pusher rests at its end."""
        assert self._last is not None
        assert self._stroke is not None
        stroke = self._stroke
        self.send(RealTime.FULL_FEED)
        self._answer, began, waits = None, clock(), False
        idle, seen, believed, patience = 0, self._statuses, self._believed, NOT_IDLE_OFTEN
        while True:
            now = clock()
            if self._pending is not None and (waited := now - self._sent_at) > self._silence:
                line, self._pending = self._pending, None
                raise Timeout(f'no answer to "{line}" for {waited:.2f} s; silence is {self._silence:g} s')
            if isinstance(self._answer, CommandRefused):
                if self._answer.code != NOT_IDLE or not patience:
                    raise self._answer
                # a piece that arrives at the very end of the one before runs as an ordinary line, and blocks jogs until its end
                self._answer, patience, waits = None, patience - 1, True
                stroke.take_back()
            if self._believed > believed:
                believed = self._believed
                stroke.check(self._last.position, self._last.speed)
            stroke.check_time(now - began)
            waits = waits and (self._status is None or self._status.state != "Idle" or self._statuses == seen)
            if self._pending is None and not waits and (end := stroke.next_piece(self._last.position)) is not None:
                self._send_line(self._jog(end, stroke.speed))
                idle, seen = 0, self._statuses
            elif self._pending is None and self._statuses > seen:
                seen = self._statuses
                assert self._status is not None
                if self.mode is Mode.ALARM:  # the line with its number was lost
                    raise Alarm(self._status.substate)
                # right after its `ok` a controller may still report that it idles where it was
                idle = idle + 1 if self._status.state == "Idle" else 0
                if idle and stroke.all_sent and abs(self._last.position - stroke.target) <= self._resolution:
                    return
                if idle >= IDLE_REPORTS:
                    rests = f"the pusher rests at {self._last.position:.4f} m"
                    raise Timeout(f"{rests}, was sent to {stroke.sent:.4f} m")
            if now - self._last_ask >= ASK_MOVING:
                self._ask(self._now_stamp)
            yield

    def _jog(self, position: float, speed: float) -> str:
        # adding 0.0 turns -0.0 into 0.0
        target = round(self._zero + self._sign * position / MM, 3) + 0.0
        return f"$J=G21G90{self._letter}{target:.3f}F{speed / MM_PER_MINUTE:.3f}"

    @property
    def _resolution(self) -> float:
        """How near the controller gets to a target [m]: a motor step, or the last digit of a report in inches."""
        return max(0.02, 1 / self._axis_setting(100)) * MM

    def _reset(self) -> Script:
        """Raises Timeout if the controller does not answer afterwards."""
        if Phase.RECOVERING in self._state:
            self._still = None
        # for half a second, while it reports its alarm, GRBL drops a reset
        dropped = self._status is not None and self._status.state == "Alarm"
        before = self._greetings
        self._pending = self._asked = self._silent_since = None  # a reset wipes out what was sent
        self._send_reset()
        again, deadline = clock() + RESET_AGAIN, clock() + RESET_PATIENCE
        while self._greetings == before and clock() < deadline:
            if dropped and clock() > again:
                self._send_reset()
                dropped = False
            yield
        if self._greetings == before:  # whatever it reports then, it may have restarted unheard
            raise Timeout(f"no greeting within {RESET_PATIENCE:g} s of a reset")
        settled = clock() + RESET_AGAIN
        while self._owed and clock() < settled:  # a second reset would wipe out what is sent now
            yield
        if self._offset is not None:  # a reset ends shifts (G92) and may choose another coordinate system
            yield from self._ask_for_offset()
        yield from self._report()

    def _send_reset(self) -> None:
        self.send(RealTime.RESET)
        self._owed += 1

    def _resting(self) -> Script:
        """Wait for the end of a feed hold: a reset before it costs the position. A stuck controller is reset anyway."""
        braking = self.limits.max_speed / self.limits.acceleration
        deadline = clock() + 1 + (braking if math.isfinite(braking) else 0)
        before = None
        while clock() < deadline:
            try:
                status = yield from self._report()
            except Timeout:
                return
            moving = _moves(status)
            place = status.machine_position or status.work_position
            if not moving and place == before:
                return
            if status.state in ("Run", "Jog"):
                self.send(RealTime.HOLD)  # a line that was on its way starts a motion again; a second hold does no harm
            before = None if moving else place

    def _send_line(self, line: str) -> None:
        self._pending, self._answer, self._sent_at = line, None, clock()
        self._write(line.encode() + b"\n")

    def _command(self, line: str, timeout: float = ANSWER_TIMEOUT) -> Script:
        self._send_line(line)
        deadline = clock() + timeout
        while self._answer is None or self._answer == WIPED:
            if clock() > deadline:
                self._pending = None
                raise Timeout(f'no answer to "{line}" within {timeout:g} s')
            if self._answer == WIPED:
                self._send_line(line)
            if clock() - self._last_ask >= ASK_AGAIN:
                self._ask(None)  # some firmware reads its input only while more arrives
            yield
        if isinstance(self._answer, CommandRefused):
            raise self._answer

    def _report(self) -> Generator[None, None, StatusReport]:
        seen = self._statuses
        deadline = clock() + self._patience
        while self._statuses == seen or self._status is None:
            if clock() > deadline:
                raise Timeout(f"no answer to ? within {self._patience:g} s")
            if clock() - self._last_ask >= ASK_EVERY:
                self._ask(None)
            yield
        return self._status


def _agree(offset: tuple[float, ...] | None, other: tuple[float, ...] | None, unit: float) -> bool:
    if offset is None or other is None or len(offset) != len(other):
        return False
    return all(abs(one - another) * unit <= OFFSET_ROUNDING for one, another in zip(offset, other, strict=True))


def _shown(offset: tuple[float, ...], unit: float) -> str:
    return ", ".join(f"{value * unit:.3f}" for value in offset)


def _moves(status: StatusReport) -> bool:
    return status.state in ("Run", "Jog", "Home") or (status.state, status.substate) == ("Hold", 1)
