"""Whether the clocks of two streams step against each other, by the times at which their samples were received.

A busy machine delays single samples, and many for a while, but hardly ever all of them: the least delay of a time shows what
the clocks say. If it changes for good, and in one stream only, a clock has stepped. A recorder whose clock steps changes both.
"""

import math
from bisect import bisect_right
from typing import NamedTuple

BLOCK = 16
"""Samples of which the second least delay counts: so a single wild stamp does not."""

FEWEST, MOST = 3, 32
"""Blocks on either side of a step. The least delay of fewer is not known, and that of more may drift."""

BURST = 0.25
"""Samples that are received this much faster than they were stamped were waiting: only the last of them shows the delay."""

SMALLEST = 0.04
"""A smaller step or lag [s] is not told from the delays of a busy machine."""

LONGEST_WAIT = 5000
"""Ends of blocks that wait for those after them: a stream may have stopped."""


class ClockStep(NamedTuple):
    """A step of one clock against the other."""

    received: int  # when, by the clock of the receiver [ns]
    size: float  # by how much the first stream's stamps are later than before, against the other's [s]


class Clocks:
    """Compares the delays of the samples of two streams, in the order in which they were received."""

    def __init__(self) -> None:
        self._streams = _Delays(), _Delays()
        self._open: list[int] = []  # ends of blocks, with too few blocks after them to judge them for good [ns]
        self._found: tuple[float, ClockStep] | None = None  # the largest step so far, and how large it is nearby [ns]

    def add(self, stream: int, stamp: int, received: int) -> None:
        """Take the stamp of a sample of the first stream, 0, or the second, 1, and when it was received [ns]."""
        if self._streams[stream].add(stamp, received):
            self._open.append(received)
            while all(one.after(self._open[0]) >= MOST for one in self._streams) or len(self._open) > LONGEST_WAIT:
                self._found = self._larger(self._found, self._open.pop(0))

    @property
    def step(self) -> ClockStep | None:
        """The largest step of the clocks against each other; None if there is none."""
        found = self._found
        for time in self._open:
            found = self._larger(found, time)
        return None if found is None else found[1]

    def _larger(self, found: tuple[float, ClockStep] | None, time: int) -> tuple[float, ClockStep] | None:
        """The step that was found, or that at a time, if it is larger."""
        size, nearby = (self._streams[1].change(time, most) - self._streams[0].change(time, most) for most in (MOST, FEWEST))
        if not abs(size) > SMALLEST * 1e9 or (found is not None and not abs(nearby) > found[0]):
            return found
        return abs(nearby), ClockStep(time, size * 1e-9)


class _Delays:
    """The delays of the samples of one stream."""

    def __init__(self) -> None:
        self._block: list[int] = []
        self._ends: list[int] = []  # when the last sample of each block was received [ns]
        self._least: list[int] = []  # the second least delay of each block [ns]
        self._last = (0, 0)  # stamp and time of receipt of the last sample [ns]

    def add(self, stamp: int, received: int) -> bool:
        """Take a sample; return whether a block ends with it."""
        before, self._last = self._last, (stamp, received)
        if self._block and received - before[1] < BURST * (stamp - before[0]):
            self._block.pop()
        self._block.append(received - stamp)
        if len(self._block) < BLOCK:
            return False
        self._ends.append(received)
        self._least.append(sorted(self._block)[1])
        self._block.clear()
        return True

    def after(self, time: int) -> int:
        """The number of blocks that end after a time [ns]."""
        return len(self._ends) - bisect_right(self._ends, time)

    def change(self, time: int, most: int) -> float:
        """By how much the least delay of so many blocks grows at a time [ns]; NaN if too few lie on one side."""
        rank = bisect_right(self._ends, time)
        return self._least_of(rank, rank + most) - self._least_of(max(0, rank - most), rank)

    def _least_of(self, begin: int, end: int) -> float:
        blocks = self._least[begin:end]
        return float(min(blocks)) if len(blocks) >= FEWEST else math.nan
