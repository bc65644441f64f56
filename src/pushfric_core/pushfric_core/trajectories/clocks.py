"""The clocks of two streams: whether they step against each other, and how far poses lag behind the pusher.

A busy machine delays single samples, and many for a while, but hardly ever all of them: the least delay of a time shows what
the clocks say. If it changes for good, and in one stream only, a clock has stepped. A recorder whose clock steps changes both.

While the tip pushes, it seems to be too far into the object, by its speed times the lag; once it has stopped, and the object
rests, it does not. So errors of outline, tip and calibration, which are alike in both, do not matter. The lags of the pushes
scatter as much as their mean may be off. Only a tip that keeps to its line can be compared in this way.
"""

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import reduce
from typing import NamedTuple

import numpy as np

from pushfric_core.geometry.outline import Outline
from pushfric_core.trajectories.course import RESTS
from pushfric_core.trajectories.samples import PoseSample, PusherSample

BLOCK = 16
"""Samples of which the second least delay counts: so a single wild stamp does not."""

FEWEST, MOST = 3, 32
"""Blocks on either side of a step. The least delay of fewer is not known, and that of more may drift."""

BURST = 0.25
"""Samples that are received this much faster than they were stamped were waiting: only the last of them shows the delay."""

SMALLEST = 0.04
"""A smaller step or lag [s] is not told from the delays of a busy machine."""

CLEAR = 2.0
"""Nor is a step that is smaller than this multiple of what the delays of a block are above the least, in the median.

As a cell starts, all samples of FEWEST blocks may wait; but not all alike.
"""

STANDS_STILL = 0.02
"""Where samples that were stamped over a longer time [s] were received at one time, the receiver's clock stood still, as that
of a busy recorder of a simulated cell does: they may seem to come before they were stamped, and show no delay."""

OTHER_SPEED = 0.05
"""Where both streams are received faster or slower than they are stamped by more than this fraction, the receiver has another
kind of time, as one that records a simulated cell by the time of day: it shows no steps."""

LONGEST_WAIT = 5000
"""Ends of blocks that wait for those after them: a stream may have stopped."""


class ClockStep(NamedTuple):
    """A step of one clock against the other."""

    received: int  # when, by the clock of the receiver [ns]
    size: float  # by how much the first stream's stamps are later than before, against the other's [s]
    nearby: float  # how large it is by the delays just before and after it [ns]


class Clocks:
    """Compares the delays of the samples of two streams, in the order in which they were received."""

    def __init__(self) -> None:
        self._streams = _Delays(), _Delays()
        self._received = 0  # when the newest samples were received [ns]
        self._at_once: tuple[list[int], list[int]] = [], []  # their stamps, by stream [ns]
        self._open: list[int] = []  # ends of blocks, with too few blocks after them to judge them for good [ns]
        self._found: ClockStep | None = None  # the largest step so far

    def add(self, stream: int, stamp: int, received: int) -> None:
        """Take the stamp of a sample of the first stream, 0, or the second, 1, and when it was received [ns]."""
        if received != self._received:
            if all(max(one, default=0) - min(one, default=0) <= STANDS_STILL * 1e9 for one in self._at_once):
                self._take_at_once()
            for one in self._at_once:
                one.clear()
        self._received = received
        self._at_once[stream].append(stamp)

    def _take_at_once(self) -> None:
        """Take the samples that were received at one time."""
        streams = zip(self._streams, self._at_once, strict=True)
        if sum(delays.add(stamp, self._received) for delays, stamps in streams for stamp in stamps):
            self._open.append(self._received)
            while all(one.after(self._open[0]) >= MOST for one in self._streams) or len(self._open) > LONGEST_WAIT:
                self._found = self._larger(self._found, self._open.pop(0))

    @property
    def step(self) -> ClockStep | None:
        """The largest step of the clocks against each other; None if there is none."""
        speeds = [one.speed for one in self._streams]
        if min(speeds) > 1 + OTHER_SPEED or max(speeds) < 1 - OTHER_SPEED or math.inf in speeds:
            return None
        return reduce(self._larger, self._open, self._found)

    def _larger(self, found: ClockStep | None, time: int) -> ClockStep | None:
        """The step that was found, or that at a time, if it is larger."""
        ways = ((MOST, min), (FEWEST, np.mean))  # the mean is sharpest at the step
        size, nearby = (self._streams[1].change(time, *way) - self._streams[0].change(time, *way) for way in ways)
        is_clear = abs(size) > SMALLEST * 1e9 and abs(size) >= CLEAR * max(one.scatter(time) for one in self._streams)
        return ClockStep(time, size * 1e-9, abs(nearby)) if is_clear and (not found or abs(nearby) > found.nearby) else found


