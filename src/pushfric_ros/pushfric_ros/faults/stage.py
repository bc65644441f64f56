"""The stage of faults with any driver: the processes, and the truth as the actuator publishes it."""

import bisect
import contextlib
import os
import pathlib
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

from pushfric_core.bags.samples import stamp_from_msg
from pushfric_core.errors import InvalidInput, PushfricError, blaming
from pushfric_core.pushers.pusher import Limits, Mode, Pusher, PusherConfig, PusherDriver, PusherError, drive
from pushfric_core.pushers.stroke import OFF_WAY
from pushfric_core.settings import plain
from pushfric_msgs.msg import PusherState
from pushfric_ros.faults.fault import EndedEarly, Fault, Otherwise, tried
from pushfric_ros.faults.processes import PROGRAM, end, started, words_of
from pushfric_ros.graph.graph import NodeSpec
from pushfric_ros.graph.supervisor import command
from pushfric_ros.node_kit.person import NoAnswer, Person
from pushfric_ros.node_kit.qos import RELIABLE

REACTION = 0.3
"""Whatever breaks, the pusher may go on for this long before it brakes [s]."""
MID_PUSH = 0.3  # of a push
AT_REST = 0.5  # a pusher that stays at one place for this long rests [s]
BACK = 10.0  # a pusher that has come back is heard where it began within this long [s]
EVENT_TIMEOUT = 180.0  # how long an event may take on a busy machine [s]
LEAST_PUSH = 0.5  # shortest time at full speed in a push [s]
RESET_AGAIN = 2.0  # until a reset that was not enough is repeated [s]


class NotRehearsed(PushfricError):
    """The rehearsal cannot go on."""


@dataclass(frozen=True)
class Rehearsed:
    """The user's choices for a rehearsal."""

    driver: PusherDriver
    name: str  # of the driver's entry point
    stroke: float  # the pusher may move this far forward from where it stands [m]
    speed: float  # of the pushes [m/s]


class Heard(NamedTuple):
    """A report of the pusher."""

    when: float  # [s]
    along: float  # the stroke, from where the rehearsal began [m]
    speed: float  # [m/s]
    moves: bool


