"""Whether the clocks of two streams step against each other, by the times at which their samples were received.

A busy machine delays single samples, and many for a while, but hardly ever all of them: the least delay of a time shows what
the clocks say. If it changes for good, and in one stream only, a clock has stepped. A recorder whose clock steps changes both.
"""

from typing import NamedTuple

import numpy as np

from pushfric_core.geometry.planar import Array

BLOCK = 16
"""Samples of which the second least delay counts: so a single wild stamp does not."""

FEWEST, MOST = 3, 32
"""Blocks on either side of a step. The least delay of fewer is not known, and that of more may drift."""

BURST = 0.25
"""Samples that are received this much faster than they were stamped were waiting: only the last of them shows the delay."""

SMALLEST = 0.03
"""A smaller step [s] is not told from the delays of a busy machine."""


class Step(NamedTuple):
    """A step of one clock against the other."""

    received: int  # when, by the clock of the receiver [ns]
    size: float  # by how much the first stream's stamps are later than before, against the other's [s]


class Delays:
    """The delays of the samples of one stream, in the order in which they were received."""

    def __init__(self) -> None:
        self._block: list[int] = []
        self._ends: list[int] = []  # when the last sample of each block was received [ns]
        self._least: list[int] = []  # the second least delay of each block [ns]
        self._last = (0, 0)  # stamp and time of receipt of the last sample [ns]

    def add(self, stamp: int, received: int) -> None:
        """Take a sample's stamp, and when it was received [ns]."""
        before, self._last = self._last, (stamp, received)
        if self._block and received - before[1] < BURST * (stamp - before[0]):
            self._block.pop()
        self._block.append(received - stamp)
        if len(self._block) == BLOCK:
            self._ends.append(received)
            self._least.append(sorted(self._block)[1])
            self._block.clear()

    @property
    def ends(self) -> Array:
        """The times at which blocks end (n,) [ns]."""
        return np.array(self._ends)

    def change(self, times: Array, most: int) -> Array:
        """By how much the least delay of so many blocks grows at some times (m,) [ns]; NaN where too few lie on one side."""
        rank = np.searchsorted(self._ends, times, side="right")
        return np.array([self._least_of(one, one + most) - self._least_of(max(0, one - most), one) for one in rank])

    def _least_of(self, begin: int, end: int) -> float:
        blocks = self._least[begin:end]
        return float(min(blocks)) if len(blocks) >= FEWEST else np.nan


def clock_step(one: Delays, other: Delays) -> Step | None:
    """The largest step of the clocks of two streams against each other; None if there is none."""
    times = np.concatenate((one.ends, other.ends))
    sizes, nearby = (other.change(times, most) - one.change(times, most) for most in (MOST, FEWEST))
    steps = np.abs(sizes) > SMALLEST * 1e9
    if not np.any(steps):
        return None
    at = int(np.argmax(np.where(steps, np.abs(nearby), -1.0)))
    return Step(int(times[at]), float(sizes[at]) * 1e-9)
