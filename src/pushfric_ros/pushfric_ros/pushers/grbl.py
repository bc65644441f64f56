"""Driver of a pusher behind a GRBL 1.1 controller (Arduino GRBL, grblHAL, FluidNC) on a serial port.

Nothing here blocks and there is no thread: the owner calls `poll()` a hundred times a second or more, which reads what has
arrived and takes the next step of what is under way; `ask()` requests a report. Waits are measured in real time.

Flow control is send-and-wait: a line is sent only after the controller answered the last one. One stroke is one line, so
nothing is gained from keeping the controller's buffer full, and what was refused is always known.

    DISCONNECTED --connect(), greeting, $I, $$, ?--> IDLE, or ALARM; an alarm is unlocked ($X) unless homing is configured
    IDLE, HOLD, ALARM --recover(): soft reset, $H where homing is configured, else $X--> HOMING --> IDLE
    IDLE --move_to()--> RUNNING --target reached--> IDLE
    RUNNING, HOMING --stop(): feed hold, rest, soft reset--> HOLD --> IDLE; ALARM if the controller lost its position by it
    RUNNING --a button at the controller--> HOLD --another--> RUNNING
    any --ALARM:n--> ALARM --recover()--> as after connect()
    any --port gone, silence, restart of the controller--> DISCONNECTED

Whatever goes wrong is raised by `poll()`, after the pusher has been told to stop. A connection never moves the pusher,
first or made again: homing waits for `recover()`.
"""

import contextlib
import math
import os
import time
from collections.abc import Generator

import serial

from pushfric_ros.pushers.grbl_config import check_axis
from pushfric_ros.pushers.grbl_protocol import (
    ALARM,
    BUILD,
    ERROR,
    GREETING,
    SETTING,
    STATE_MODES,
    Alarm,
    CommandRefused,
    RealTime,
    Status,
    parse_status,
)
from pushfric_ros.pushers.pusher import Limits, Mode, NotConnected, NotReady, PusherError, PusherReport, Timeout

Script = Generator[None, None, None]
"""A sequence of commands and answers; poll() takes it a step further."""
FINISHED = object()

WRITE_TIMEOUT = 0.5  # [s], as all below
ANSWER_TIMEOUT = 3.0
HOMING_TIMEOUT = 180.0
ASK_EVERY = 0.05  # while a script waits for reports
ASK_AGAIN = 0.25
SILENCE = 2.0
RESET_AGAIN = 1.0
CLOSE_TIMEOUT = 2.0
LONGEST_LINE = 4096  # [bytes]
REPORTS_UNTIL_WCO = 31  # the offset comes with every 30th report at the latest
IDLE_REPORTS = 10  # as many away from the target mean that the motion ended early
INCH = 25.4  # [mm]
MM = 1e-3  # [m]
MM_PER_MINUTE = MM / 60  # [m/s]


