"""The time that decides about motion."""

import time

from pushfric_core.pushers.pusher import Suspended

SAME_MOMENT = 1e-3  # [s]
SLEPT = 0.1  # a computer that was suspended for longer than this has lost sight of its pusher [s]


def clock() -> float:
    """Time that goes on while the computer is suspended, as a pusher may; only differences mean something [s]."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def suspended() -> float:
    """For how long this computer has been suspended since it was started [s]."""
    while True:
        before, now, after = time.monotonic(), clock(), time.monotonic()
        if after - before < SAME_MOMENT:  # otherwise this process stood still between two of them
            return now - after


class Wakefulness:
    """Notices that the computer was suspended since this was made or last asked."""

    def __init__(self) -> None:
        self._known = suspended()

    def check(self) -> None:
        """Raises Suspended, once for each time."""
        if (slept := suspended() - self._known) > SLEPT:
            self._known += slept
            raise Suspended(f"this computer was suspended for {slept:.1f} s")
