"""The serial line to a controller: lines that it answers one by one, questions, which it answers by reports, and resets.

The port never blocks: it is opened for one program alone, and written to within a time limit.
"""

import contextlib
import math
import os
import select
import termios
from collections import deque

from pushfric_core.errors import blaming, extra

with extra("serial", "a serial port"):
    import serial
    from serial.tools.list_ports_linux import SysFS

from pushfric_core.pushers.clock import clock
from pushfric_core.pushers.pusher import NotConnected, PusherError

WRITE_TIMEOUT = 0.5  # [s]
LONGEST_LINE = 4096  # [bytes]
LATENCIES = 9  # of the last answers to questions
MOST_QUESTIONS = 2  # that wait, where all is answered in order: such a controller reads a stop only if it has room for it
QUESTION = "a question"
WIPED = "wiped out by a reset"


class Refused(PusherError):
    """The controller did not accept a line; `passing`: it may accept the same one a little later."""

    def __init__(self, text: str, passing: bool) -> None:
        super().__init__(text)
        self.passing = passing


class SerialLine:
    """The port, the line that waits for its answer, and the question that does."""

    def __init__(self, path: str, baud: int, in_order: bool) -> None:
        """Nothing is opened yet; `in_order`: all that is sent is answered in its order."""
        self.path, self._baud, self._in_order = path, baud, in_order
        self._port: serial.Serial | None = None
        self.forget()

    def forget(self) -> None:
        """Nothing has been sent or heard."""
        self._buffer = b""
        self.answer: Refused | str | None = None
        """To the last line."""
        self.sent_at = 0.0
        """When the last line was sent [s]."""
        self.asked_at = -math.inf
        """When the last question was sent [s]."""
        self.reported_of = 0.0
        """When the question behind the newest report was sent [s]."""
        self.latencies: deque[float] = deque(maxlen=LATENCIES)
        """Between questions and reports [s]."""
        self.number = 0
        """The last line's."""
        self.greetings = 0
        """Number of greetings that came."""
        self.owed = 0
        """Greetings that are due, for resets that were sent."""
        self.unasked = 0
        """Number of answers to no line that is known, as to one from before a reset."""
        self._unanswered: deque[tuple[str, float]] = deque()  # what was sent and when [s], where all is answered in order
        self._reports = False  # a report has come; the question that it answers is accepted next
        self.discard()

    def discard(self) -> None:
        """Whatever has been sent will not be answered any more."""
        self.pending: str | None = None
        """The line that is not answered yet."""
        self._is_asked = False
        self.stamp: int | None = None
        """Given with the question that is not answered yet."""
        self.silent_since: float | None = None
        """When the first question of those that are not answered was sent [s]."""

    def open(self) -> None:
        """Raises NotConnected."""
        if not os.path.exists(self.path):
            raise NotConnected(f"no serial port at {self.path}")
        with blaming(f"cannot open {self.path}", OSError, error=NotConnected):
            self._port = open_port(self.path, self._baud)

    def close(self, last_words: bytes) -> None:
        """Leave the port, if it is open."""
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(OSError):  # it may be gone already
                write_all(port, last_words)
            port.close()

    def write(self, data: bytes) -> None:
        """Raises NotConnected."""
        if self._port is None:
            raise NotConnected(f"{self.path} is not open")
        with blaming(f"lost {self.path}", OSError, error=NotConnected):
            write_all(self._port, data)

    def read(self) -> list[bytes]:
        """The lines that have arrived since the last time. Raises NotConnected."""
        if self._port is None:
            raise NotConnected(f"{self.path} is not open")
        with blaming(f"lost {self.path}", OSError, error=NotConnected):
            self._buffer += self._port.read(LONGEST_LINE)
        *lines, self._buffer = self._buffer.split(b"\n")
        self._buffer = self._buffer[-LONGEST_LINE:]  # noise without an end of line
        return lines

    def send(self, line: str, data: bytes) -> None:
        """Send a line as these bytes; its answer is awaited. Raises NotConnected."""
        self.pending, self.answer, self.sent_at = line, None, clock()
        self.say(data, line)

    def say(self, data: bytes, what: str = "") -> None:
        """Send something that is answered at some time, or never. Raises NotConnected."""
        if self._in_order:
            self._unanswered.append((what, clock()))
        self.write(data)

    def restart(self, data: bytes) -> None:
        """Send a reset, which a greeting will follow. Raises NotConnected."""
        self.say(data)
        self.owed += 1

    def accepted(self) -> None:
        """A line was accepted, or a question after its report."""
        reports, self._reports = self._reports, False
        if reports and not (self._unanswered and self._unanswered[0][0] == QUESTION):
            return  # it was given up when the controller threw it away, or seemed to
        if not self._in_order or (self._unanswered and self._unanswered.popleft()[0] == self.pending):
            self.answered("ok")

    def answered(self, answer: Refused | str) -> None:
        """The line that is awaited got this answer."""
        if self.pending is None:
            self.unasked += 1
        else:
            self.pending, self.answer = None, answer
            self.owed = 0  # so every greeting that was due before it has come

    def greeted(self) -> bool:
        """A greeting came; whether a reset is the reason."""
        self.greetings += 1
        if self.pending is not None and not self._in_order:
            self.pending, self.answer = None, WIPED
        expected = self.owed > 0
        self.owed -= expected
        return expected

    def may_ask(self, again: float) -> bool:
        """Whether no question waits for an answer, or one has waited for so long [s]."""
        return not self._is_asked or clock() - self.asked_at >= again

    def ask(self, question: bytes, stamp: int | None) -> None:
        """Send a question with this stamp, if there is room for it. Raises NotConnected."""
        if sum(what == QUESTION for what, _ in self._unanswered) < MOST_QUESTIONS:
            self.say(question, QUESTION)
        self.stamp, self._is_asked, self.asked_at = stamp, True, clock()
        self.silent_since = self.silent_since or self.asked_at

    @property
    def report_since(self) -> float:
        """The pusher was where a report that comes now says it is, at this time or later [s].

        A report answers the first open question, or an earlier one.
        """
        return self.reported_of if self.silent_since is None else self.silent_since

    def report_came(self) -> None:
        """A report answers the first question that is not answered, and so all before it, where all is answered in order."""
        if any(what == QUESTION for what, _ in self._unanswered):
            while self._unanswered[0][0] != QUESTION:
                self.accepted()
            self.silent_since = self._unanswered[0][1]
        self._reports = self._in_order

    def threw_away(self) -> None:
        """The controller refused a line, and perhaps threw away the questions that had come with it."""
        self._unanswered = deque(one for one in self._unanswered if one[0] != QUESTION)

    def misheard(self) -> None:
        """The report that came cannot be true: ask again at once."""
        self.stamp, self._is_asked, self.asked_at = None, False, -math.inf

    def reported(self, now: float) -> None:
        """A report that can be true has come."""
        self.reported_of = self.report_since
        if self.silent_since is not None:
            self.latencies.append(now - self.silent_since)
        self.stamp, self._is_asked, self.silent_since = None, False, None