class Grbl:
    """A Pusher: one linear axis of a GRBL 1.1 controller.

    Stroke position 0 is where the axis rests after homing; without homing, zero of the controller's work coordinates.
    """

    def __init__(
        self, port: str, baud: int = 115200, axis: str = "X", home: bool = False, greeting_timeout: float = 2.0
    ) -> None:
        """Nothing is opened yet.

        Args:
            port: of the controller, such as /dev/ttyUSB0.
            baud: [bit/s]
            axis: X, Y, Z, A, B or C, with a minus sign where the stroke runs towards negative coordinates.
            home: `recover` seeks the home switch; otherwise it unlocks an alarm, and so does every connection.
            greeting_timeout: how long a controller may take to boot [s].
        Raises:
            ValueError: axis is none of these.
        """
        check_axis(axis)
        self._path, self._baud, self._home, self._greeting_timeout = port, baud, home, greeting_timeout
        self._letter, self._sign = axis[-1], -1 if axis[0] == "-" else 1
        self._index = "XYZABC".index(self._letter)
        self._zero = 0.0  # work coordinate of stroke position 0 [mm]
        self._port: serial.Serial | None = None
        self._forget()

    def _forget(self) -> None:
        """Nothing is known of a controller until it has answered."""
        self._buffer = b""
        self._script: Script | None = None
        self._connected = self._homing = self._moving = self._halting = self._resetting = self._greeted = False
        self._recovery_due = False  # once a stop under way is over
        self._status: Status | None = None
        self._statuses = 0
        self._offset: tuple[float, ...] | None = None
        self._last: PusherReport | None = None
        self._fresh: PusherReport | None = None
        self._stamp: int | None = None
        self._asked: float | None = None  # when the last question was sent, if it is unanswered
        self._last_ask = -math.inf
        self._silent_since: float | None = None
        self._pending: str | None = None  # the line sent and not answered yet
        self._answer: CommandRefused | str | None = None
        self._settings: dict[int, str] = {}
        self._version = ""
        self._trouble: PusherError | None = None

    @property
    def mode(self) -> Mode:
        if not self._connected or self._status is None:
            return Mode.DISCONNECTED
        if self._homing:
            return Mode.HOMING
        mode = STATE_MODES.get(self._status.state, Mode.HOLD)
        if mode is Mode.IDLE and self.busy:  # idle means ready for a motion
            return Mode.RUNNING if self._moving else Mode.HOLD
        return mode

    @property
    def busy(self) -> bool:
        return self._script is not None or self._recovery_due

    @property
    def name(self) -> str:
        return f"{self._version or 'no controller'} at {self._path}"

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
        """Infinite where firmware keeps it elsewhere."""
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
            self._port = serial.Serial(self._path, self._baud, timeout=0, write_timeout=WRITE_TIMEOUT, exclusive=True)
        except (OSError, ValueError) as error:
            raise NotConnected(f"cannot open {self._path}: {error}") from error
        self._script = self._connecting()

    def close(self) -> None:
        deadline = time.monotonic() + CLOSE_TIMEOUT
        # whatever comes up, the port is being left, and _drop() sends the stop once more where it is still due
        with contextlib.suppress(PusherError):
            if self._in_motion:
                self.stop()
            while self._in_motion and time.monotonic() < deadline:
                self.poll()
                time.sleep(0.005)
        self._drop()

    def recover(self) -> None:
        if not self._connected:
            raise NotConnected(f"no controller is connected at {self._path}")
        if self._moving or self._homing:
            raise NotReady(f"the pusher's mode is {self.mode.value}, expected a pusher at rest")
        self._recovery_due = True

    def move_to(self, position: float, speed: float) -> None:
        """Raises ValueError where the speed is not positive; see Pusher."""
        if not speed > 0:
            raise ValueError(f"speed must be positive, got {speed}")
        if self.mode is not Mode.IDLE:
            raise NotReady(f"the pusher's mode is {self.mode.value}, expected idle")
        self._moving = True
        self._script = self._stroke(position, speed)

    def stop(self) -> None:
        self._recovery_due = False
        if not self._connected or self._halting:
            return
        self.send(RealTime.HOLD)
        # the controller is deaf to a feed hold then; after some alarms to all but the reset
        at_once = self._homing or self.mode is Mode.ALARM
        if self._script is not None:
            self._script.close()
        self._moving = False
        # from now on, and for good if this fails: then there is nothing left but to leave the port
        self._halting = True
        self._script = self._stopping(at_once)

    def send(self, command: RealTime) -> None:
        """Send a real-time command. Raises NotConnected."""
        self._write(command.value)

    def ask(self, stamp: int) -> None:
        if self._connected and not self._homing:
            self._ask(stamp)

    def poll(self) -> PusherReport | None:
        if self._port is None:
            raise NotConnected(f"{self._path} is not open")
        self._fresh = None
        try:
            self._read()
            self._judge()
            self._step()
        except NotConnected:
            self._drop()
            raise
        except PusherError as error:
            if self._connected and not self._halting:
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
            self._port.write(data)
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
            self._take(line.decode("ascii", errors="replace").strip())

    def _take(self, line: str) -> None:
        """What is not understood (startup lines, echoes, feedback, noise) is none of a pusher's business."""
        line = line.lstrip("?!~")  # echoed by a terminal in between
        if (status := parse_status(line)) is not None:
            self._take_status(status)
        elif (error := ERROR.fullmatch(line)) is not None or line == "ok":
            if self._pending is not None:  # otherwise it is from before a reset, or about the controller's own memory
                self._answer = line if error is None else CommandRefused(self._pending, int(error[1]))
                self._pending = None
        elif (alarm := ALARM.fullmatch(line)) is not None:
            self._status = Status("Alarm")
            self._trouble = self._trouble or Alarm(int(alarm[1]))  # a restart may bring an alarm of its own
        elif (greeting := GREETING.search(line)) is not None:
            self._greeted, self._version = True, self._version or f"Grbl {greeting[1]}"  # $I told more
            self._trouble = NotConnected(f"the controller at {self._path} restarted")
        elif (build := BUILD.match(line)) is not None:
            self._version = f"Grbl {build[1]}"
        elif (setting := SETTING.match(line)) is not None:
            self._settings[int(setting[1])] = setting[2]

    def _take_status(self, status: Status) -> None:
        self._status, self._statuses = status, self._statuses + 1
        self._offset = status.work_offset or self._offset
        stamp, self._stamp, self._asked, self._silent_since = self._stamp, None, None, None
        offset = self._offset or (0.0,) * (self._index + 1)
        position = status.work_position
        if position is None and status.machine_position is not None:
            position = tuple(m - o for m, o in zip(status.machine_position, offset, strict=False))
        if position is None or len(position) <= self._index:
            return
        # to the nanometre, far below a report's last digit: nothing that would be shown as -0.000
        here = round(self._sign * (position[self._index] * self._unit - self._zero) * MM, 9) + 0.0
        # in these, grblHAL reports no feed while it brakes, and the programmed one at rest
        feed = None if status.state in ("Hold", "Door") else status.feed
        self._fresh = self._last = PusherReport(here, self._speed(here, feed, stamp), self.mode, stamp)

    def _speed(self, position: float, feed: float | None, stamp: int | None) -> float:
        """The controller says how fast, the positions say which way; both, where the controller says nothing."""
        if self._last is None:
            return 0.0
        moved = position - self._last.position
        if feed is not None:
            way = moved or self._last.speed  # two reports of the same moment
            return math.copysign(feed * self._unit * MM_PER_MINUTE, way) + 0.0 if way else 0.0
        if stamp is None or self._last.stamp is None or stamp <= self._last.stamp:
            return 0.0
        return moved / ((stamp - self._last.stamp) * 1e-9)

    @property
    def _unit(self) -> float:
        """Of reports [mm]; settings and commands are always in mm."""
        return INCH if self._settings.get(13) == "1" else 1.0

    def _judge(self) -> None:
        """Raise what the lines just read mean for a connection; a reset brings alarms and greetings of its own."""
        trouble, self._trouble = self._trouble, None
        if not self._connected or self._resetting:
            return
        if trouble is not None and not (self._halting and isinstance(trouble, Alarm)):
            raise trouble
        if self._halting:
            return
        if self._silent_since is not None and not self._homing and time.monotonic() - self._silent_since > SILENCE:
            raise NotConnected(f"the controller at {self._path} is silent for {SILENCE:g} s")

    def _step(self) -> None:
        if self._script is None and self._recovery_due:
            self._script, self._recovery_due = self._recovering(), False
        if self._script is not None and next(self._script, FINISHED) is FINISHED:
            self._script, self._moving = None, False

    @property
    def _in_motion(self) -> bool:
        """Whether it may be moving now or later."""
        return self._connected and (self.busy or self.mode not in (Mode.IDLE, Mode.ALARM))

    def _drop(self) -> None:
        """Leave the port; a pusher that may be moving is told to stop, though nobody can wait for it any more."""
        port, in_motion = self._port, self._in_motion
        self._forget()
        self._port = None
        if port is None:
            return
        with contextlib.suppress(OSError):  # it may be the loss of the port that led here
            if in_motion:
                port.write(RealTime.HOLD.value + RealTime.RESET.value)
        port.close()

    def _ask(self, stamp: int | None) -> None:
        now = time.monotonic()
        if self._asked is not None and now - self._asked < ASK_AGAIN:
            return
        self.send(RealTime.ASK)
        self._stamp, self._asked, self._last_ask = stamp, now, now
        self._silent_since = self._silent_since or now

    # Scripts

    def _connecting(self) -> Script:
        yield from self._greeting()
        yield from self._command("$I")
        yield from self._command("$$")
        for _ in range(REPORTS_UNTIL_WCO):
            status = yield from self._report()
            if status.work_position is not None or self._offset is not None:
                break
        self._connected = True
        if not self._home:
            yield from self._unlock()
        yield from self._prepare()

    def _recovering(self) -> Script:
        yield from self._reset()  # some alarms ask for it
        yield from self._seek_home() if self._home else self._unlock()
        yield from self._prepare()

    def _greeting(self) -> Script:
        """A board that boots when its port is opened greets; a running one greets after a reset, or answers `?` only."""
        yield from self._until_greeted(self._greeting_timeout)
        if not self._greeted:
            self.send(RealTime.RESET)
            yield from self._until_greeted(self._greeting_timeout)
        if not self._greeted:
            try:
                yield from self._report()
            except Timeout as error:
                raise NotConnected(f"no GRBL controller answers at {self._path}, {self._baud} baud") from error
        if self._version.startswith("Grbl 0."):
            raise NotConnected(f"{self.name} is too old, expected Grbl 1.1")

    def _until_greeted(self, patience: float) -> Script:
        deadline = time.monotonic() + patience
        while not self._greeted and time.monotonic() < deadline:
            yield

    def _unlock(self) -> Script:
        if self.mode is Mode.ALARM:
            yield from self._command("$X")
            yield from self._report()

    def _seek_home(self) -> Script:
        self._homing = True
        try:
            yield from self._command("$H", HOMING_TIMEOUT)
            yield from self._report()
        finally:
            self._homing = False
        if self._last is not None:
            self._zero += self._sign * self._last.position / MM

    def _prepare(self) -> Script:
        """Millimetres, absolute, per minute: a reset or a startup line may have changed them."""
        if self.mode is not Mode.ALARM:
            yield from self._command("G21 G90 G94")

    def _stroke(self, position: float, speed: float) -> Script:
        # adding 0.0 turns -0.0 into 0.0
        target = round(self._zero + self._sign * position / MM, 3) + 0.0
        yield from self._command(f"G1 {self._letter}{target:.3f} F{speed / MM_PER_MINUTE:.3f}")
        idle = 0
        while idle < IDLE_REPORTS:
            seen = self._statuses
            while self._statuses == seen:
                yield
            # right after its `ok` a controller may still report to be idle where it was
            assert self._status is not None
            idle = idle + 1 if self._status.state == "Idle" else 0
            if self.mode is Mode.ALARM:  # the line that said so was lost
                raise Alarm(self._status.substate)
            if idle and self._last is not None and abs(self._last.position - position) <= self._resolution:
                return
        raise Timeout(f"the pusher rests at {self._last.position if self._last else 0:.4f} m, was sent to {position:.4f} m")

    @property
    def _resolution(self) -> float:
        """How near the controller gets to a target [m]: a motor step, and the last digit of a report in inches."""
        return max(0.02, 1 / self._axis_setting(100)) * MM

    def _stopping(self, at_once: bool) -> Script:
        if not at_once:
            yield from self._resting()
        yield from self._reset()
        yield from self._prepare()
        self._halting = False

    def _reset(self) -> Script:
        self._resetting = True
        try:
            self._greeted = False
            self._pending = self._asked = self._silent_since = None  # a reset wipes out what was sent
            # GRBL drops a reset that comes while it still reports its alarm, for half a second
            for patience in (RESET_AGAIN, self._greeting_timeout):
                if not self._greeted:
                    self.send(RealTime.RESET)
                    yield from self._until_greeted(patience)
            yield from self._report()
        finally:
            self._resetting = False

    def _resting(self) -> Script:
        """Wait for the end of a feed hold: reset earlier, a controller loses its position. A stuck one is reset anyway."""
        braking = self.limits.max_speed / self.limits.acceleration
        deadline = time.monotonic() + 1 + (braking if math.isfinite(braking) else 0)
        before = None
        while time.monotonic() < deadline:
            try:
                status = yield from self._report()
            except Timeout:
                return
            moving = status.state in ("Run", "Jog", "Home") or (status.state, status.substate) == ("Hold", 1)
            place = status.machine_position or status.work_position
            if not moving and place == before:
                return
            before = None if moving else place

    def _command(self, line: str, timeout: float = ANSWER_TIMEOUT) -> Script:
        self._pending, self._answer = line, None
        self._write(line.encode() + b"\n")
        deadline = time.monotonic() + timeout
        while self._answer is None:
            if time.monotonic() > deadline:
                self._pending = None
                raise Timeout(f'no answer to "{line}" within {timeout:g} s')
            if time.monotonic() - self._last_ask >= ASK_AGAIN:
                self._ask(None)  # some firmware reads its input only while more is coming
            yield
        if isinstance(self._answer, CommandRefused):
            raise self._answer

    def _report(self) -> Generator[None, None, Status]:
        seen = self._statuses
        deadline = time.monotonic() + SILENCE
        while self._statuses == seen or self._status is None:
            if time.monotonic() > deadline:
                raise Timeout(f"no answer to ? within {SILENCE:g} s")
            if time.monotonic() - self._last_ask >= ASK_EVERY:
                self._ask(None)
            yield
        return self._status
