"""What the actuator node asks of a pusher, whatever protocol it speaks, and what can go wrong with one."""

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple, Protocol

from pushfric_core.contact import pushing_line
from pushfric_core.errors import PushfricError
from pushfric_core.settings import AUTO, REQUIRED, check_ranges, setting
from pushfric_ros.pushers.check import Check


class Fault(Enum):
    """Why a pusher was stopped, or may not move; the values are those of the topic `pusher_fault`."""

    NONE = "none"
    CONNECTION = "connection"  # no controller answers, or the connection was lost
    CONTROLLER = "controller"  # an alarm, or a command was refused
    POSITION = "position"  # where the pusher stands is not known
    WAY = "way"  # it was reported 2 mm off its commanded way
    SPEED = "speed"  # it was faster than commanded
    TIME = "time"  # the controller was silent, or a stroke took too long
    STOPPED = "stopped"  # somebody asked for it
    DISABLED = "disabled"  # `enable` is false, or late
    OWNER = "owner"  # the client that owns the push shows no sign of life
    NODES = "nodes"  # a node that a push needs shows no sign of life
    FORCE = "force"  # more than max_force, or no force is measured


class PusherError(PushfricError):
    """Base of what can go wrong with a pusher."""

    fault = Fault.CONTROLLER


class NotConnected(PusherError):
    """No port, no controller at it, or the connection was lost."""

    fault = Fault.CONNECTION


class NotReady(PusherError):
    """A motion was asked for while another runs, or in alarm."""


class Timeout(PusherError):
    """The controller did not answer in time, or did not arrive where it was sent."""

    fault = Fault.TIME


class LeftTheWay(PusherError):
    """The pusher is reported where it was not sent."""

    fault = Fault.WAY


class TooFast(PusherError):
    """The pusher is reported to be faster than it was sent."""

    fault = Fault.SPEED


class Jumped(PusherError):
    """The pusher is reported where it cannot have gone: what the controller says of its position is no longer true."""

    fault = Fault.POSITION


class Mode(Enum):
    """What a pusher is doing; the names are those of PusherState.MODE_*."""

    DISCONNECTED = "disconnected"
    IDLE = "idle"
    HOMING = "homing"
    RUNNING = "running"
    HOLD = "hold"
    ALARM = "alarm"


@dataclass(frozen=True)
class StageConfig:
    """The linear stage that bears the tip, and its line on the table."""

    line_origin: tuple[float, float] = setting(REQUIRED, "centre of the round tip at stroke position 0, in the table frame [m]")
    line_direction: tuple[float, float] = setting(REQUIRED, "direction of the forward stroke, in the table frame; any length")
    tip_radius: float = setting(REQUIRED, "radius of the tip [m]", 0.0, 0.1)
    stroke: float = setting(REQUIRED, "greatest stroke position [m]", 0.001, 10.0)
    max_speed: float = setting(REQUIRED, "greatest speed [m/s]", 0.0001, 10.0)

    def __post_init__(self) -> None:
        check_ranges(self)
        pushing_line(self.line_origin, self.line_direction, self.tip_radius)


