"""The common part of all drivers of pushers: it runs the table of states, whatever line leads to the pusher.

Nothing here blocks, and there is no thread. The owner calls `poll()` a hundred times a second or more; it reads what has
arrived and takes the next step of what is under way. `ask()` requests a report. Waits are measured in real time.

`DRIVER` is the table: each phase is a script, and what happens decides which one comes next. If anything goes
wrong, `poll()` first tells the pusher to stop and then raises the error. Connecting, for the first time or again, never moves
the pusher and never ends an alarm: both wait for `recover()`.
"""

import contextlib
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator, Mapping
from enum import Enum

from pushfric_core.pushers.clock import Wakefulness, clock
from pushfric_core.pushers.pusher import (
    POLL_PERIOD,
    Halted,
    Held,
    Jumped,
    LeftTheWay,
    Mode,
    NotConnected,
    NotReady,
    PusherError,
    PusherReport,
    Suspended,
    Timeout,
    TooFast,
)
from pushfric_core.pushers.states import Homing, Row, State, step
from pushfric_core.pushers.stroke import Stroke


class Phase(Enum):
    """The driver's activity; each phase but the first and the one at rest is a script, which ends with DriverEvent.DONE."""

    CLOSED = "port closed"
    CONNECTING = "connecting"
    RESTING = "at rest"
    STREAMING = "in a stroke"
    BRAKING = "braking"
    RESETTING = "reset to stop"
    RECOVERING = "reset to recover"
    HOMING = "homing"
    UNLOCKING = "unlocking"


class ReportedMode(Enum):
    """The controller's mode, as it reports it."""

    IDLE = "reported idle"
    ALARM = "reported in alarm"
    OTHER = "reported otherwise"


Trust = Enum("Trust", {"TRUSTED": "position trusted", "DOUBTED": "position in doubt"})
Next = Enum("Next", {"NOTHING": "nothing due", "RECOVERY": "recovery due"})
"""The step that a stop leaves due."""
Role = Enum("Role", {"DRIVES": "may interfere", "LOOKS": "only looks"})


class DriverEvent(Enum):
    """An event at the driver."""

    CONNECT = "connect"
    MOVE = "move"
    STOP = "stop"  # or any error
    RECOVER = "recover"
    DONE = "script done"
    DOUBT = "doubt"  # a report that cannot be true, a suspension, another offset
    LOST = "line lost"  # or left


class DriverAction(Enum):
    """A command that is sent at once."""

    HOLD = "feed hold"


E, P = DriverEvent, Phase
STOPPING: set[Enum] = {P.BRAKING, P.RESETTING}
STOPPABLE = {Role.DRIVES, P.RESTING, P.STREAMING, P.RECOVERING, P.UNLOCKING}

DRIVER = (
    Row((E.CONNECT,), {P.CLOSED}, {P.CONNECTING, Trust.TRUSTED}),
    Row((E.MOVE,), {Role.DRIVES, P.RESTING, Trust.TRUSTED, ReportedMode.IDLE}, {P.STREAMING}),
    Row((E.DONE,), {P.CONNECTING, P.STREAMING}, {P.RESTING}),
    Row((E.STOP,), STOPPABLE | {ReportedMode.IDLE, ReportedMode.OTHER}, {P.BRAKING}, DriverAction.HOLD),
    Row((E.STOP,), STOPPABLE | {ReportedMode.ALARM}, {P.RESETTING}, DriverAction.HOLD),  # it may obey nothing but a reset
    Row((E.STOP,), {Role.DRIVES, P.HOMING}, {P.RESETTING}, DriverAction.HOLD),
    Row((E.STOP,), STOPPING, {Next.NOTHING}),
    Row((E.DONE,), {P.BRAKING}, {P.RESETTING}),
    Row((E.DONE,), {P.RESETTING, Next.NOTHING}, {P.RESTING}),
    Row((E.DONE,), {P.RESETTING, Next.RECOVERY}, {P.RECOVERING, Next.NOTHING}),
    Row((E.RECOVER,), {Role.DRIVES, P.RESTING}, {P.RECOVERING}),
    Row((E.RECOVER,), STOPPING, {Next.RECOVERY}),
    Row((E.DONE,), {P.RECOVERING, Homing.HOMES}, {P.HOMING}),
    Row((E.DONE,), {P.RECOVERING, Homing.UNLOCKS}, {P.UNLOCKING}),
    Row((E.DONE,), {P.HOMING, P.UNLOCKING}, {P.RESTING, Trust.TRUSTED}),
    Row((E.DOUBT,), set(), {Trust.DOUBTED}),
    Row((E.LOST,), set(), {P.CLOSED, Next.NOTHING}),
)

