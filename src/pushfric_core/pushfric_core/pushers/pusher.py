"""The interface of a pusher, whatever protocol it speaks: its settings, errors, and checks for the doctor."""

import dataclasses
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple, Protocol

from pushfric_core.errors import PushfricError
from pushfric_core.geometry.contact import PushingLine
from pushfric_core.settings import AUTO, REQUIRED, check_ranges, setting


class Grade(Enum):
    """How a check came out."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "failed"


class Check(NamedTuple):
    """A check and its finding."""

    name: str
    level: Grade
    finding: str
    advice: str = ""  # what to do; empty if nothing is wrong


POLL_PERIOD = 0.005  # [s]


class PusherFault(Enum):
    """Why a pusher was stopped, or may not move; the values are those of the topic `pusher_fault`."""

    NONE = "none"
    CONNECTION = "connection"  # no controller answers, or the connection was lost
    CONTROLLER = "controller"  # an alarm, or a command was refused
    POSITION = "position"  # where the pusher stands is not known
    WAY = "way"  # it was reported more than 2 mm off its commanded way
    SPEED = "speed"  # it was faster than commanded
    TIME = "time"  # the controller was silent, or a stroke took too long
    STOPPED = "stopped"  # somebody asked for it
    DISABLED = "disabled"  # `enable` is false or late
    OWNER = "owner"  # the client that owns the push shows no sign of life
    NODES = "nodes"  # a node that a push needs shows no sign of life
    FORCE = "force"  # more than max_force, or no force is measured


class PusherError(PushfricError):
    """Base of the errors of a pusher."""

    fault = PusherFault.CONTROLLER


class NotConnected(PusherError):
    """There is no port, no controller answers at it, or the connection was lost."""

    fault = PusherFault.CONNECTION


class NotReady(PusherError):
    """A motion was requested while another runs or the pusher is in alarm."""


class Timeout(PusherError):
    """The controller did not answer in time, or the pusher did not arrive where it was sent."""

    fault = PusherFault.TIME


class LeftTheWay(PusherError):
    """The pusher is reported where it was not sent."""

    fault = PusherFault.WAY


class TooFast(PusherError):
    """The pusher is reported to move faster than it was sent."""

    fault = PusherFault.SPEED


class Suspended(Timeout):
    """The computer was suspended, and the pusher may have gone on meanwhile."""


class Halted(PusherError):
    """The controller stopped by itself: it may have lost steps, and only a person says that it may go on."""


class Held(Halted):
    """An input of the controller, or somebody at it, stopped the pusher or keeps it from moving."""


class Jumped(PusherError):
    """The pusher is reported where it cannot have gone, so the controller's position is no longer true."""

    fault = PusherFault.POSITION


class Mode(Enum):
    """The activity of a pusher; the names are those of PusherState.MODE_*."""

    DISCONNECTED = "disconnected"
    IDLE = "idle"
    HOMING = "homing"
    RUNNING = "running"
    HOLD = "hold"
    ALARM = "alarm"


@dataclass(frozen=True)
class StageConfig:
    """The linear stage that carries the tip, and its line on the table."""

    line_origin: tuple[float, float] = setting(
        REQUIRED, "centre of the round tip at stroke position 0, in the table frame [m]", -10.0, 10.0
    )
    line_direction: tuple[float, float] = setting(REQUIRED, "direction of the forward stroke, in the table frame; any length")
    tip_radius: float = setting(REQUIRED, "radius of the tip [m]", 0.0, 0.1)
    stroke: float = setting(REQUIRED, "greatest stroke position [m]", 0.001, 10.0)
    max_speed: float = setting(REQUIRED, "greatest speed [m/s]", 0.0001, 10.0)

    def __post_init__(self) -> None:
        check_ranges(self)
        dx, dy = self.line_direction
        if not 0 < math.hypot(dx, dy) < math.inf:
            raise ValueError(f"line_direction must have a length, got ({dx:g}, {dy:g})")

    @property
    def line(self) -> PushingLine:
        """That of the tip, along `line_direction`, which may have any length."""
        (dx, dy), length = self.line_direction, math.hypot(*self.line_direction)
        return PushingLine(self.line_origin, (dx / length, dy / length), self.tip_radius)


