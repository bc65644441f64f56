"""The common part of all drivers of arms: the tip's pose says where it is, and velocities steer it along the pushing line.

An arm is not a stage: it can leave the line. So each command corrects what the last pose shows, and a tip that is more than
2 mm off its way is stopped. The driver never commands more than the next instant of motion; if the driver dies, the dead-man of
whatever takes the commands ends it.
"""

import dataclasses
import math
import os
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from pushfric_core.cell.mount import MountConfig
from pushfric_core.errors import InvalidInput, blaming
from pushfric_core.geometry.planar import Array, Pose, left_of, rotation, transform
from pushfric_core.plugins import SOURCES, plugin
from pushfric_core.pushers.clock import clock
from pushfric_core.pushers.driver import Driver, Phase, Script
from pushfric_core.pushers.pusher import (
    Check,
    Grade,
    LeftTheWay,
    Limits,
    Mode,
    NotConnected,
    NotReady,
    Pusher,
    PusherConfig,
    PusherError,
    PusherReport,
    drive,
)
from pushfric_core.pushers.states import State
from pushfric_core.pushers.stroke import OFF_WAY, Stroke
from pushfric_core.settings import setting
from pushfric_ros.adapters.body import Body, PoseStampedConfig, Source, TransformsConfig
from pushfric_ros.messages.types import message_class
from pushfric_ros.node_kit.bodies import taken
from pushfric_ros.node_kit.visit import Visit, visit

CONNECT = 5.0  # the first pose, and whoever takes the commands, may take this long [s]
UNSEEN = 1.0  # an arm that rests or stops is lost if it shows no pose for this long [s]
DEAD_MAN = 0.25  # the arm must stop this long after the last command [s]
WINDOW = 0.1  # speeds are measured over this long [s]
STILL = 5e-4  # a tip that is slower than this rests [m/s]
GAIN = 4.0  # speed for each metre that the tip is off, or has left to go [1/s]
ARRIVED = 5e-5  # [m]
LATENCIES = 100  # the pose of so many that came soonest after its stamp says what time it is for the arm
WILD = 1.0  # a pose whose stamp leaps by so much is left out [s]
MOST_ASIDE = 0.25  # share of a stroke's speed that may go into corrections


