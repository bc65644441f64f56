"""The serial port of a simulated controller: a pseudo-terminal, and the thread that serves it in real time."""

import contextlib
import os
import select
import threading
import tty
from abc import ABC, abstractmethod
from typing import Self

BOOT = 0.1  # from the opening of the port to the greeting [s]
TICK = 0.005  # [s]


def pseudo_terminal() -> tuple[int, int, str]:
    """A new one: its master side, which never blocks, its slave side, which passes all bytes, and the path of the latter."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    return master, slave, os.ttyname(slave)


class SerialController(ABC):
    """A controller that a driver finds at `port`. Use it as a context manager, or between `start` and `close`.

    An entry point of the group pushfric.simulations, under the name of the driver, is called with `clock` [s], `travel` [m] and
    `max_speed` [m/s], and returns one; the settings of that driver need a `port`."""

    def __init__(self, restarts: bool) -> None:
        """Not plugged in yet.

        Args:
            restarts: it restarts whenever its port is opened, as the DTR line makes most boards do; otherwise it goes on with
                whatever it does.
        """
        self._restarts = restarts
        self.port = ""  # path of the slave side
        self.opened = False  # whether somebody has it open
        self._lock = threading.RLock()  # position() is asked by the simulation, bytes come in the IO thread
        self._master: int | None = None
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    @abstractmethod
    def position(self) -> float:
        """Where the carriage is [m]."""

    @abstractmethod
    def hold_in_reset(self, held: bool) -> None:
        """The reset input is closed, as by an emergency stop, or open: a carriage that moves stops, its place in doubt."""

    def unasked(self) -> float:
        """For how long nobody has asked for the position of a carriage that moves [s]; 0 if that is not known."""
        return 0.0

    def start(self) -> Self:
        """Plug in: a new pseudo-terminal, at `port`."""
        self.opened = False
        self._master, slave, self.port = pseudo_terminal()
        os.close(slave)
        self._closing.clear()
        self._thread = threading.Thread(target=self._serve, args=(self._master,), name="controller")
        self._thread.start()
        return self

    def close(self) -> None:
        """Unplug, and wait for the IO thread to end.

        The port disappears; the board has power of its own and goes on with its motion. `start` plugs it in again.
        """
        if self._thread is not None:
            self._closing.set()
            self._thread.join()
            self._thread = None

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.close()

    def say(self, data: bytes) -> None:
        """Send anything."""
        with self._lock:
            self._send(data)

    @abstractmethod
    def _boot(self) -> None:
        """The port was opened, and the board restarts."""

    @abstractmethod
    def _receive(self, data: bytes) -> None:
        """Take what has come."""

    @abstractmethod
    def _go_on(self) -> None:
        """Do what is due; called at every tick."""

    def _serve(self, master: int) -> None:
        poller = select.poll()
        poller.register(master, select.POLLIN)
        try:
            while not self._closing.is_set():
                events = dict(poller.poll(TICK * 1000)).get(master, 0)
                if not events & select.POLLHUP and not self.opened and self._restarts:
                    self._closing.wait(BOOT)
                    self._boot()
                self.opened = not events & select.POLLHUP
                if events & select.POLLIN:
                    self._receive(os.read(master, 4096))
                elif not self.opened:
                    self._closing.wait(TICK)
                with self._lock:
                    self._go_on()
        finally:
            with self._lock:
                self._master = None
            os.close(master)

    def _send(self, data: bytes) -> None:
        if self._master is not None:
            with contextlib.suppress(BlockingIOError):  # nobody reads: a serial line does not wait either
                os.write(self._master, data)

    def _say(self, line: str) -> None:
        self._send(line.encode() + b"\r\n")