class _Delays:
    """The delays of the samples of one stream."""

    def __init__(self) -> None:
        self._block: list[int] = []
        self._ends: list[int] = []  # when the last sample of each block was received [ns]
        self._least: list[int] = []  # the second least delay of each block [ns]
        self._above: list[int] = []  # the median delay of each block above that [ns]
        self._first: tuple[int, int] | None = None  # stamp and time of receipt of the first sample [ns]
        self._last = (0, 0)  # likewise of the last one

    def add(self, stamp: int, received: int) -> bool:
        """Take a sample; return whether a block ends with it."""
        before, self._last = self._last, (stamp, received)
        self._first = self._first or self._last
        if self._block and received - before[1] < BURST * (stamp - before[0]):
            self._block.pop()
        self._block.append(received - stamp)
        if len(self._block) < BLOCK:
            return False
        self._ends.append(received)
        delays = sorted(self._block)
        self._least.append(delays[1])
        self._above.append(delays[BLOCK // 2] - delays[1])
        self._block.clear()
        return True

    @property
    def speed(self) -> float:
        """The time in which the samples were received, in that of their stamps; inf if these stand still, 1 if they go back."""
        first, last = self._first or self._last, self._last
        stamped = last[0] - first[0]
        return (last[1] - first[1]) / stamped if stamped > 0 else 1.0 if stamped else math.inf

    def after(self, time: int) -> int:
        """The number of blocks that end after a time [ns]."""
        return len(self._ends) - bisect_right(self._ends, time)

    def change(self, time: int, most: int, of: Callable[[list[int]], float]) -> float:
        """By how much the least or mean delay of so many blocks grows at a time [ns]; NaN if too few lie on one side."""
        before, after = self._around(self._least, time, most)
        return of(after) - of(before) if min(len(before), len(after)) >= FEWEST else math.nan

    def scatter(self, time: int) -> float:
        """The median of what delays are above the least, before or after a time: the larger of the two [ns]."""
        return max(float(np.median(one)) for one in self._around(self._above, time, MOST))

    def _around(self, figures: list[int], time: int, most: int) -> tuple[list[int], list[int]]:
        """The figures of so many blocks before and after a time [ns]."""
        rank = bisect_right(self._ends, time)
        return figures[max(0, rank - most) : rank], figures[rank : rank + most]


GUARD = 0.2
"""A lag is less than this [s]: frames that are nearer to a change of the tip's speed do not count."""

NEAR = 1.0
"""Only frames this near to the end of a push count [s]: the contact is almost where the object then rests."""

FEWEST_FRAMES, FEWEST_PUSHES = 3, 5
"""Number of frames in motion and at rest, and of pushes, that show a lag."""

STEADY = 0.1
"""A tip is steady if its speeds before and after a frame differ by at most this fraction."""

MOVED, TAKEN = 0.001, 0.005
"""The object is pushed once it has moved by this much [m], and was taken away once it has left its place by this much."""

STRAY = 5.0
"""Pushes farther from the median lag than this multiple of the median distance do not count: a hand moved the object."""


SERIES = (0.4339, 0.983, 1.4202, 1.5238, 1.6449)
"""Coefficients of `student` by falling powers of 1 / freedom."""


class Lag(NamedTuple):
    """How late the stamps of poses are."""

    mean: float  # [s]; negative: those of the pusher states are late
    radius: float  # the lag is within this of the mean with 90 % probability [s]

    @property
    def is_large(self) -> bool:
        """Whether it is certain that it is more than delays."""
        return abs(self.mean) - self.radius > SMALLEST


@dataclass
class _Push:
    """A push, with what came in the second after it."""

    end: int = 0  # the stamp of its last state [ns]
    states: "list[PusherSample]" = field(default_factory=list)
    frames: "list[PoseSample]" = field(default_factory=list)


class Lags:
    """Measures the lag in each push, once the next one begins.

    Args:
        outline: of the object.
    """

    def __init__(self, outline: Outline) -> None:
        self._outline = outline
        self._pushes: deque[_Push] = deque()  # that are not measured yet
        self._newest: int | None = None  # push
        self._found: list[tuple[float, float]] = []  # of each push: its lag [s] and its weight

    def add_state(self, state: "PusherSample") -> None:
        """Take the next pusher state, in order of time."""
        if state.push_id is not None:
            if state.push_id != self._newest or not self._pushes:
                self._newest = state.push_id
                self._pushes.append(_Push())
            self._pushes[-1].end = state.stamp
        if self._pushes and state.stamp - self._pushes[-1].end < (NEAR + GUARD) * 1e9:
            self._pushes[-1].states.append(state)

    def add_pose(self, sample: "PoseSample") -> None:
        """Take the next pose, in order of time, once a later state has been taken."""
        while len(self._pushes) > 1 and sample.stamp >= self._pushes[1].states[0].stamp:
            if (found := self._measured(self._pushes.popleft())) is not None:
                self._found.append(found)
        if self._pushes and self._pushes[0].states[0].stamp <= sample.stamp < self._pushes[0].end + NEAR * 1e9:
            self._pushes[0].frames.append(sample)

    @property
    def lag(self) -> Lag | None:
        """The lag in the pushes so far; None while too few show it."""
        if len(self._found) < FEWEST_PUSHES:
            return None
        lags, weights = np.array(self._found).T
        off = np.abs(lags - np.median(lags))
        near = off <= STRAY * np.median(off)
        lags, weights, count = lags[near], weights[near], int(near.sum())
        mean = weights @ lags / weights.sum()
        variance = weights @ (lags - mean) ** 2 / weights.sum() / (count - 1)
        return Lag(float(mean), student(count - 1) * math.sqrt(variance))

    def _measured(self, push: _Push) -> tuple[float, float] | None:
        """The lag in a push, and its weight; None if it does not show it."""
        line, start = push.states[0].line, push.states[0].stamp
        last = next(one for one in push.states if one.stamp == push.end)
        fastest = max(one.speed for one in push.states)
        stops = abs(last.speed) <= RESTS < fastest  # else nobody knows how far the tip went
        if len(push.frames) < FEWEST_FRAMES or not stops or any(one.line != line for one in push.states):
            return None
        times = np.array([one.stamp - start for one in push.states]) * 1e-9
        farthest = np.maximum.accumulate([one.position for one in push.states])  # the object stays where it was pushed to
        stop = times[np.argmax(farthest >= farthest[-1] - MOVED / 10)]
        at = np.array([one.stamp - start for one in push.frames]) * 1e-9
        counts = at >= stop - NEAR - GUARD
        counts[:FEWEST_FRAMES] = True
        at, frames = at[counts], [one for one, used in zip(push.frames, counts, strict=True) if used]
        touches = [line.touch(self._outline, one.pose) for one in frames]
        met = np.array([math.nan if one is None or one.edge is None else one.distance for one in touches])
        before, now, after = (np.interp(at + shift, times, farthest) for shift in (-GUARD, 0.0, GUARD))
        resting = np.flatnonzero((at >= stop + GUARD) & np.isfinite(met))
        # until a hand takes it away; if poses are late, it seems to go on for a while, but not back, nor faster than the tip
        places, possible = met[resting], fastest * np.diff(at[resting], prepend=at[resting[:1]]) + TAKEN
        taken = (np.maximum.accumulate(places) - places > TAKEN) | (np.diff(places, prepend=places[:1]) > possible)
        resting = resting[~np.logical_or.accumulate(taken)]
        if len(resting) < FEWEST_FRAMES:
            return None
        error = farthest[-1] - met[resting].mean()
        speeds = (after - before) / (2 * GUARD)
        steady = np.abs(after - 2 * now + before) <= STEADY * (after - now)
        pushed = steady & (speeds > RESTS) & (at <= stop - GUARD) & (before - error >= met[:FEWEST_FRAMES].mean() + MOVED)
        if pushed.sum() < FEWEST_FRAMES:
            return None
        lag = np.mean((now - met - error)[pushed] / speeds[pushed])
        weight = np.mean(speeds[pushed]) ** 2 / (1 / pushed.sum() + 1 / len(resting))
        return (float(lag), float(weight)) if math.isfinite(lag) else None


def student(freedom: int) -> float:
    """The 95 % quantile of Student's distribution (Abramowitz and Stegun 1972, 26.7.5), to .3 % from two degrees of freedom on.

    scipy.special has it, but takes as long to load as all that a node needs.
    """
    return float(np.polyval(SERIES, 1 / freedom))
