"""The settings of the drivers of a controller on a serial port."""

import re
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from pushfric_core.pushers.axis_reports import AXES
from pushfric_core.pushers.dialect import Dialect
from pushfric_core.settings import REQUIRED, check_ranges, setting


@dataclass(frozen=True)
class SerialSettings(ABC):
    """The port of the controller and its firmware, the axis of the stage, and how long to wait for what."""

    firmware: ClassVar[str]

    port: str = setting(REQUIRED, "serial port of the controller", names="the serial port of the controller")
    baud: int = setting(115200, "baud rate of the serial port [bit/s]", 300, 4_000_000)
    axis: str = setting("X", "axis of the controller, with a minus sign if the stroke runs towards negative coordinates")
    connect_timeout: float = setting(2.0, "how long the controller may take to boot [s]", 0.1, 60.0)
    ahead: float = setting(
        0.25, "motion sent ahead: if nothing more is sent, the pusher goes on for this long and then brakes [s]", 0.1, 1.0
    )
    silence: float = setting(0.2, "a controller that says nothing for this long while it moves is stopped [s]", 0.05, 60.0)
    real_time_factor: float = setting(
        1.0, "speed of a simulated controller as a multiple of real time; 1: a real controller", 0.01, 100.0
    )

    def __post_init__(self) -> None:
        check_ranges(self)
        if re.fullmatch(f"-?[{AXES}]", self.axis) is None:
            raise ValueError(f"axis must be X, Y, Z, A, B or C, or one of them with a minus sign, got {self.axis!r}")

    @abstractmethod
    def dialect(self) -> Dialect:
        """The firmware's protocol."""
