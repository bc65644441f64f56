"""The time that decides about motion."""

import time

SAME_MOMENT = 1e-3  # [s]


def clock() -> float:
    """Time that goes on while the computer is suspended, as a pusher may; only differences mean something [s]."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def suspended() -> float:
    """For how long this computer has been suspended since it was started [s]."""
    while True:
        before, now, after = time.monotonic(), clock(), time.monotonic()
        if after - before < SAME_MOMENT:  # otherwise this process stood still between two of them
            return now - after
