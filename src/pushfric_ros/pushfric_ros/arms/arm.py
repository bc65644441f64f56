"""The common part of all drivers of arms: the tip's pose says where it is, and velocities steer it along the pushing line.

An arm is not a stage: it can leave the line. So each command corrects what the last pose shows, and a tip that is more than
2 mm off its way is stopped. The driver never commands more than the next instant of motion; if the driver dies, the dead-man of
whatever takes the commands ends it.
"""

import math
import os
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from time import sleep
from typing import Any, NamedTuple, Protocol

import numpy as np

from pushfric_core.cell.mount import MountConfig
from pushfric_core.errors import InvalidInput
from pushfric_core.geometry.contact import pushing_line
from pushfric_core.geometry.planar import Array, Pose, left_of, rotation, transform
from pushfric_core.plugins import SOURCES, plugin
from pushfric_core.pushers.check import Check, Grade
from pushfric_core.pushers.clock import Wakefulness, clock
from pushfric_core.pushers.pusher import (
    POLL_PERIOD,
    LeftTheWay,
    Limits,
    Mode,
    NotConnected,
    NotReady,
    Pusher,
    PusherConfig,
    PusherError,
    PusherReport,
    Suspended,
    Timeout,
    TooFast,
    drive,
)
from pushfric_core.pushers.stroke import OFF_WAY, Stroke
from pushfric_core.settings import fields_of, setting
from pushfric_ros.adapters.body import Body, Source
from pushfric_ros.adapters.pose_stamped import PoseStampedConfig
from pushfric_ros.adapters.transforms import TransformsConfig
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
        return kind(**{field.name: getattr(self, field.name) for field in fields_of(kind)}).open_source()

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


