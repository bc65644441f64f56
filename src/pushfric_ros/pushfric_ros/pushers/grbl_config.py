"""The settings of a pusher behind a GRBL controller: the entry point `grbl` of the group `pushfric.pushers`."""

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass

from pushfric_core.settings import REQUIRED, check_ranges, setting
from pushfric_ros.pushers.check import Check
from pushfric_ros.pushers.pusher import Pusher, PusherConfig


@dataclass(frozen=True)
class GrblConfig:
    """Where the controller is, and which of its axes the stage is."""

    port: str = setting(REQUIRED, "serial port of the GRBL controller")
    baud: int = setting(115200, "baud rate of the serial port [bit/s]", 300, 4_000_000)
    axis: str = setting("X", "axis of the controller, with a minus sign where the stroke runs to negative coordinates")
    connect_timeout: float = setting(2.0, "how long the controller may take to boot [s]", 0.1, 60.0)
    ahead: float = setting(
        0.25, "motion sent ahead: the pusher goes on for so long, and then brakes, when nothing more is sent [s]", 0.1, 1.0
    )
    silence: float = setting(0.2, "a controller that says nothing for so long while it moves is stopped [s]", 0.05, 60.0)
    real_time_factor: float = setting(1.0, "seconds of a simulated controller in one of real time; 1: a real one", 0.01, 100.0)

    def __post_init__(self) -> None:
        check_ranges(self)
        check_axis(self.axis)
        if not self.port:
            raise ValueError("port must name the serial port of the GRBL controller, got ''")

    def open_pusher(self, config: PusherConfig) -> Pusher:
        """The driver; nothing is opened yet."""
        from pushfric_ros.pushers.grbl import Grbl

        return Grbl(
            self.port,
            self.baud,
            self.axis,
            config.home,
            self.connect_timeout,
            self.ahead,
            self.silence,
            self.real_time_factor,
        )

    def absence(self) -> str | None:
        """Why there can be no controller; None where there may be one."""
        return None if os.path.exists(self.port) else f"no serial port at {self.port}; expected a GRBL controller's"

    def checks(self, config: PusherConfig, distance: float, speed: float) -> Iterator[Check]:
        """Port, controller and its limits, for the doctor; see PusherDriver."""
        from pushfric_ros.pushers.grbl_checks import examine

        return examine(self, config, distance, speed)


def check_axis(axis: str) -> None:
    """Raises ValueError where a controller has no such axis."""
    if re.fullmatch("-?[XYZABC]", axis) is None:
        raise ValueError(f"axis must be X, Y, Z, A, B or C, or one of them with a minus sign, got {axis!r}")
