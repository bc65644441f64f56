"""What the actuator node asks of a pusher, whatever protocol it speaks, and what can go wrong with one."""

import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple, Protocol

from pushfric_core.contact import pushing_line
from pushfric_core.errors import PushfricError
from pushfric_core.settings import check_ranges, setting


class PusherError(PushfricError):
    """Base of what can go wrong with a pusher."""


class NotConnected(PusherError):
    """No port, no controller at it, or the connection was lost."""


class NotReady(PusherError):
    """A motion was asked for while another runs, or in alarm."""


class Timeout(PusherError):
    """The controller still reports but did not answer, or did not arrive where it was sent."""


class Mode(Enum):
    """What a pusher is doing; the names are those of PusherState.MODE_*."""

    DISCONNECTED = "disconnected"
    IDLE = "idle"
    HOMING = "homing"
    RUNNING = "running"
    HOLD = "hold"
    ALARM = "alarm"


@dataclass(frozen=True)
class PusherConfig:
    """The pusher and its line on the table."""

    port: str = setting("", "serial port of the GRBL controller")
    baud: int = setting(115200, "[bit/s]", 300, 4_000_000)
    axis: str = setting("X", "axis of the controller, with a minus sign where the stroke runs to negative coordinates")
    home: bool = setting(False, "seek the home switch at activation; otherwise the controller's work zero is stroke position 0")
    line_origin: tuple[float, ...] = setting((0.0, 0.0), "centre of the tip at stroke position 0, in the table frame [m]")
    line_direction: tuple[float, ...] = setting((0.0, 1.0), "of the forward stroke, in the table frame; any length")
    tip_radius: float = setting(0.003, "[m]", 0.0, 0.1)
    stroke: float = setting(0.06, "greatest stroke position [m]", 0.001, 10.0)
    max_speed: float = setting(0.1, "[m/s]", 0.0001, 10.0)
    poll_rate: float = setting(20.0, "reports of the pusher [Hz]", 1.0, 100.0)
    connect_timeout: float = setting(2.0, "how long the controller may take to boot [s]", 0.1, 60.0)
    autostart: bool = setting(True, "configure and activate by itself, as soon as the controller answers")

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.port:
            raise ValueError("port must name the serial port of the GRBL controller, got ''")
        pushing_line(self.line_origin, self.line_direction, self.tip_radius)


class PusherReport(NamedTuple):
    """Where the pusher is."""

    position: float  # along the stroke [m]
    speed: float  # [m/s], negative on the way back
    mode: Mode
    stamp: int | None  # what ask() was given when this report was requested; None for one that came unasked


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

    def connect(self) -> None:
        """Open the port and begin to connect; nothing moves. Raises NotConnected."""

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

    def poll(self) -> PusherReport | None:
        """Read and act; the newest report that came. Raises every PusherError, once, with the pusher told to stop."""
