"""Opens a pusher behind a controller on a serial port: entry points of the group `pushfric.pushers`."""

import os
from collections.abc import Iterator
from dataclasses import dataclass

from pushfric_core.pushers.dialect import Dialect
from pushfric_core.pushers.pusher import Check, Pusher, PusherConfig
from pushfric_core.pushers.serial_settings import SerialSettings


class SerialConfig(SerialSettings):
    """The port of the controller and the axis of the stage, as a driver."""

    def open_pusher(self, config: PusherConfig) -> Pusher:
        """The driver; nothing is opened yet."""
        from pushfric_core.pushers.serial_pusher import SerialPusher

        return SerialPusher(self, config.home)

    def absence(self) -> str | None:
        """Why there can be no controller; None if there may be one."""
        there = os.path.exists(self.port)
        return None if there else f"no serial port at {self.port}; expected that of a {self.firmware} controller"

    def checks(self, config: PusherConfig, distance: float, speed: float) -> Iterator[Check]:
        """Port, controller and its limits, for the doctor; see PusherDriver."""
        from pushfric_core.pushers.serial_checks import examine

        return examine(self, config, distance, speed)


@dataclass(frozen=True)
class GrblConfig(SerialConfig):
    """A controller with GRBL 1.1, grblHAL or FluidNC."""

    firmware = "GRBL"

    def dialect(self) -> Dialect:
        """See SerialConfig."""
        from pushfric_core.pushers.grbl import Grbl

        return Grbl()
