"""A pusher of your own: a slide, simulated by a process of its own, and its driver.

A package registers `SlideConfig` as an entry point of the group pushfric.pushers, `slide = own_pusher:SlideConfig`; then a
cell's file chooses it with `pusher: {driver: slide, device: /tmp/slide, ...}`. The contract of docs/hardware.md is kept; see

python3 examples/own_pusher.py                  # moves the slide by 50 mm
python3 examples/own_pusher.py /tmp/slide       # is the slide, until Ctrl-C, for
pushfric rehearse --driver slide --set device=/tmp/slide --stroke 0.06
"""

import contextlib
import math
import os
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass

from pushfric_core.pushers.pusher import (
    Check,
    Grade,
    Limits,
    Mode,
    NotConnected,
    NotReady,
    Pusher,
    PusherConfig,
    PusherReport,
    Timeout,
    drive,
)
from pushfric_core.settings import REQUIRED, check_ranges, setting

DEAD_MAN = 0.2
"""The slide stops this long after the last command [s], whatever happens to the computer."""


class Slide(threading.Thread):
    """What would be hardware: a datagram "target,speed,stamp" is a command, and the answer is "position,speed,stamp".

    The target may be "stop", or empty to ask only; the stamp may be empty. A command is good for DEAD_MAN; a driver that lives
    repeats it.
    """

    def __init__(self, path: str) -> None:
        super().__init__(daemon=True)
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(path)
        self._position = self._target = 0.0  # [m]
        self._speed = 1.0  # [m/s]
        self._seen = self._until = time.monotonic()

    def run(self) -> None:
        while True:
            command, sender = self._socket.recvfrom(200)
            target, speed, stamp = command.decode().split(",")
            self._go_on()
            if target == "stop":
                self._target = self._position
            elif target:
                self._target, self._speed, self._until = float(target), float(speed), self._seen + DEAD_MAN
            moves = self._position != self._target and self._seen < self._until
            speed_now = math.copysign(self._speed, self._target - self._position) if moves else 0.0
            with contextlib.suppress(OSError):  # whoever asked may be gone
                self._socket.sendto(f"{self._position!r},{speed_now!r},{stamp}".encode(), sender)

    def _go_on(self) -> None:
        now = time.monotonic()
        way = self._target - self._position
        gone = min(abs(way), self._speed * max(0.0, min(now, self._until) - self._seen))
        self._position = self._target if gone == abs(way) else self._position + (gone if way > 0 else -gone)
        self._seen = now


@dataclass(frozen=True)
class SlideConfig:
    """The settings of a slide in a cell's file, in addition to those of every pusher."""

    device: str = setting(REQUIRED, "socket of the slide")
    backlash: float = setting(0.0, "play of the spindle [m]", 0.0, 0.01)

    def __post_init__(self) -> None:
        check_ranges(self)

    def open_pusher(self, config: PusherConfig) -> Pusher:
        """The driver, not connected yet."""
        return SlideDriver(self.device)

    def absence(self) -> str | None:
        """Why there can be no slide; None if there may be one."""
        return None if os.path.exists(self.device) else f"no slide at {self.device}"

    def checks(self, config: PusherConfig, distance: float, speed: float) -> Iterator[Check]:
        """What ./pushfric doctor says about the slide."""
        level = Grade.OK if self.backlash < distance / 100 else Grade.WARNING
        yield Check("slide", level, f"{1e3 * self.backlash:g} mm of play in pushes of {1e3 * distance:g} mm")


class SlideDriver:
    """Sends the same command at each poll: if the polls end, the slide stops by itself."""

    limits, dropped = Limits(max_speed=0.1), 0

    def __init__(self, device: str) -> None:
        self.name, self.place, self.doubt = f"a slide at {device}", device, None  # type: str, str, str | None
        self._device = device
        self._socket: socket.socket | None = None
        self._report: PusherReport | None = None  # the last one
        self._command: tuple[float, float] | None = None  # target [m] and speed [m/s], while it is to move
        self._moves = False  # as last reported
        self._asked: int | None = None  # a stamp
        self._heard = self._polled = 0.0  # [s]

    @property
    def mode(self) -> Mode:
        if self._report is None:
            return Mode.DISCONNECTED
        return Mode.RUNNING if self.busy else Mode.IDLE

    @property
    def busy(self) -> bool:
        return self._socket is not None and (self._report is None or self._command is not None or self._moves)

    def connect(self) -> None:
        with self._line():
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.bind("")  # an address of its own
            self._socket.setblocking(False)
            self._socket.connect(self._device)
        self._heard = self._polled = time.monotonic()
        self.doubt, self._moves = None, False

    @contextlib.contextmanager
    def _line(self) -> Iterator[None]:
        """What is done with the socket meanwhile fails as a pusher's line does."""
        try:
            yield
        except BlockingIOError:
            pass  # nothing more has come, or the slide has enough to answer
        except OSError as error:
            self._drop()
            raise NotConnected(f"no slide at {self._device}: {error}") from error

    def close(self) -> None:
        with contextlib.suppress(NotConnected, Timeout):
            self.stop()
            drive(self)
        self._drop()

    def _drop(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = self._report = self._command = None

    def recover(self) -> None:
        """A slide has no alarms: a person says that it stands where it says."""
        self.doubt = None

    def move_to(self, position: float, speed: float) -> None:
        if self.mode is not Mode.IDLE or self.doubt is not None:
            raise NotReady(f"the slide is {self.mode.value}, {self.doubt or 'expected idle'}")
        self._command, self._polled = (position, speed), time.monotonic()

    def stop(self) -> None:
        if self.busy and self._report is not None:
            self._command, self._moves = None, True  # until an answer says that it rests
            self._send("stop,,")

    def ask(self, stamp: int) -> None:
        self._asked = stamp

    def poll(self, stamp: int | None = None) -> PusherReport | None:
        now, before = time.monotonic(), self._polled
        self._polled = now
        fresh = self._hear(now)
        if self._command is not None and now - before > DEAD_MAN:
            self.stop()
            raise Timeout(f"this process stood still for {now - before:.2f} s")
        if now - self._heard > DEAD_MAN:
            self._drop()
            raise NotConnected(f"the slide at {self._device} says nothing")
        wanted = self._asked if self._asked is not None else stamp
        command = "," if self._command is None else f"{self._command[0]!r},{self._command[1]!r}"
        self._send(f"{command},{'' if wanted is None else wanted}")
        self._asked = None
        return fresh

    def _hear(self, now: float) -> PusherReport | None:
        """Take all answers that have come; return the last one as a report."""
        first, fresh = self._report is None, None
        with self._line():
            while self._socket is not None:
                position, speed, stamp = self._socket.recv(200).decode().split(",")
                self._heard, self._moves = now, float(speed) != 0.0
                if first and self._moves:
                    self.doubt = "it moved when it was found"
                if self._command is not None and float(position) == self._command[0]:
                    self._command = None
                self._report = PusherReport(float(position), float(speed), Mode.IDLE, int(stamp) if stamp else None)
                fresh = self._report._replace(mode=self.mode)
        return fresh

    def _send(self, text: str) -> None:
        assert self._socket is not None
        with self._line():
            self._socket.send(text.encode())


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        Slide(f"{folder}/slide").start()
        slide = SlideDriver(f"{folder}/slide")
        slide.connect()
        drive(slide)
        slide.move_to(0.05, speed=0.1)
        while slide.busy:
            if (report := slide.poll(time.monotonic_ns())) is not None:
                print(f"{report.mode.value} at {1e3 * report.position:.1f} mm")
            time.sleep(0.05)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        Slide(sys.argv[1]).run()
    main()