@dataclass(frozen=True)
class ArmConfig(TransformsConfig, PoseStampedConfig, MountConfig, ABC):
    """Where the tip of an arm is found, as in the section `tip` of a cell's file, and how it is moved."""

    source: str = setting("transforms", "what shows the arm's last link: transforms (/tf) or pose_stamped (a topic)")
    acceleration: float = setting(0.2, "of the tip [m/s^2]", 0.01, 10.0)
    rate: float = setting(50.0, "number of commands in a second [Hz]", 10.0, 500.0)
    silence: float = setting(0.2, "the tip stops if no pose came, or this process stood still, for so long [s]", 0.05, 60.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.source not in (known := ("transforms", "pose_stamped")):
            raise ValueError(f"source must be one of {', '.join(known)}, got {self.source!r}")

    def open_source(self) -> Source:
        """The source of the last link's poses."""
        kind = plugin(SOURCES, self.source)
        return kind(**{field.name: getattr(self, field.name) for field in dataclasses.fields(kind)}).open_source()

    @abstractmethod
    def open_command(self, node: Any) -> "Command":
        """How a node tells the arm to move."""

    def open_pusher(self, config: PusherConfig) -> Pusher:
        """The driver, not connected yet."""
        if config.home:
            raise ValueError("home must be false: an arm knows where it stands, got True")
        return Arm(self, config, self.open_command)

    def absence(self) -> str | None:
        """Why there can be no arm: a type of message is not installed."""
        try:
            for type_name, _ in self.open_source().topics.values():
                message_class(type_name)
        except InvalidInput as error:
            return str(error)
        return None

    def checks(self, config: PusherConfig, distance: float, speed: float) -> Iterator[Check]:
        """The doctor's findings on the arm; nothing is commanded."""
        with closing(Arm(self, config, self.open_command)) as arm:
            try:
                arm.connect()
                drive(arm)
            except PusherError as error:
                yield Check("arm", Grade.FAILED, str(error), "start the arm's driver and its controller: docs/safety.md")
                return
            aside = arm.beside > OFF_WAY
            found = f"the tip is {1e3 * arm.beside:.1f} mm beside its line"
            yield Check("arm", Grade.WARNING if aside else Grade.OK, found, "bring it there" if aside else "")
        stops = f"the arm's own controller must stop it {DEAD_MAN:g} s after the last command"
        yield Check("dead-man", Grade.OK, f"{stops}; only ./pushfric rehearse shows whether it does")


class Command(Protocol):
    """How an arm is told to move."""

    topic: str

    @property
    def lacks(self) -> str | None:
        """The part that is missing before the arm can be told anything; None: nothing is missing."""

    def send(self, velocity: Array, stamp: int) -> None:
        """Move the tip until the next command, without turning it; rest, if the velocity is 0.

        Args:
            velocity: (3,) in the reference frame [m/s].
            stamp: of the moment, by the clock of the poses [ns].
        """


class Seen(NamedTuple):
    """Where the tip was."""

    stamp: int  # [ns]
    place: Array  # (3,): along the stroke, to its left, and up [m]


class Arm(Driver):
    """A Pusher: the tip of an arm, on a node of its own, which only lives while it is polled."""

    def __init__(self, config: ArmConfig, stage: PusherConfig, open_command: Callable[[Any], Command]) -> None:
        """Nothing is opened yet.

        Args:
            config: of the arm.
            stage: the pushing line.
            open_command: given the node, what moves the arm.
        """
        self._max_speed = stage.max_speed
        line, table = stage.line, Pose(*config.table)
        along = rotation(table.theta) @ line.direction
        self._axes = np.array(((*along, 0.0), (*left_of(along), 0.0), (0.0, 0.0, 1.0)))
        self._origin = np.array((*transform(table, line.origin), 0.0))
        self._config, self._open_command = config, open_command
        self._visit: Visit[Any] | None = None
        super().__init__(config.silence, max(config.silence, UNSEEN))

    def _forget(self) -> None:
        super()._forget()
        self._seen: deque[Seen] = deque()  # within WINDOW
        self._asked = self._fresh = False  # a report is wanted; there is a pose that was not reported
        self._heard, self._sent = clock(), 0.0  # [s]

    # What the actuator asks

    @property
    def name(self) -> str:
        return f"/{self._config.reference}/{self._config.frame}"

    @property
    def place(self) -> str:
        return f"{self.name}{self._command.topic}@{os.environ.get('ROS_DOMAIN_ID', 0)}"

    @property
    def dropped(self) -> int:
        return 0

    @property
    def limits(self) -> Limits:
        return Limits(max_speed=self._max_speed, acceleration=self._config.acceleration)

    @property
    def _reported(self) -> Mode:
        if not self._seen:
            return Mode.DISCONNECTED
        return Mode.RUNNING if self._moves else Mode.IDLE

    @property
    def beside(self) -> float:
        """How far the tip is off the pushing line, sideways [m]."""
        return abs(float(self._seen[-1].place[1]))

    def close(self) -> None:
        super().close()
        if self._visit is not None:
            self._visit.close()
            self._visit = None

    def recover(self) -> None:
        """An arm that rests on its line is where its pose says; a person has looked."""
        self._check_line()
        super().recover()

    def ask(self, stamp: int) -> None:
        self._asked = True

    def _open(self) -> None:
        if self._visit is None:
            self._visit = visit(f"pushfric_arm_{id(self):x}")
            node, source = self._visit.node, self._config.open_source()
            self._command = self._open_command(node)
            self._take = taken(node, source)
        self._drain()  # what waited is old
        self._ahead: deque[float] = deque(maxlen=LATENCIES)  # the clock of the poses is ahead of this one, by each pose [s]

    def _leave(self, before: State, in_motion: bool) -> None:
        if before & {Phase.STREAMING, Phase.BRAKING}:
            self._send(np.zeros(3))  # a last word, then its own dead-man

    def _start(self, position: float, speed: float) -> Stroke:
        """Raises NotReady if the tip is beside its line."""
        self._check_line()
        here = float(self._seen[-1].place[0])
        return Stroke(here, position, min(speed, self._max_speed), self._config.acceleration, DEAD_MAN)

    # Where the tip is

    def _hear(self) -> None:
        """Take all poses that have come."""
        now = clock()
        if self._gap > self._silence:
            self._heard = now  # what was sent meanwhile is still on its way
        for body in self._drain():
            ahead, stamp = 1e-9 * body.stamp - now, self._config.stamp(body)
            wild = self._ahead and abs(ahead - self._ahead[-1]) > WILD
            if wild or (self._seen and stamp <= self._seen[-1].stamp):
                continue
            self._ahead.append(ahead)
            self._seen.append(Seen(stamp, self._axes @ (self._config.place(body) - self._origin)))
            self._heard, self._fresh = now, True
        while len(self._seen) > 2 and self._seen[-1].stamp - self._seen[1].stamp > 1e9 * WINDOW:
            self._seen.popleft()

    def _drain(self) -> list[Body]:
        """Raises PusherError if what came cannot be a pose."""
        with blaming("no pose of the arm", error=NotConnected):
            return list(self._take())

    def _newest(self) -> PusherReport | None:
        """See Driver. It carries the stamp of the pose, not the one given: that is when the tip was there."""
        if not (self._asked and self._fresh and self._connected):
            return None
        self._asked = self._fresh = False
        speed = self._speed if self._moves else 0.0
        return PusherReport(float(self._seen[-1].place[0]), speed, self.mode, self._seen[-1].stamp)

    @property
    def _silent(self) -> float:
        return clock() - self._heard

    @property
    def _lasted(self) -> float:
        """Time between the first and the last pose that are kept [s]."""
        return 1e-9 * (self._seen[-1].stamp - self._seen[0].stamp)

    @property
    def _speed(self) -> float:
        """Along the stroke [m/s]."""
        return float(self._seen[-1].place[0] - self._seen[0].place[0]) / self._lasted if self._lasted else 0.0

    @property
    def _moves(self) -> bool:
        return float(np.linalg.norm(self._seen[-1].place - self._seen[0].place)) > STILL * self._lasted

    def _check_line(self) -> None:
        """Raises NotReady unless the tip rests on its line."""
        if self._seen and self.beside > OFF_WAY:
            raise NotReady(f"the tip is {1e3 * self.beside:.1f} mm beside its line, expected 2 mm at most")

    # How it moves

    def hold(self, homing: bool = False) -> None:
        if self._stroke is not None or self._moves:
            self._send(np.zeros(3))

    def _scripts(self) -> Mapping[Phase, Callable[[], Script]]:
        return {Phase.CONNECTING: self._connecting, Phase.STREAMING: self._streaming, Phase.BRAKING: self._braking}

    def _connecting(self) -> Script:
        began = clock()
        while lacks := self._command.lacks or ("" if self._seen and self._lasted >= WINDOW else f"no pose of {self.name}"):
            if clock() - began > CONNECT:
                raise NotConnected(f"{lacks}; expected within {CONNECT:g} s")
            yield
        self._asked = True
        if self._moves:
            self.suspect("the arm moved when it was found")

    def _streaming(self) -> Script:
        """Send a command for each pose, so that an arm which stood still has nothing to catch up."""
        assert self._stroke is not None
        stroke, acceleration, height = self._stroke, self._config.acceleration, self._seen[-1].place[2]
        began, judged, pace = clock(), self._heard, 0.0
        while True:
            now, (along, aside, up) = clock(), self._seen[-1].place
            stroke.check_time(now - began)
            if self._heard > judged:
                judged = self._heard
                if (off := math.hypot(aside, up - height)) > OFF_WAY:
                    raise LeftTheWay(f"the tip is {1e3 * off:.1f} mm beside its line")
                while stroke.next_piece(along) is not None:
                    pass
                stroke.check(along, self._speed)
            if self._is_due:
                if lacks := self._command.lacks:
                    raise NotConnected(lacks)
                left = stroke.target - along
                if abs(left) < ARRIVED:
                    break
                since = now - self._sent
                gained = acceleration * min(since, 2 / self._config.rate)
                before = pace if since < DEAD_MAN else 0.0  # it has stopped meanwhile
                pace = min(stroke.speed, GAIN * abs(left), math.sqrt(2 * acceleration * abs(left)), before + gained)
                most = MOST_ASIDE * stroke.speed
                across = np.clip((-GAIN * aside, GAIN * (height - up)), -most, most)
                self._send(np.array((math.copysign(pace, left), *across)))
            yield
        yield from self._braking()

    def _braking(self) -> Script:
        """Send 0 for each pose until the arm rests."""
        while True:
            if self._is_due:
                self._send(np.zeros(3))
                if not self._moves:
                    self._asked = True
                    return
            yield

    @property
    def _is_due(self) -> bool:
        """Whether the next command is due: at most one for each pose."""
        return clock() - self._sent >= 1 / self._config.rate and self._heard >= self._sent

    def _send(self, velocity: Array) -> None:
        self._sent = clock()
        self._command.send(self._axes.T @ velocity, round(1e9 * (self._sent + max(self._ahead))))