@dataclass(frozen=True)
class PusherConfig(StageConfig):
    """The settings of any pusher; its driver adds its own."""

    driver: str = setting("grbl", "what drives the pusher: an entry point of the group pushfric.pushers")
    home: bool = setting(False, "seek the home switch at activation; otherwise the controller's work zero is stroke position 0")
    retract_speed: float = setting(0.05, "speed of the way back after a push; at most max_speed [m/s]", 0.0001, 10.0)
    max_distance: float = setting(
        10.0, "greatest distance of a push, in either direction; a longer one is refused [m]", 0.001, 10.0
    )
    max_time: float = setting(600.0, "longest time of a push with its way back; then it is stopped [s]", 0.1, 86400.0)
    poll_rate: float = setting(20.0, "reports of the pusher's position [Hz]", 1.0, 100.0)
    owner_timeout: float = setting(
        0.25, "a push is stopped when its client shows no sign of life for this long; 0: none is needed [s]", 0.0, 60.0
    )
    requires: tuple[str, ...] = setting((), "nodes that must show signs of life during a push, such as tracker and estimator")
    requires_timeout: float = setting(
        1.0, "a push is stopped when one of these shows no sign of life for this long [s]", 0.1, 60.0
    )
    max_force: float = setting(0.0, "greatest force on the pusher, measured on the topic wrench; 0: not checked [N]", 0.0, 1e6)
    enable_timeout: float = setting(
        0.0, "nothing moves unless the topic enable said true within this time; 0: not needed [s]", 0.0, 60.0
    )
    memory: str = setting(
        AUTO, f"folder that keeps where the pusher rested, for the next process; {AUTO}: the user's; empty: nothing is kept"
    )
    autostart: bool = setting(True, "configure and activate without being asked, as soon as the controller answers")

    @property
    def grace(self) -> float:
        """How long an accepted goal waits, at rest, for the first signs of life of its client and of `requires` [s]."""
        return max(self.owner_timeout, self.requires_timeout)

    @property
    def stage(self) -> StageConfig:
        """The stage alone."""
        return StageConfig(**{field.name: getattr(self, field.name) for field in dataclasses.fields(StageConfig)})


class PusherReport(NamedTuple):
    """Where the pusher is."""

    position: float  # along the stroke [m]
    speed: float  # [m/s], negative on the way back
    mode: Mode
    stamp: int | None  # what ask() or poll() was given when this report was requested or came unasked; None: about now


class Limits(NamedTuple):
    """The limits that the controller is configured to; infinite if it did not say."""

    travel: float = math.inf  # enforced by the controller [m]
    max_speed: float = math.inf  # [m/s]
    acceleration: float = math.inf  # [m/s^2]


class Pusher(Protocol):
    """A pusher as the actuator node needs it, whatever protocol it speaks."""

    @property
    def mode(self) -> Mode: ...

    @property
    def busy(self) -> bool:
        """Whether a connection, motion, homing or stop is under way."""

    @property
    def limits(self) -> Limits: ...

    @property
    def name(self) -> str:
        """The name of what answered, for people."""

    @property
    def place(self) -> str:
        """The identity of the pusher, once it is connected: a serial number, or the socket that it is plugged into.

        A path, from the root, means that nothing better is known.
        """

    @property
    def doubt(self) -> str | None:
        """Why the position may be wrong, as far as this connection can tell; None if it is right. A recovery clears it."""

    @property
    def dropped(self) -> int:
        """Number of reports that were damaged or cannot be true."""

    def connect(self) -> None:
        """Open the port and begin to connect; a moving pusher is stopped. Raises NotConnected."""

    def close(self) -> None:
        """Stop a motion, wait for its end (a few seconds at most), and leave the port."""

    def recover(self) -> None:
        """Begin to unlock or to home, as configured; only a person asks for this. May move. Raises NotConnected, NotReady."""

    def move_to(self, position: float, speed: float) -> None:
        """Begin a motion to `position` [m] at `speed` [m/s]; it has ended when not busy. Raises NotConnected, NotReady."""

    def stop(self) -> None:
        """Begin to stop; the pusher rests when not busy. Raises NotConnected."""

    def ask(self, stamp: int) -> None:
        """Request a report, which will carry `stamp`. Nothing happens while disconnected. Raises NotConnected."""

    def poll(self, stamp: int | None = None) -> PusherReport | None:
        """Read and act; return the newest report that came. Reports that it requests itself carry `stamp`.

        Raises each PusherError once, after telling the pusher to stop.
        """


def drive(pusher: Pusher) -> PusherReport | None:
    """Poll a pusher until it is no longer busy; return its last report. Raises PusherError."""
    last = None
    while pusher.busy:
        last = pusher.poll() or last
        time.sleep(POLL_PERIOD)
    return last


class PusherDriver(Protocol):
    """The settings of one kind of pusher, and how to open it: a frozen dataclass of `pushfric_core.settings.setting` fields.

    The class is an entry point of the group `pushfric.pushers`; its name there is the setting `driver` of PusherConfig. Its
    settings stand next to those of PusherConfig, in a cell's file and among the actuator's parameters: no name may occur twice.
    """

    def open_pusher(self, config: PusherConfig) -> Pusher:
        """The pusher, not connected yet. Raises ValueError if the settings do not fit together."""

    def absence(self) -> str | None:
        """Why there can be no controller now, such as a port that does not exist; None if there may be one."""

    def checks(self, config: PusherConfig, distance: float, speed: float) -> Iterator[Check]:
        """The doctor's checks; they move nothing. `distance` [m] and `speed` [m/s] are those of a push."""
