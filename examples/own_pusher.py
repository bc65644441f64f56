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

from pushfric_core.pushers import pusher
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

    def run(self) -> None:
        position = target = 0.0  # [m]
        speed, seen = 1.0, time.monotonic()  # [m/s], [s]
        until = seen
        while True:
            command, sender = self._socket.recvfrom(200)
            wanted, fast, stamp = command.decode().split(",")
            before, seen = seen, time.monotonic()
            way = speed * max(0.0, min(seen, until) - before)
            position = max(position - way, min(target, position + way))
            if wanted == "stop":
                target = position
            elif wanted:
                target, speed, until = float(wanted), float(fast), seen + DEAD_MAN
            speed_now = math.copysign(speed, target - position) if position != target and seen < until else 0.0
            with contextlib.suppress(OSError):  # whoever asked may be gone
                self._socket.sendto(f"{position!r},{speed_now!r},{stamp}".encode(), sender)


@dataclass(frozen=True)
class SlideConfig:
    """The settings of a slide in a cell's file, in addition to those of every pusher."""

    device: str = setting(REQUIRED, "socket of the slide")
    backlash: float = setting(0.0, "play of the spindle [m]", 0.0, 0.01)

    def __post_init__(self) -> None:
        check_ranges(self)

    def open_pusher(self, config: pusher.PusherConfig) -> pusher.Pusher:
        """The driver, not connected yet."""
        return SlideDriver(self.device)

    def absence(self) -> str | None:
        """Why there can be no slide; None if there may be one."""
        return None if os.path.exists(self.device) else f"no slide at {self.device}"

    def checks(self, config: pusher.PusherConfig, distance: float, speed: float) -> Iterator[pusher.Check]:
        """What ./pushfric doctor says about the slide."""
        level = pusher.Grade.OK if self.backlash < distance / 100 else pusher.Grade.WARNING
        yield pusher.Check("slide", level, f"{1e3 * self.backlash:g} mm of play in pushes of {1e3 * distance:g} mm")


class SlideDriver:
    """Sends the same command at each poll: if the polls end, the slide stops by itself."""

    limits, dropped = pusher.Limits(max_speed=0.1), 0

    def __init__(self, device: str) -> None:
        self.name, self.place, self.doubt = f"a slide at {device}", device, None  # type: str, str, str | None
        self._device = device
        self._socket: socket.socket | None = None
        self._report: pusher.PusherReport | None = None  # the last one
        self._command: tuple[float, float] | None = None  # target [m] and speed [m/s], while it is to move
        self._moves = False  # as last reported
        self._asked: int | None = None  # a stamp
        self._heard = self._polled = 0.0  # [s]

    @property
    def mode(self) -> pusher.Mode:
        if self._report is None:
            return pusher.Mode.DISCONNECTED
        return pusher.Mode.RUNNING if self.busy else pusher.Mode.IDLE

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
            raise pusher.NotConnected(f"no slide at {self._device}: {error}") from error

    def close(self) -> None:
        with contextlib.suppress(pusher.NotConnected, pusher.Timeout):
            self.stop()
            pusher.drive(self)
        self._drop()

    def _drop(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = self._report = self._command = None

    def recover(self) -> None:
        """A slide has no alarms: a person says that it stands where it says."""
        self.doubt = None

    def move_to(self, position: float, speed: float) -> None:
        if self.mode is not pusher.Mode.IDLE or self.doubt is not None:
            raise pusher.NotReady(f"the slide is {self.mode.value}, {self.doubt or 'expected idle'}")
        self._command, self._polled = (position, speed), time.monotonic()

    def stop(self) -> None:
        if self.busy and self._report is not None:
            self._command, self._moves = None, True  # until an answer says that it rests
            self._send("stop,,")

    def ask(self, stamp: int) -> None:
        self._asked = stamp

    def poll(self, stamp: int | None = None) -> pusher.PusherReport | None:
        now, before = time.monotonic(), self._polled
        self._polled = now
        fresh = self._hear(now)
        if self._command is not None and now - before > DEAD_MAN:
            self.stop()
            raise pusher.Timeout(f"this process stood still for {now - before:.2f} s")
        if now - self._heard > DEAD_MAN:
            self._drop()
            raise pusher.NotConnected(f"the slide at {self._device} says nothing")
        wanted = self._asked if self._asked is not None else stamp
        command = "," if self._command is None else f"{self._command[0]!r},{self._command[1]!r}"
        self._send(f"{command},{'' if wanted is None else wanted}")
        self._asked = None
        return fresh

    def _hear(self, now: float) -> pusher.PusherReport | None:
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
                when = int(stamp) if stamp else None
                self._report = pusher.PusherReport(float(position), float(speed), pusher.Mode.IDLE, when)
                fresh = self._report._replace(mode=self.mode)
        return fresh

    def _send(self, text: str) -> None:
        with self._line():
            self._socket.send(text.encode())


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        Slide(f"{folder}/slide").start()
        slide = SlideDriver(f"{folder}/slide")
        slide.connect()
        pusher.drive(slide)
        slide.move_to(0.05, speed=0.1)
        while slide.busy:
            if (report := slide.poll(time.monotonic_ns())) is not None:
                print(f"{report.mode.value} at {1e3 * report.position:.1f} mm")
            time.sleep(0.05)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        Slide(sys.argv[1]).run()
    main()
