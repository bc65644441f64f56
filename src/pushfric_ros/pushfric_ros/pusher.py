"""What the actuator node asks of a pusher, whatever protocol it speaks, and what can go wrong with one."""

import math
from enum import Enum
from typing import NamedTuple, Protocol

from pushfric_core.errors import PushfricError


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
        """Open the port and begin to connect. Raises NotConnected."""

    def close(self) -> None:
        """Stop a motion, waiting for it [a few seconds at most], and leave the port."""

    def recover(self) -> None:
        """On a person's request: connect afresh, unlock or home. May move. Raises NotConnected."""

    def move_to(self, position: float, speed: float) -> None:
        """Begin a motion to `position` [m] at `speed` [m/s]; done when no longer busy. Raises NotConnected, NotReady."""

    def stop(self) -> None:
        """Begin to stop; done when no longer busy. Raises NotConnected."""

    def ask(self, stamp: int) -> None:
        """Request a report, which will carry `stamp`. Nothing happens while disconnected. Raises NotConnected."""

    def poll(self) -> PusherReport | None:
        """Read and act; the newest report that came. Raises every PusherError, once, with the pusher told to stop."""