AT_FIRST: State = frozenset({P.CLOSED, Trust.TRUSTED, Next.NOTHING})


Script = Generator[None, None, None]
"""A sequence of commands and answers; poll() takes it a step further."""
FINISHED = object()
CLOSE_TIMEOUT = 2.0  # [s]


class Driver(ABC):
    """A Pusher, except for what depends on the line that leads to it."""

    def __init__(self, silence: float, patience: float, homing: Homing = Homing.UNLOCKS, role: Role = Role.DRIVES) -> None:
        """Nothing is opened yet.

        Args:
            silence: a pusher of which nothing is heard for this long in a stroke is stopped [s].
            patience: one of which nothing is heard for this long at rest is lost [s].
            homing: the way to recover.
            role: whether it may move, hold or reset the pusher.
        """
        self._silence, self._patience, self._homing, self._role = silence, patience, homing, role
        self._state = AT_FIRST
        self._forget()

    def _forget(self) -> None:
        """Forget all about the pusher: nothing is known of it until it has been heard."""
        self._script: Script | None = None  # of the phase
        self._stroke: Stroke | None = None  # until its end, or the end of the stop that broke it off
        self._doubt = ""  # why the position is in doubt, if it is
        self._polled: float | None = None  # when poll() was last called
        self._gap = 0.0  # between the last two calls [s]
        self._now_stamp: int | None = None
        self._awake = Wakefulness()
        self._trouble: PusherError | None = None

    # What differs between lines

    @property
    @abstractmethod
    def name(self) -> str: ...

    @property
    @abstractmethod
    def _reported(self) -> Mode:
        """The mode of the last report; DISCONNECTED without one."""

    @property
    @abstractmethod
    def _silent(self) -> float:
        """For how long nothing has been heard, although something should have been [s]."""

    @abstractmethod
    def _open(self) -> None:
        """Open the line. Raises NotConnected."""

    @abstractmethod
    def _leave(self, before: State, in_motion: bool) -> None:
        """Leave the line, with last words to a pusher that may be in motion; `before` is the state until now."""

    @abstractmethod
    def hold(self, homing: bool = False) -> None:
        """Have the pusher stop at once, and keep its position unless it is homing. Raises NotConnected."""

    @abstractmethod
    def _start(self, position: float, speed: float) -> Stroke:
        """The stroke from here to a position [m] at a speed [m/s]."""

    @abstractmethod
    def _hear(self) -> None:
        """Take all that has arrived. Raises PusherError."""

    @abstractmethod
    def _newest(self) -> PusherReport | None:
        """The report that poll() returns."""

    @abstractmethod
    def _scripts(self) -> Mapping[Phase, Callable[[], Script]]:
        """The scripts of the phases; a phase without one has ended when it begins.

        CONNECTING finds out who answers, brings it to rest, and learns its limits and its position; it moves nothing.
        STREAMING sends the stroke, as there is room for it, until the pusher rests at its end. BRAKING waits until it rests.
        RESETTING and RECOVERING discard all that has been sent. HOMING moves to the home switch, UNLOCKING ends an alarm.
        """

    # The state

    def _on(self, event: DriverEvent) -> bool:
        """Do what the table says of an event. False: it says nothing, so the event is refused. Raises NotConnected."""
        status = {Mode.IDLE: ReportedMode.IDLE, Mode.ALARM: ReportedMode.ALARM}.get(self._reported, ReportedMode.OTHER)
        following = step(DRIVER, self._state, event, {status, self._role, self._homing})
        if following is None:
            return False
        before, self._state = self._state, following.state
        if DriverAction.HOLD in following.actions:
            self.hold(homing=Phase.HOMING in before)
        if any(isinstance(member, Phase) for member in self._state - before):
            self._begin()
        return True

    def _begin(self) -> None:
        """Begin the script of the phase."""
        if self._script is not None:
            self._script.close()
        phase = next(member for member in self._state if isinstance(member, Phase))
        if phase in (Phase.CLOSED, Phase.RESTING):
            self._script = self._stroke = None
        else:
            self._script = self._scripts().get(phase, lambda: (yield from ()))()

    def suspect(self, why: str) -> None:
        """From now on, the position is in doubt."""
        self._doubt = why
        self._on(DriverEvent.DOUBT)

    def _blame(self, error: PusherError) -> None:
        """An error was heard of: the next poll() raises it, unless an earlier one is due; a lost connection comes first."""
        if self._trouble is None or isinstance(error, NotConnected):
            self._trouble = error

    @property
    def _connected(self) -> bool:
        return self._state.isdisjoint({Phase.CLOSED, Phase.CONNECTING})

    @property
    def mode(self) -> Mode:
        """See Pusher; idle means ready for a motion."""
        if not self._connected or self._reported is Mode.DISCONNECTED:
            return Mode.DISCONNECTED
        if Phase.HOMING in self._state:
            return Mode.HOMING
        if self._reported is Mode.IDLE and self.busy:
            return Mode.RUNNING if Phase.STREAMING in self._state else Mode.HOLD
        return self._reported

    @property
    def busy(self) -> bool:
        """See Pusher."""
        return self._script is not None

    @property
    def doubt(self) -> str | None:
        """See Pusher."""
        return self._doubt if Trust.DOUBTED in self._state else None

    # What the actuator asks

    def connect(self) -> None:
        """See Pusher."""
        if Phase.CLOSED in self._state:
            self._forget()
            self._open()
            self._on(DriverEvent.CONNECT)

    def close(self) -> None:
        """See Pusher."""
        deadline = clock() + CLOSE_TIMEOUT
        # the line is being left whatever goes wrong, and _drop() sends the stop once more if it is still due
        with contextlib.suppress(PusherError):
            if self._in_motion:
                self.stop()
            while self._in_motion and clock() < deadline:
                self.poll()
                time.sleep(POLL_PERIOD)
        self._drop()

    def recover(self) -> None:
        """See Pusher."""
        if not self._connected:
            raise NotConnected(f"the pusher is not connected: {self.name}")
        if not self._on(DriverEvent.RECOVER):
            raise NotReady(f"the pusher's mode is {self.mode.value}, expected a pusher at rest")

    def move_to(self, position: float, speed: float) -> None:
        """See Pusher. Raises ValueError if the speed is not positive."""
        if not speed > 0:
            raise ValueError(f"speed must be positive, got {speed}")
        if (mode := self.mode) is not Mode.IDLE:
            raise NotReady(f"the pusher's mode is {mode.value}, expected idle")
        stroke = self._start(position, speed)
        if not self._on(DriverEvent.MOVE):
            raise NotReady(f"where the pusher stands is not known until it is recovered: {self.doubt}")
        self._stroke = stroke

    def stop(self) -> None:
        """See Pusher."""
        with self._left_if_lost():
            self._on(DriverEvent.STOP)

    def poll(self, stamp: int | None = None) -> PusherReport | None:
        """See Pusher."""
        before, self._polled, self._now_stamp = self._polled, clock(), stamp
        self._gap = 0.0 if before is None else self._polled - before
        with self._left_if_lost():
            try:
                self._hear()
                if self._connected:
                    self._awake.check()
                if Phase.STREAMING in self._state and self._gap > self._silence:
                    raise Timeout(f"this process stood still for {self._gap:.2f} s; silence is {self._silence:g} s")
                self._judge()
                while self._script is not None and next(self._script, FINISHED) is FINISHED:
                    self._on(DriverEvent.DONE)
            except NotConnected:
                raise
            except PusherError as error:
                if isinstance(error, Halted | Jumped | LeftTheWay | TooFast | Suspended):
                    self.suspect(str(error))
                if self._connected and STOPPING.isdisjoint(self._state):
                    self.stop()
                    raise
                raise NotConnected(f"{self.name}: {error}") from error
        return self._newest()

    @contextlib.contextmanager
    def _left_if_lost(self) -> Iterator[None]:
        """Leave a line that turns out to be lost."""
        try:
            yield
        except NotConnected:
            self._drop()
            raise

    def _judge(self) -> None:
        """Raise what was heard means for the connection; during a reset, alarms and silence are expected."""
        trouble, self._trouble = self._trouble, None
        # it stops anyway; in the reset, the controller may lose its position
        foreseen = Halted if Phase.BRAKING in self._state else Held | Jumped
        if isinstance(trouble, foreseen) and self._state & STOPPING:
            self.suspect(str(trouble))
            trouble = None
        if not self._connected or self._state & {Phase.RESETTING, Phase.RECOVERING}:
            return
        if trouble is not None:
            raise trouble
        silent = self._silent
        if Phase.STREAMING in self._state and silent > self._silence:
            raise Timeout(f"no report of {self.name} for {silent:.2f} s in mid-stroke; silence is {self._silence:g} s")
        if silent > self._patience:
            raise NotConnected(f"no report of {self.name} for {silent:.1f} s, the limit is {self._patience:g} s")

    @property
    def _in_motion(self) -> bool:
        """Whether it may be moving now or later."""
        rests = self.mode in (Mode.IDLE, Mode.ALARM) and not self.busy
        return self._role is Role.DRIVES and self._connected and not rests

    def _drop(self) -> None:
        """Leave the line; tell a pusher that may be moving to stop, although nobody can wait for it any more."""
        before, in_motion = self._state, self._in_motion
        self._forget()
        self._on(DriverEvent.LOST)
        self._leave(before, in_motion)
