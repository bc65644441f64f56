"""A controller on a line that can fail, for the tests of what its driver does when something breaks."""

import contextlib
import time
from collections.abc import Callable
from typing import Any, ClassVar

import pytest

from pushfric_core.pushers.pusher import Mode, NotConnected, PusherError
from pushfric_core.pushers.serial_pusher import SerialPusher
from pushfric_core.pushers.serial_settings import SerialSettings
from pushfric_core.simulated.faulty_line import FaultyLine

SPEED, ACCELERATION = 0.02, 0.5
DEAD_MAN = 0.3 * SPEED + SPEED**2 / (2 * ACCELERATION)
"""After a fault the pusher may go on for this long [m]."""
LATE = 1e-3
"""A busy machine sees a fault later than it happens [m]."""


class LineStage:
    """A controller that goes on running whoever connects and leaves, behind a line that can fail."""

    config: type[SerialSettings]
    patience: ClassVar[dict[str, Any]] = {"silence": 10.0, "connect_timeout": 20.0}
    """Settings for a busy machine, on which a pseudo-terminal may deliver nothing for 2 s."""

    def __init__(self, controller: Any, line: FaultyLine) -> None:
        self.controller, self.line = controller, line

    def driver(self, home: bool = False, only_look: bool = False, **settings: Any) -> Any:
        """A driver that is connected and ready."""
        pusher = SerialPusher(self.config(self.line.port, **self.patience | settings), home, only_look)
        self.carry_out(pusher, pusher.connect)
        return pusher

    def drive(self, pusher: SerialPusher, until: Callable[[], object], seconds: float = 60.0) -> list:
        reports = []
        deadline = time.monotonic() + seconds
        while not until():
            assert time.monotonic() < deadline, f"not within {seconds} s: {pusher.mode}, at {self.controller.position()}"
            if (report := pusher.poll()) is not None:
                reports.append(report)
            time.sleep(0.002)
        return reports

    def carry_out(self, pusher: SerialPusher, command: Callable[[], None]) -> list:
        """Give a command, poll until the pusher rests, and return the reports."""
        command()
        return self.drive(pusher, lambda: not pusher.busy)

    def push(self, pusher: SerialPusher, target: float) -> list:
        """Go to a target [m] and return the reports."""
        return self.carry_out(pusher, lambda: pusher.move_to(target, SPEED))

    def fails(
        self, pusher: SerialPusher, error: type[PusherError] | tuple[type[PusherError], ...], text: str | None = None
    ) -> PusherError:
        """Poll until the error is raised, then until the pusher rests."""
        with pytest.raises(error, match=text) as caught:
            self.drive(pusher, lambda: False)
        if pusher.mode is not Mode.DISCONNECTED:
            with contextlib.suppress(NotConnected):
                self.drive(pusher, lambda: not pusher.busy)
        return caught.value

    def rest(self) -> float:
        """Where the carriage comes to rest [m]."""
        deadline = time.monotonic() + 60
        before, here = None, self.controller.position()
        while before != here:
            assert time.monotonic() < deadline, "it does not come to rest"
            time.sleep(0.05)
            before, here = here, self.controller.position()
        return here
