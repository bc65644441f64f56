"""A stream of stamped samples in order of time, so that a wild stamp costs one sample and no other.

Which samples count follows from the stamps of their own stream alone, so it is the same live, in a replay and offline:

- A stamp before that of the last sample that counts, or the same on another sample: the sample is left out.
- A stamp that follows within LEAP usual steps: the sample counts at once.
- A stamp further ahead, or one of the first: the sample is held until CONFIRMED samples, it included, have come in order of
  time. If a sample with an earlier stamp comes first, the held one was wild, and is left out.

A real pause, or a clock that was set forward, is confirmed in this way; the samples after it count. A clock that was set back
is noticed too, but order of time cannot be restored: what it stamps is left out until it has caught up.
"""

from collections import deque
from typing import Generic, NamedTuple, Protocol, TypeVar

from pushfric_core.trajectories.ledger import (
    AHEAD,
    OUT_OF_ORDER,
    REPEATED,
    WAITING,
    Account,
    DoubtCode,
    Ledger,
    counted_of,
)

NANOSECONDS = 1e9

CONFIRMED = 3
"""Samples in order that confirm a leap of the stamps. An observation needs as many frames after a pause anyway."""

DISORDER = 1_000_000_000
"""Where only the newest sample counts, one that is late by up to this [ns] was overtaken; a longer step back means that the
clock was reset."""

LEAP = 3
"""A step longer than this multiple of the usual one is a leap."""

LONGEST_END_SKEW = 10.0
"""A stream may end this much before another [s]: nodes do not end at once, and a pusher at rest reports seldom."""

RECENT = 9
"""Number of steps whose median is the usual one: few enough to follow a stream that changes its rate."""

EVEN = 0.1
"""A stream is even if all but EXCEPTIONS of the recent steps differ from the usual one by at most this fraction."""

EXCEPTIONS = 2

LONG = 1.5
"""A step of an even stream that is longer than this multiple of the usual one is a pause."""

MOST_PAUSES = 10_000
"""Pauses that a stream remembers."""


class Pause(NamedTuple):
    """A time without samples."""

    before: int  # stamp of the last sample before it [ns]
    after: int  # stamp of the first sample after it
    lost: bool  # the stream is even, and the pause a whole number of steps: so samples were lost, and the source went on


class Stamped(Protocol):
    """A sample with a stamp [ns]."""

    @property
    def stamp(self) -> int:
        """When it was taken [ns]."""
        ...


Sample = TypeVar("Sample", bound=Stamped)


