"""Opens a pusher behind a controller on a serial port: entry points of the group `pushfric.pushers`."""

import os
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from pushfric_core.pushers.pusher import Check, Pusher, PusherConfig
from pushfric_core.pushers.serial_settings import SerialSettings

if TYPE_CHECKING:
    from pushfric_core.pushers.serial_pusher import SerialPusher


class SerialConfig(SerialSettings, ABC):
    """The port of the controller and the axis of the stage, as a driver."""

    firmware: ClassVar[str]

    @abstractmethod
    def driver_class(self) -> "type[SerialPusher]":
        """The driver that speaks the firmware's protocol."""

    def open_pusher(self, config: PusherConfig) -> Pusher:
        """The driver; nothing is opened yet."""
        return self.driver_class()(self, config.home)

    def absence(self) -> str | None:
        """Why there can be no controller; None if there may be one."""
        there = os.path.exists(self.port)
        return None if there else f"no serial port at {self.port}; expected that of a {self.firmware} controller"

    def checks(self, config: PusherConfig, distance: float, speed: float) -> Iterator[Check]:
        """Port, controller and its limits, for the doctor; see PusherDriver."""
        from pushfric_core.pushers.serial_checks import examine

        return examine(self, self.driver_class(), config, distance, speed)


@dataclass(frozen=True)
class GrblConfig(SerialConfig):
    """A controller with GRBL 1.1, grblHAL or FluidNC."""

    firmware = "GRBL"

    def driver_class(self) -> "type[SerialPusher]":
        """See SerialConfig."""
        from pushfric_core.pushers.grbl import Grbl

        return Grbl
