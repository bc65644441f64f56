"""A pusher of your own: a simulated slide without a controller. Its position follows from the time alone.

A package registers `SlideConfig` as an entry point of the group pushfric.pushers, `slide = own_pusher:SlideConfig`; then a
cell's file chooses it with `pusher: {driver: slide, backlash: 0.0002, ...}`. A real driver would talk to its controller here.

python3 examples/own_pusher.py
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass

from pushfric_core.pushers.check import Check, Grade
from pushfric_core.pushers.pusher import Limits, Mode, Pusher, PusherConfig, PusherReport
from pushfric_core.settings import check_ranges, setting


@dataclass(frozen=True)
class SlideConfig:
    """The settings of a slide in a cell's file, in addition to those of every pusher."""

    backlash: float = setting(0.0, "play of the spindle [m]", 0.0, 0.01)

    def __post_init__(self) -> None:
        check_ranges(self)

    def open_pusher(self, config: PusherConfig) -> Pusher:
        """The slide, not connected yet."""
        return Slide(config.max_speed)

    def absence(self) -> str | None:
        """None: a slide needs nothing else."""
        return None

    def checks(self, config: PusherConfig, distance: float, speed: float) -> Iterator[Check]:
        """What ./pushfric doctor says about the slide."""
        level = Grade.OK if self.backlash < distance / 100 else Grade.WARNING
        yield Check("slide", level, f"{1e3 * self.backlash:g} mm of play in pushes of {1e3 * distance:g} mm")


class Slide:
    """Moves at constant speed from where it is to where it is sent."""

    name, place, doubt, dropped = "a slide", "here", None, 0

    def __init__(self, max_speed: float) -> None:
        self.limits = Limits(max_speed=max_speed)
        self._start = self._end = 0.0  # of the last motion [m]
        self._speed, self._began = 1.0, 0.0
        self._connected = False
        self._asked: int | None = None

    @property
    def mode(self) -> Mode:
        if not self._connected:
            return Mode.DISCONNECTED
        return Mode.RUNNING if self.busy else Mode.IDLE

    @property
    def busy(self) -> bool:
        return self._position() != self._end

    def connect(self) -> None:
        self._connected = True

    def close(self) -> None:
        self.stop()
        self._connected = False

    def recover(self) -> None:
        """Do nothing: a slide has no alarms."""

    def move_to(self, position: float, speed: float) -> None:
        self._start, self._end, self._speed, self._began = self._position(), position, speed, time.monotonic()

    def stop(self) -> None:
        self._start = self._end = self._position()

    def ask(self, stamp: int) -> None:
        self._asked = stamp

    def poll(self, stamp: int | None = None) -> PusherReport | None:
        asked, self._asked = self._asked if self._asked is not None else stamp, None
        if asked is None:
            return None
        forward = self._speed if self._end > self._start else -self._speed
        return PusherReport(self._position(), forward if self.busy else 0.0, self.mode, asked)

    def _position(self) -> float:
        way, gone = self._end - self._start, self._speed * (time.monotonic() - self._began)
        return self._end if gone >= abs(way) else self._start + (gone if way > 0 else -gone)


def main() -> None:
    slide = Slide(max_speed=0.1)
    slide.connect()
    slide.move_to(0.05, speed=0.1)
    while slide.busy:
        slide.ask(time.monotonic_ns())
        report = slide.poll()
        assert report is not None
        print(f"{report.mode.value} at {1e3 * report.position:.1f} mm, {1e3 * report.speed:.0f} mm/s")
        time.sleep(0.1)
    print(f"{slide.mode.value} at {1e3 * slide._position():.1f} mm")


if __name__ == "__main__":
    main()