class Stream(Generic[Sample]):
    """Holds back samples that may be wild, and counts what is left out.

    Args:
        distinct: no two samples have the same stamp, and they may come evenly, as a camera's. Otherwise another one with the
            same stamp counts: a clock stood still.
    Attributes:
        account: of all samples; those that `take` returns are for the caller to end.
        first, last: stamps of the first and the last sample that counts [ns]; None before.
        pauses: the first MOST_PAUSES, in order of time.
    """

    def __init__(self, distinct: bool = True) -> None:
        self._distinct = distinct
        self.account = Account()
        self.pauses: list[Pause] = []
        self.first: int | None = None
        self.last: int | None = None
        self._newest: Sample | None = None  # that counts
        self._held: list[Sample] = []  # in order of time
        self._farthest = {AHEAD: 0, OUT_OF_ORDER: 0}  # how far a stamp was off, at most [ns]
        self._since: dict[str, int] = {}  # when the first one was [ns]
        self._steps: deque[int] = deque(maxlen=RECENT)
        self._far = 0  # the longest step that is not a leap [ns]
        self._fastest = 0  # the least usual step while the stream was even [ns]; 0: it never was

    @property
    def usual(self) -> int:
        """The usual step [ns], at its least if the stream is or was even; 0 until there is one."""
        return self._fastest or self._far // LEAP

    @property
    def even(self) -> bool:
        """Whether the recent steps are alike."""
        recent = self._far // LEAP
        odd = sum(abs(one - recent) > EVEN * recent for one in self._steps)
        return len(self._steps) > EXCEPTIONS >= odd

    def close(self, ledger: Ledger, kind: str, until: int | None) -> None:
        """Enter the account into a ledger, and what was left out as doubts.

        Args:
            ledger: the ledger.
            kind: of the account.
            until: the last stamp of another stream [ns]: a sample that is still held, and later than this by LONGEST_END_SKEW,
                counts as wild.
        """
        account = Account(self.account.received, self.account.ended.copy())
        noted = self._farthest.copy(), self._since.copy()
        for sample in self._held:
            wild = until is not None and self.last is not None and sample.stamp > until + LONGEST_END_SKEW * NANOSECONDS
            account.end(AHEAD if wild else WAITING)
            if wild:
                assert self.last is not None
                self._note(AHEAD, sample.stamp - self.last, self.last)
        ledger.accounts[kind].add(account)
        for reason, code, how in (
            (AHEAD, DoubtCode.STAMPS_AHEAD, "ahead of those that follow"),
            (OUT_OF_ORDER, DoubtCode.STAMPS_BEHIND, "before those that came first"),
        ):
            if number := account.ended[reason]:
                what = counted_of(number, account.received, kind)
                off = f"{'up to ' if number > 1 else ''}{seconds(self._farthest[reason])} {how}"
                off = off if self._farthest[reason] else "like another that came first"
                ledger.doubt(code, f"{what} stamped {off}, and left out", self._since[reason])
        self._farthest, self._since = noted  # more may come, and show that those held count

    def take(self, sample: Sample) -> list[Sample]:
        """Take a sample, and return those that now count, in order of time."""
        self.account.received += 1
        held, stamp = self._held, sample.stamp
        if self.last is not None and not stamp > self.last:
            why = OUT_OF_ORDER if stamp < self.last else self._why_not(sample, self._newest)
            if why is not None:
                return self._left_out(why, self.last - stamp, self.last)
        while held and held[-1].stamp > stamp:
            self.account.end(AHEAD)
            self._note(AHEAD, held.pop().stamp - stamp, stamp if self.last is None else self.last)
        if held and (why := self._why_not(sample, held[-1])) is not None:
            return self._left_out(why, 0, stamp)
        held.append(sample)
        known: list[Sample] = []
        while held and (len(held) >= CONFIRMED or self._follows(held[0].stamp)):
            known.append(held.pop(0))
            self._count(known[-1])
        return known

    def _why_not(self, sample: Sample, other: Sample | None) -> str | None:
        """Why a sample does not count after another one that may have the same stamp; None if it does."""
        if other is None or sample.stamp != other.stamp:
            return None
        if sample == other:
            return REPEATED
        return OUT_OF_ORDER if self._distinct else None

    def _left_out(self, reason: str, off: int, stamp: int) -> list[Sample]:
        self.account.end(reason)
        if reason == OUT_OF_ORDER:
            self._note(reason, off, stamp)
        return []

    def _follows(self, stamp: int) -> bool:
        return self.last is not None and stamp - self.last <= self._far

    def _count(self, sample: Sample) -> None:
        stamp = sample.stamp
        if self.last is None:
            self.first = stamp
        elif step := stamp - self.last:
            whole = abs(step - round(step / (self.usual or step)) * self.usual) <= EVEN * self.usual
            lost = self._distinct and LONG * self.usual < step and whole and self.even
            if (lost or (self._far < step and self._steps)) and len(self.pauses) < MOST_PAUSES:
                self.pauses.append(Pause(self.last, stamp, lost))
            self._steps.append(step)
            recent = sorted(self._steps)[(len(self._steps) - 1) // 2]
            self._far = LEAP * recent
            if self.even:
                self._fastest = min(self.usual, recent)
        self._newest, self.last = sample, stamp

    def _note(self, reason: str, off: int, stamp: int) -> None:
        """Note that a stamp is off by so much, at a time [ns]."""
        self._farthest[reason] = max(self._farthest[reason], off)
        self._since.setdefault(reason, stamp)


def seconds(duration: int) -> str:
    """A duration [ns] in words."""
    return f"{duration * 1e-9:.3f} s"