@dataclass(frozen=True)
class PusherConfig(StageConfig):
    """What any pusher needs to be told; its driver brings settings of its own."""

    driver: str = setting("grbl", "what drives the pusher: an entry point of the group pushfric.pushers")
    home: bool = setting(False, "seek the home switch at activation; otherwise the controller's work zero is stroke position 0")
    retract_speed: float = setting(0.05, "of the way back after a push; max_speed where that is less [m/s]", 0.0001, 10.0)
    poll_rate: float = setting(20.0, "reports of the pusher's position [Hz]", 1.0, 100.0)
    owner_timeout: float = setting(
        0.3, "a push is stopped when its client shows no sign of life for so long; 0: it need not show any [s]", 0.0, 60.0
    )
    requires: tuple[str, ...] = setting((), "nodes that must show signs of life during a push, such as tracker and estimator")
    requires_timeout: float = setting(1.0, "for how long these may show none [s]", 0.1, 60.0)
    max_force: float = setting(0.0, "greatest force on the pusher, from the topic wrench; 0: it is not measured [N]", 0.0, 1e6)
    enable_timeout: float = setting(
        0.0, "nothing moves unless the topic enable said true within this time; 0: it is not needed [s]", 0.0, 60.0
    )
    memory: str = setting(
        AUTO, f"folder that keeps where the pusher was for the next process; {AUTO}: of the user; empty: it is not kept"
    )
    autostart: bool = setting(True, "configure and activate by itself, as soon as the controller answers")

    @property
    def stage(self) -> StageConfig:
        """The stage alone."""
        return StageConfig(**{field.name: getattr(self, field.name) for field in dataclasses.fields(StageConfig)})


class PusherReport(NamedTuple):
    """Where the pusher is."""

    position: float  # along the stroke [m]
    speed: float  # [m/s], negative on the way back
    mode: Mode
    stamp: int | None  # what ask() or poll() was given when this report was requested, or came unasked


class Limits(NamedTuple):
    """What the controller is configured to; infinite where it did not say."""

    travel: float = math.inf  # enforced by the controller [m]
    max_speed: float = math.inf  # [m/s]
    acceleration: float = math.inf  # [m/s^2]


class Pusher(Protocol):
    """All that the actuator node asks of a pusher, whatever protocol it speaks."""

    @property
    def mode(self) -> Mode: ...

    @property
    def busy(self) -> bool:
        """Whether a connection, motion, homing or stop is under way."""

    @property
    def limits(self) -> Limits: ...

    @property
    def name(self) -> str:
        """What answered, for people."""

    @property
    def place(self) -> str:
        """What tells it from other pushers: its port."""

    @property
    def doubt(self) -> str | None:
        """Why the position need not be true, as far as this connection can tell; a recovery ends it."""

    @property
    def dropped(self) -> int:
        """How many reports were damaged, or cannot be true."""

    def connect(self) -> None:
        """Open the port and begin to connect; what moves is stopped. Raises NotConnected."""

    def close(self) -> None:
        """Stop a motion, waiting for it [a few seconds at most], and leave the port."""

    def recover(self) -> None:
        """On a person's request: begin to unlock or home, as configured. May move. Raises NotConnected, NotReady."""

    def move_to(self, position: float, speed: float) -> None:
        """Begin a motion to `position` [m] at `speed` [m/s]; done when no longer busy. Raises NotConnected, NotReady."""

    def stop(self) -> None:
        """Begin to stop; done when no longer busy. Raises NotConnected."""

    def ask(self, stamp: int) -> None:
        """Request a report, which will carry `stamp`. Nothing happens while disconnected. Raises NotConnected."""

    def poll(self, stamp: int | None = None) -> PusherReport | None:
        """Read and act; the newest report that came. What it asks for itself will carry `stamp`.

        Raises every PusherError, once, with the pusher told to stop.
        """


class PusherDriver(Protocol):
    """The settings of one kind of pusher, a frozen dataclass of `pushfric_core.settings.setting` fields that opens it.

    The class is an entry point of the group `pushfric.pushers`; its name there is the setting `driver` of PusherConfig. Its
    settings stand next to those of PusherConfig, in a cell's file and as parameters of the actuator: no name may occur twice.
    """

    def open_pusher(self, config: PusherConfig) -> Pusher:
        """The pusher; nothing is connected, let alone moved. Raises ValueError where the settings do not fit together."""

    def absence(self) -> str | None:
        """Why there can be no controller now, such as a port that does not exist; None where there may be one."""

    def checks(self, config: PusherConfig, distance: float, speed: float) -> Iterator[Check]:
        """What the doctor should look at, without moving anything: `distance` [m] and `speed` [m/s] are those of a push."""