class Arm:
    """A Pusher: the tip of an arm, on a node of its own, which only lives while it is polled."""

    dropped = 0

    def __init__(self, config: ArmConfig, stage: PusherConfig, open_command: Callable[[Any], Command]) -> None:
        """Nothing is opened yet.

        Args:
            config: of the arm.
            stage: the pushing line.
            open_command: given the node, what moves the arm.
        """
        self.name = self.place = f"/{config.reference}/{config.frame}"
        self.doubt: str | None = None
        self.limits = Limits(max_speed=stage.max_speed, acceleration=config.acceleration)
        line, table = pushing_line(stage.line_origin, stage.line_direction, stage.tip_radius), Pose(*config.table)
        along = rotation(table.theta) @ line.direction
        self._axes = np.array(((*along, 0.0), (*left_of(along), 0.0), (0.0, 0.0, 1.0)))
        self._origin = np.array((*transform(table, line.origin), 0.0))
        self._config, self._open_command = config, open_command
        self._visit: Visit[Any] | None = None
        self._seen: deque[Seen] = deque()  # within WINDOW
        self._ahead: deque[float] = deque(maxlen=LATENCIES)  # the clock of the poses is ahead of this one, by each pose [s]
        self._connecting = False
        self._stroke: Stroke | None = None
        self._began = self._height = self._pace = 0.0  # of the stroke: when [s], how high [m], how fast by now [m/s]
        self._stopping = False
        self._asked = self._fresh = False  # a report is wanted; there is a pose that was not reported
        self._polled = self._heard = self._sent = self._since = 0.0  # [s]
        self._awake = Wakefulness()

    # What the actuator asks

    @property
    def busy(self) -> bool:
        return self._connecting or self._stroke is not None or self._stopping

    @property
    def mode(self) -> Mode:
        if self._connecting or not self._seen:
            return Mode.DISCONNECTED
        return Mode.RUNNING if self.busy or self._moves else Mode.IDLE

    @property
    def beside(self) -> float:
        """How far the tip is off the pushing line, sideways [m]."""
        return abs(float(self._seen[-1].place[1]))

    def connect(self) -> None:
        if self._visit is None:
            self._visit = visit(f"pushfric_arm_{id(self):x}")
            node, source = self._visit.node, self._config.open_source()
            self._command = self._open_command(node)
            self.place = f"{self.name}{self._command.topic}@{os.environ.get('ROS_DOMAIN_ID', 0)}"
            self._take = taken(node, source)
        self._drain()  # what waited is old
        self._drop()
        self._ahead.clear()
        self._connecting, self.doubt = True, None
        self._polled = self._heard = self._since = clock()
        self._awake = Wakefulness()

    def close(self) -> None:
        if self._visit is None:
            return
        self.stop()
        until = clock() + CONNECT
        while self._stopping and clock() < until:
            try:
                self.poll()
            except PusherError:
                break  # the arm's own dead-man ends the motion
            sleep(POLL_PERIOD)
        self._drop()
        self._visit.close()
        self._visit = None

    def recover(self) -> None:
        """An arm that rests on its line is where its pose says; a person has looked."""
        self._check_ready()
        self.doubt = None

    def move_to(self, position: float, speed: float) -> None:
        self._check_ready()
        if self.doubt is not None:
            raise NotReady(f"the arm may not move: {self.doubt}")
        here = self._seen[-1].place
        self._stroke = Stroke(float(here[0]), position, min(speed, self.limits.max_speed), self.limits.acceleration, DEAD_MAN)
        self._began = self._polled = clock()
        self._height, self._pace = float(here[2]), 0.0

    def stop(self) -> None:
        if self._seen and (self._stroke is not None or self._moves):
            self._stroke, self._stopping = None, True
            self._send(np.zeros(3))

    def ask(self, stamp: int) -> None:
        self._asked = True

    def poll(self, stamp: int | None = None) -> PusherReport | None:
        """See Pusher. A report carries the stamp of the pose, not the one given: that is when the tip was there."""
        now, before = clock(), self._polled
        self._polled = now
        try:
            self._judge(now, now - before, came=self._hear(now))
        except NotConnected:
            self._drop()
            raise
        except PusherError as error:
            if isinstance(error, LeftTheWay | TooFast | Suspended):
                self.doubt = str(error)
            self.stop()
            raise
        self._steer(now)
        if not (self._asked and self._fresh) or self._connecting:
            return None
        self._asked = self._fresh = False
        speed = self._speed if self._moves else 0.0
        return PusherReport(float(self._seen[-1].place[0]), speed, self.mode, self._seen[-1].stamp)

    # Where the tip is

    def _hear(self, now: float) -> bool:
        """Take all poses that have come; whether there was a newer one."""
        came = False
        for body in self._drain():
            self._ahead.append(1e-9 * body.stamp - now)
            stamp = self._config.stamp(body)
            if self._seen and stamp <= self._seen[-1].stamp:
                continue
            self._seen.append(Seen(stamp, self._axes @ (self._config.place(body) - self._origin)))
            came = True
        while len(self._seen) > 2 and self._seen[-1].stamp - self._seen[1].stamp > 1e9 * WINDOW:
            self._seen.popleft()
        if came:
            self._heard, self._fresh = now, True
        return came

    def _drain(self) -> list[Body]:
        """Raises PusherError if what came cannot be a pose."""
        try:
            return list(self._take())
        except ValueError as error:
            raise NotConnected(f"no pose of the arm: {error}") from error

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

    def _check_ready(self) -> None:
        """Raises NotReady unless the tip rests on its line."""
        if self.mode is not Mode.IDLE:
            raise NotReady(f"the arm is {self.mode.value}, expected idle")
        if self.beside > OFF_WAY:
            raise NotReady(f"the tip is {1e3 * self.beside:.1f} mm beside its line, expected 2 mm at most")

    def _judge(self, now: float, gap: float, came: bool) -> None:
        """Raise what is wrong."""
        if self._connecting:
            lacks = self._command.lacks or ("" if self._seen and self._lasted >= WINDOW else f"no pose of {self.name}")
            if not lacks:
                self._connecting, self._asked = False, True
                if self._moves:
                    self.doubt = "the arm moved when it was found"
            elif now - self._since > CONNECT:
                raise NotConnected(f"{lacks}; expected within {CONNECT:g} s")
            return
        if gap > self._config.silence:
            self._heard = now  # what was sent meanwhile is still on its way
        self._awake.check()
        if self._stroke is not None and gap > self._config.silence:
            raise Timeout(f"this process stood still for {gap:.2f} s")
        if (unseen := now - self._heard) > (self._config.silence if self._stroke else max(self._config.silence, UNSEEN)):
            said = f"no pose of {self.name} for {unseen:.2f} s"
            raise Timeout(said) if self._stroke else NotConnected(said)
        if self._stroke is None:
            return
        self._stroke.check_time(now - self._began)
        if came:
            along, aside, up = self._seen[-1].place
            if (off := math.hypot(aside, up - self._height)) > OFF_WAY:
                raise LeftTheWay(f"the tip is {1e3 * off:.1f} mm beside its line")
            while self._stroke.next_piece(along) is not None:
                pass
            self._stroke.check(along, self._speed)

    # How it moves

    def _steer(self, now: float) -> None:
        """Send the next command, if it is due: one for each pose, so that an arm which stood still has nothing to catch up."""
        if not (self._stroke or self._stopping) or now - self._sent < 1 / self._config.rate or self._heard < self._sent:
            return
        velocity = np.zeros(3) if self._stroke is None else self._velocity(self._stroke, now)
        if self._stroke is None and not self._moves:
            self._stopping, self._asked = False, True
        self._send(velocity)

    def _velocity(self, stroke: Stroke, now: float) -> Array:
        """(3,) along the stroke, to its left, and up [m/s]; 0 if the tip has arrived."""
        along, aside, up = self._seen[-1].place
        left = stroke.target - along
        if abs(left) < ARRIVED:
            self._stroke, self._stopping = None, True
            return np.zeros(3)
        since = now - self._sent
        gained = self.limits.acceleration * min(since, 2 / self._config.rate)
        before = self._pace if since < DEAD_MAN else 0.0  # it has stopped meanwhile
        self._pace = min(stroke.speed, GAIN * abs(left), math.sqrt(2 * self.limits.acceleration * abs(left)), before + gained)
        most = MOST_ASIDE * stroke.speed
        across = np.clip((-GAIN * aside, GAIN * (self._height - up)), -most, most)
        return np.array((math.copysign(self._pace, left), *across))

    def _send(self, velocity: Array) -> None:
        self._sent = clock()
        self._command.send(self._axes.T @ velocity, round(1e9 * (self._sent + max(self._ahead))))

    def _drop(self) -> None:
        """The arm is no longer seen: a last word, then its own dead-man."""
        if self._seen and self._stroke is not None:
            self._send(np.zeros(3))
        self._seen.clear()
        self._stroke, self._stopping, self._connecting, self._fresh = None, False, False, False
