"""The time that decides about motion."""

import time


def clock() -> float:
    """Time that goes on while the computer is suspended, as a pusher may; only differences mean something [s]."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def suspended() -> float:
    """For how long this computer has been suspended since it was started [s]."""
    return clock() - time.monotonic()
