"""Opens a pusher behind a GRBL controller: the entry point `grbl` of the group `pushfric.pushers`."""

import os
from collections.abc import Iterator
from dataclasses import dataclass

from pushfric_core.pushers.check import Check
from pushfric_core.pushers.grbl_settings import GrblSettings
from pushfric_core.pushers.pusher import Pusher, PusherConfig


@dataclass(frozen=True)
class GrblConfig(GrblSettings):
    """The port of the controller and the axis of the stage, as a driver."""

    def open_pusher(self, config: PusherConfig) -> Pusher:
        """The driver; nothing is opened yet."""
        from pushfric_core.pushers.grbl import Grbl

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
        """Why there can be no controller; None if there may be one."""
        return None if os.path.exists(self.port) else f"no serial port at {self.port}; expected that of a GRBL controller"

    def checks(self, config: PusherConfig, distance: float, speed: float) -> Iterator[Check]:
        """Port, controller and its limits, for the doctor; see PusherDriver."""
        from pushfric_core.pushers.grbl_checks import examine

        return examine(self, config, distance, speed)
