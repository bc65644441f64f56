"""A serial line that can fail: between a controller's port and a pseudo-terminal that stands in for it."""

import contextlib
import os
import select
import threading
import time
from collections import deque
from collections.abc import Callable

from pushfric_core.pushers.serial_line import open_port, write_all
from pushfric_core.simulated.serial_controller import pseudo_terminal

Filter = Callable[[bytes], bytes]
TICK = 0.002  # [s]


class FaultyLine:
    """Passes bytes on as they come, except for the faults that are set. Use as a context manager.

    `to_controller` and `to_host` are functions that are given the bytes that came and return the bytes to pass on.
    `delay_to_controller` and `delay_to_host` [s] hold these back. `heard` is given every piece that the controller says before
    any fault, so it hears the truth.
    """

    def __init__(self, port: str, baud: int = 115200) -> None:
        """The line ends at the controller's port, which is opened at once and held; `port` is the other end.

        Raises:
            OSError: the port cannot be opened.
        """
        self._serial = open_port(port, baud)
        self._master, self._slave, self.port = pseudo_terminal()  # the slave is kept open: no end of file when the host leaves
        self.heal()
        self.heard: Callable[[bytes], None] = lambda data: None
        self._for_controller: deque[tuple[float, bytes]] = deque()  # when each piece is due
        self._for_host: deque[tuple[float, bytes]] = deque()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="line")
        self._lock = threading.Lock()
        self.broken: OSError | None = None  # why the port can no longer be read or written, such as a plug that was pulled

    def __enter__(self) -> "FaultyLine":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._thread.join()
        self._serial.close()
        os.close(self._slave)
        os.close(self._master)

    def heal(self) -> None:
        """From now on, pass on everything at once; bytes that were held back still arrive when they are due."""
        self.to_controller: Filter = bytes
        self.to_host: Filter = bytes
        self.delay_to_controller = self.delay_to_host = 0.0
        self.damaged = False

    def damage(self, **faults: Filter) -> None:
        """From now on, use these filters, by the names of the attributes; `damaged` says once one has changed anything."""
        self.damaged = False
        for name, filtered in faults.items():
            setattr(self, name, filtered)

    def tell_controller(self, data: bytes) -> None:
        """Write to the controller as another program on the line would; whether that was possible, `broken` says."""
        with self._lock:
            try:
                write_all(self._serial, data)
            except OSError as error:
                self.broken = error

    def tell_host(self, data: bytes) -> None:
        """Write to the host as the controller would, after what it has already said."""
        self._for_host.append((time.monotonic() + self.delay_to_host, data))

    def _serve(self) -> None:
        while not self._closing.is_set() and self.broken is None:
            ready, _, _ = select.select([self._master, self._serial.fd], [], [], TICK)
            if self._master in ready:
                passed = self._filtered(self.to_controller, os.read(self._master, 4096))
                self._for_controller.append((time.monotonic() + self.delay_to_controller, passed))
            if self._serial.fd in ready:
                self._hear()
            while self._for_controller and self._for_controller[0][0] <= time.monotonic():
                self.tell_controller(self._for_controller.popleft()[1])
            while self._for_host and self._for_host[0][0] <= time.monotonic():
                with contextlib.suppress(BlockingIOError):  # nobody reads, and a line does not wait
                    os.write(self._master, self._for_host.popleft()[1])

    def _hear(self) -> None:
        try:
            said = self._serial.read(4096)
        except OSError as error:
            self.broken = error
            return
        self.heard(said)
        self.tell_host(self._filtered(self.to_host, said))

    def _filtered(self, filtered: Filter, data: bytes) -> bytes:
        passed = filtered(data)
        self.damaged = self.damaged or passed != data
        return passed


def once(old: bytes, new: bytes) -> Filter:
    """A filter that replaces the first `old` to come within one piece, and passes on all else."""
    waiting = [True]

    def replaced(data: bytes) -> bytes:
        if waiting and old in data:
            waiting.clear()
            return data.replace(old, new, 1)
        return data

    return replaced


def nothing(_: bytes) -> bytes:
    """A filter that lets nothing through."""
    return b""