def open_port(path: str, baud: int) -> serial.Serial:
    """Open a port for this process alone; its DTR line keeps its level when the port is closed.

    A change of DTR restarts many boards, which then lose their position.

    Args:
        path: of the port.
        baud: its speed [bit/s].
    Raises:
        OSError: the port cannot be opened, is in use, or has no such speed.
    """
    port = None
    try:
        port = serial.Serial(path, baud, timeout=0, exclusive=True)
        attributes = termios.tcgetattr(port.fd)
        attributes[2] &= ~termios.HUPCL
        termios.tcsetattr(port.fd, termios.TCSANOW, attributes)
    except (ValueError, termios.error) as error:
        if port is not None:
            port.close()
        raise OSError(str(error)) from error
    return port


def write_all(port: serial.Serial, data: bytes) -> None:
    """Write these bytes.

    pyserial's own timeout also fails a write that has succeeded, if the process stood still meanwhile.

    Args:
        port: as `open_port` opened it.
        data: the bytes.
    Raises:
        OSError: the port takes no bytes for WRITE_TIMEOUT, or is gone.
    """
    deadline = clock() + WRITE_TIMEOUT
    while data:
        if not select.select([], [port.fd], [], max(0.0, deadline - clock()))[1]:
            raise TimeoutError(f"it takes no bytes for {WRITE_TIMEOUT:g} s")
        with contextlib.suppress(BlockingIOError):
            data = data[os.write(port.fd, data) :]


def identity_of(port: str) -> str:
    """The device at a port: its USB serial number, else the USB socket it is plugged into, else the path of the port itself.

    All links to a port lead to the same one. A path begins at the root, and may name another device after a restart.
    """
    path = os.path.realpath(port)
    device = SysFS(path)
    interface = os.path.basename(device.usb_interface_path or "").rpartition(":")[2]  # of a device with several ports
    if device.serial_number:
        return f"usb:{device.vid:04x}:{device.pid:04x}:{device.serial_number}:{interface}"
    if device.location:
        return f"usb-socket:{device.location}"
    return path