class Stage(contextlib.ExitStack):
    """A context manager: on leaving, it ends the processes and stops the pusher. The caller calls `open` and `bring_back`.

    Where the pusher is, the actuator publishes; if it has died, where the pusher rests is what the next actuator finds.
    """

    same = 2e-4
    """Positions that differ by no more are the same [m]; an arm neither arrives nor rests as exactly as a screw."""

    def __init__(self, given: Rehearsed, say: Callable[[str], None]) -> None:
        """Prepare the stage; nothing is opened yet.

        Args:
            given: what the user gives.
            say: called with a line for people about whatever goes wrong on the way.
        """
        super().__init__()
        self.given, self.say = given, say
        self.namespace = f"/rehearsal_{os.getpid()}"
        self.heard: list[Heard] = []
        self.first = 0  # the first report since the stage was ready, its index
        self.states: list[tuple[float, PusherState]] = []  # published, and of when
        self.broken_out: float | None = None  # where the pusher left the stroke, if it did [m]
        self.actuator: subprocess.Popen[str] | None = None
        self.client: subprocess.Popen[str] | None = None
        self.limits = Limits()  # of the controller
        self.position = 0.0  # where the rehearsal began, as the driver counts it [m]
        self._changes: dict[str, Any] = {}  # of the actuator's settings, for one fault
        self._started = 0.0  # the present actuator, when
        self._again = 0.0  # when a service may be called once more

    def open(self) -> None:
        """Open the pusher, and check that it can be rehearsed with.

        Raises:
            NotConnected: the controller does not answer.
            NotRehearsed: the controller is not at rest, unlocked and homed, or stands in the wrong place.
            InvalidInput: the port cannot be opened, or stroke or speed do not fit the controller.
        """
        given = self.given
        self.folder = pathlib.Path(self.enter_context(tempfile.TemporaryDirectory(prefix="pushfric-rehearsal-")))
        self.log = self.folder / "actuator.log"  # the output of the actuators
        self.callback(self._come_to_rest)
        with self.driver(look=True) as pusher:
            if pusher.mode is not Mode.IDLE:
                raise NotRehearsed(f"the controller is {pusher.mode.value}: expected one that rests, unlocked and homed")
            self.limits, self.position = pusher.limits, pusher_position(pusher)
        if self.position < -self.same:
            here = f"the controller stands at {1e3 * self.position:.3f} mm"
            raise NotRehearsed(f"{here}, expected 0 or more: set its work zero, or reverse the axis")
        if given.speed > self.limits.max_speed:
            raise InvalidInput(f"--speed must be at most {1e3 * self.limits.max_speed:g} mm/s, as the controller is set")
        least = self.margin + LEAST_PUSH * given.speed
        if given.stroke < least:
            raise InvalidInput(f"--stroke must be at least {1e3 * least:.0f} mm at this speed, got {1e3 * given.stroke:g} mm")
        self.callback(self._end_processes)
        self.person = self.enter_context(Person(self.namespace))
        self.enter_context(self.person.hearing(PusherState, "pusher_state", RELIABLE, self._on_state))

    def heal(self) -> None:
        """From now on, all between the actuator and the controller works."""

    @property
    def braking(self) -> float:
        """Braking distance [m]."""
        return self.given.speed**2 / (2 * self.limits.acceleration)

    @property
    def margin(self) -> float:
        """The part of the stroke beyond the pushes that is kept free for the distance that a fault may add [m]."""
        return OFF_WAY + REACTION * self.given.speed + self.braking + 1e-3

    @property
    def reach(self) -> float:
        """Length of the pushes [m]."""
        return self.given.stroke - self.margin

    # The truth

    def hear(self, one: Heard) -> None:
        """Take a report of where the pusher is; two in a row beyond the stroke end the rehearsal, as one may be garbled."""
        self.heard.append(one)
        if self.broken_out is None and all(not -self.margin <= two.along <= self.given.stroke for two in self.heard[-2:]):
            self.broken_out = one.along  # whoever waits next ends the rehearsal, which stops the pusher

    def spin(self, seconds: float = 0.005) -> None:
        """Let messages and reports come in for this long [s].

        Raises:
            NotRehearsed: nothing more can be done with the controller.
        """
        self.person.spin(seconds)

    def wait(self, condition: Callable[[], object], what: str, seconds: float = EVENT_TIMEOUT) -> None:
        """Wait until a condition holds.

        Raises:
            NotRehearsed: it does not hold in time, the pusher left its stroke, or the line is broken.
        """
        deadline = time.monotonic() + seconds
        while not condition():
            if self.broken_out is not None:
                raise NotRehearsed(f"the pusher left its stroke at {1e3 * self.broken_out:.1f} mm and was held")
            if time.monotonic() > deadline:
                raise NotRehearsed(f"waited {seconds:g} s in vain for {what}")
            self.spin()

    def pause(self, seconds: float) -> None:
        """Check where the pusher is.

        Raises:
            NotRehearsed: the pusher has left its stroke.
        """
        until = time.monotonic() + seconds
        self.wait(lambda: time.monotonic() > until, "the end of a pause", seconds + EVENT_TIMEOUT)

    def along(self) -> float:
        """Where the pusher is, as last heard, from where the rehearsal began [m]."""
        return self.heard[-1].along

    def at(self, when: float) -> float:
        """Where the pusher was at a time [m], interpolated between two reports."""
        k = bisect.bisect_right(self.heard, when, key=lambda one: one.when)
        before, after = self.heard[max(0, k - 1)], self.heard[min(k, len(self.heard) - 1)]
        share = (when - before.when) / (after.when - before.when) if after is not before else 0.0
        return before.along + share * (after.along - before.along)

    def between(self, begin: float, end: float) -> list[Heard]:
        """The reports within a time, and the last one before it."""
        first, last = (bisect.bisect_right(self.heard, when, key=lambda one: one.when) for when in (begin, end))
        return self.heard[max(0, first - 1) : last]

    def rest(self) -> Heard:
        """Wait until the pusher rests; return where it does, and the rest of the first report from there."""
        since = time.monotonic()
        silence = float(getattr(self.given.driver, "silence", 0.0))

        def rests() -> bool:
            nonlocal since
            dead = self.actuator is not None and self.actuator.poll() is not None
            # one that stood still for less than its driver's silence may go on with its push
            if time.monotonic() - self.heard[-1].when > AT_REST + (0.0 if dead else silence):
                self.witness()
            last = self.heard[-1]
            moved = [one.when for one in reversed(self.heard[-200:]) if abs(one.along - last.along) > self.same or one.moves]
            since = max(since, moved[0]) if moved else since
            return last.when - since > AT_REST

        self.wait(rests, "the pusher to rest")
        last = self.heard[-1].along
        first = len(self.heard)
        while first and abs(self.heard[first - 1].along - last) <= self.same:
            first -= 1
        return self.heard[first]._replace(along=last)

    def seconds_until(self, at_rest: Heard, begin: float) -> float | None:
        """The time from a moment until the pusher rested [s]; None if nobody saw it come to rest."""
        if at_rest.when <= begin:
            return 0.0
        before = self.between(begin, at_rest.when)[-2:][0]
        return at_rest.when - begin if at_rest.when - before.when < AT_REST else None

    def witness(self) -> None:
        """Have an actuator that says where the pusher is: a new one, if the last one has died."""
        if self.actuator is None or self.actuator.poll() is not None:
            self.start_actuator()
        else:
            self.actuator.send_signal(signal.SIGCONT)

    # The host

    @contextlib.contextmanager
    def driver(self, look: bool = False) -> Iterator[Pusher]:
        """The driver alone, in this process, connected; to `look` only, if it can."""
        with contextlib.closing(self._pusher(look)) as pusher:
            pusher.connect()
            drive(pusher)
            yield pusher

    def _pusher(self, look: bool) -> Pusher:
        config, driver = self.config()
        return driver.open_pusher(config)

    def config(self) -> tuple[PusherConfig, PusherDriver]:
        """The settings of the actuator: those of any cell, except for the place."""
        stroke, fastest = self.position + self.given.stroke, min(self.limits.max_speed, 10.0)
        config = PusherConfig((0.0, 0.0), (0.0, 1.0), 0.003, stroke, fastest, driver=self.given.name)
        return replace(config, memory=str(self.folder / "memory"), **self._changes), self.given.driver

    def start_actuator(self, **changes: Any) -> None:
        """Start an actuator, with other settings until the pusher is brought back."""
        self.end_actuator()
        self._changes = changes
        config, driver = self.config()
        spec = NodeSpec("actuator", {**plain(config), **plain(driver)})
        self.states.clear()
        self._started = time.monotonic()
        with open(self.log, "a") as log:
            self.actuator = started(command(spec, self.namespace, self.folder), self.folder, log)

    def end_actuator(self) -> None:
        end(self.actuator)
        self.actuator = None

    @contextlib.contextmanager
    def set_up(self) -> Iterator[Self]:
        """The stage, made `ready` for a fault."""
        self.ready()
        self.first = len(self.heard)
        with blaming("", NoAnswer, error=Otherwise):
            yield self

    def ready(self) -> None:
        """Have an actuator that accepts pushes, and the pusher where the rehearsal began.

        Raises:
            NotRehearsed: the actuator does not become ready.
            EndedEarly: the pusher could not be brought back.
        """
        self.heal()
        end(self.client)
        self.client = None
        if self._changes:
            self.end_actuator()
        self.witness()
        self.make_ready()
        if abs(self.along()) > self.same:
            with blaming("the pusher could not be brought back", NoAnswer, error=EndedEarly):
                self.person.jog(-self.along(), min(5 * self.given.speed, self.limits.max_speed))
            until = time.monotonic() + BACK
            self.wait(lambda: abs(self.along()) <= self.same or time.monotonic() > until, "the pusher to be back")
            if abs(self.along()) > self.same:
                last = f"it was heard at {1e3 * self.along():.2f} mm {time.monotonic() - self.heard[-1].when:.1f} s ago"
                raise EndedEarly(f"the pusher could not be brought back: {last}")
        self.make_ready()

    def make_ready(self) -> None:
        """Do what a person does about an actuator that waits for one: reset it, see what follows, and reset it again.

        Raises:
            NotRehearsed: the actuator does not become ready.
        """

        def idle() -> bool:
            waits = self.mode() in (PusherState.MODE_ALARM, PusherState.MODE_HOLD)
            if waits and self.insist("actuator/reset"):
                self.states.clear()
            return self.mode() == PusherState.MODE_IDLE

        try:
            self.wait(idle, "the actuator to be ready")
        except NotRehearsed as error:
            last = (self.log.read_text(errors="replace").strip().splitlines() or ["nothing"])[-1]
            raise NotRehearsed(f"{error}; it said last: {last}") from error

    def insist(self, service: str) -> bool:
        """Call a service as a person does who sees that once was not enough; whether it was called now."""
        if time.monotonic() < self._again:
            return False
        with contextlib.suppress(NoAnswer):
            self.person.call(service)
        self._again = time.monotonic() + RESET_AGAIN
        return True

    def under_way(self, share: float = MID_PUSH) -> None:
        """Have another process, which owns it, push over the whole reach; wait until this share of it is covered.

        Raises:
            EndedEarly: the push ended before.
            NotRehearsed: the push does not begin, or the pusher left its stroke.
        """
        way = ("--namespace", self.namespace, "--speed", f"{self.given.speed}", f"{self.reach}")
        self.client = client = started((*PROGRAM, "jog", *way), self.folder)
        self.wait(lambda: self.along() > share * self.reach or client.poll() is not None, "the push")
        if client.poll() is not None:
            raise EndedEarly(f"the push ended before the fault: {words_of(client)}")

    def client_ends(self) -> "subprocess.Popen[str]":
        """Wait until the client of the push has ended; return it."""
        assert self.client is not None
        client = self.client
        self.wait(lambda: client.poll() is not None, "the end of the push")
        return client

    def mode(self) -> int | None:
        """The mode that the present actuator published last; None if it has published none."""
        return self.states[-1][1].mode if self.states and self.states[-1][0] > self._started else None

    def _on_state(self, state: PusherState) -> None:
        """Keep a state with the time of its stamp, whenever it comes."""
        ago = time.time() - 1e-9 * stamp_from_msg(state.header.stamp)
        self.states.append((time.monotonic() - ago, state))
        self._witnessed(*self.states[-1])

    def _witnessed(self, when: float, state: PusherState) -> None:
        known = state.mode != PusherState.MODE_DISCONNECTED
        if known and not (self.heard and when <= self.heard[-1].when):  # what is published again is no news
            moves = state.mode in (PusherState.MODE_RUNNING, PusherState.MODE_HOMING)
            self.hear(Heard(when, state.position - self.position, abs(state.speed), moves))

    def _end_processes(self) -> None:
        end(self.client)
        end(self.actuator)

    def _come_to_rest(self) -> None:
        """Stop the pusher whatever it does: a new connection holds the motion and discards what is queued."""
        self.heal()
        try:
            with self.driver() as pusher:
                pusher.stop()
                drive(pusher)
        except PusherError as error:
            self.say(f"the controller may not rest: {error}")

    def bring_back(self) -> list[str]:
        """Leave everything as it was; return what could not be restored.

        Raises:
            NotRehearsed: as `ready` does, or it was tried as often as a fault is.
        """
        back = tried(Fault("the way back", lambda stage: None, lambda stage, begin, found: None), self.set_up)
        if back.problem is not None:
            raise NotRehearsed(back.problem)
        self._end_processes()
        return []


def pusher_position(pusher: Pusher) -> float:
    """Stroke position of a connected driver [m].

    Raises:
        NotRehearsed: the controller reports no position.
    """
    pusher.ask(0)
    deadline = time.monotonic() + EVENT_TIMEOUT
    while (report := pusher.poll()) is None:
        if time.monotonic() > deadline:
            raise NotRehearsed("the controller reports no position")
        time.sleep(0.003)
    return report.position
