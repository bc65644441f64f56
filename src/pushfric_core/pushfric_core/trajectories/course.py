"""The pushes that a stream of pusher states tells of, and what it and the poses lack of them.

Only stamps, ids, and where the tip was are needed. A pause of one stream is a doubt only where it lies in a push, because
between pushes cameras are covered, and pushers at rest report seldom.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from math import gcd
from typing import NamedTuple

import numpy as np

from pushfric_core.geometry.planar import Pose
from pushfric_core.trajectories.following import moved
from pushfric_core.trajectories.ledger import Doubt, DoubtCode
from pushfric_core.trajectories.samples import PoseSample, PusherSample, TrajectoryConfig
from pushfric_core.trajectories.stream import LEAP, LONGEST_END_SKEW, NANOSECONDS, Pause, Stream, seconds
from pushfric_core.wording import counted

WAY = 0.005
"""A tip that has gone no farther than this [m] while no state came has not pushed yet, or no longer pushes."""

RESTS = 0.001
"""A tip that is slower than this [m/s] rests."""

SILENT = 1.0
"""Pusher states may be missing for this long [s] within a push, because the tip moves evenly there."""

SELDOM = 0.25
"""Pusher states come at least this often in a push, on average [s]: where it begins and ends is known within this."""

BEGUN, OVER = 0.1, 0.95
"""The frames of a motion are those between these shares of the object's way in a push."""

MISSED = 2
"""A push lacks observations if its motion gives this many more, and at least twice as many as were made."""

COMMON = 2.0
"""No push is shorter [s]: one may be missing where neither poses nor pusher states come for that long."""

Observations = Callable[[int], int]
"""About how many observations a time [ns] of pushing gives."""


class Planned(NamedTuple):
    """The plan, as far as it is known."""

    begin: int | None = 0  # id of the first push; None: whichever comes first
    number: int | None = None  # of its pushes; None: not known
    left_out: Collection[int] = ()  # ids of pushes that were skipped or given up


UNPLANNED = Planned()
"""No plan is known: a run begins with push 0."""


@dataclass(slots=True)
class Push:
    """A push, by the pusher states with its id, and what the frames between them show of it."""

    push_id: int
    first: "PusherSample"
    last: "PusherSample"
    before: "PusherSample | None"  # the state before the first one
    after: "PusherSample | None" = None  # the state after the last one
    states: int = 1  # with its id
    moving: int = 0  # frames in which the object moves
    way: float = 0.0  # how far the object moved [m]
    made: int = 0  # observations


class Course:
    """Collects the pushes.

    Attributes:
        pushes: in order of time.
    """

    def __init__(self) -> None:
        self.pushes: list[Push] = []
        self._last: PusherSample | None = None
        self._silences: list[Push] = []  # times without a state, or with those of a tip that goes on, but in no push
        self._seen: Push | None = None  # the newest of both that frames show
        self._begin = Pose(0.0, 0.0, 0.0)  # where the object was in the first of these
        self._ways: list[float] = []  # from there to where it is in each of them [m]
        self._tells_speed = False

    def add(self, state: "PusherSample") -> None:
        """Take the next state that counts."""
        before, self._last = self._last, state
        self._tells_speed |= state.speed != 0
        if self.pushes and self.pushes[-1].after is None:
            if state.push_id == self.pushes[-1].last.push_id:
                self.pushes[-1].last = state
                self.pushes[-1].states += 1
                return
            self.pushes[-1].after = state
        if state.push_id is not None:
            self.pushes.append(Push(state.push_id, state, state, before))

    def see(self, before: PusherSample, after: PusherSample, sample: PoseSample, reach: float) -> None:
        """A frame between two states, of an object with corners up to this far from its origin [m]."""
        if before.push_id is not None and before.push_id == after.push_id:
            seen = self.push_at(sample.stamp)
        else:
            goes_on = before.push_id == after.push_id and before.line == after.line and min(before.speed, after.speed) > RESTS
            if not goes_on and after.stamp - before.stamp <= COMMON * NANOSECONDS:
                return
            if not self._silences or self._silences[-1].last not in (before, after):
                self._silences.append(Push(-1, before, after, None))
            seen = self._silences[-1]
            seen.last = after
        if seen is not self._seen:
            self._sum_up()
            self._seen, self._begin, self._ways = seen, sample.pose, []
        self._ways.append(moved(self._begin, sample.pose, reach))

    def _sum_up(self) -> None:
        """Note what the frames so far show."""
        if self._seen is not None:
            ways = np.array(self._ways)
            self._seen.way = far = float(ways.max())
            self._seen.moving = int(np.argmax(ways >= OVER * far) - np.argmax(ways > BEGUN * far))

    def push_at(self, stamp: int) -> Push:
        """The newest push that had begun by then [ns]."""
        return self.pushes[bisect_right(self.pushes, stamp, key=lambda one: one.first.stamp) - 1]

    def doubts(
        self,
        poses: "Stream[PoseSample]",
        states: "Stream[PusherSample]",
        config: "TrajectoryConfig",
        planned: Planned,
        numbered: bool,
        ended: bool,
    ) -> Iterator[Doubt]:
        """Doubts about what the streams lack of the pushes.

        Args:
            poses, states: the streams.
            config: how poses become observations.
            planned: the plan.
            numbered: numbers show that no message is missing: then the camera has dropped what is.
            ended: no more samples follow. Until then, only the plan says which ids are missing between the first push and the
                newest one.
        """
        if poses.last is None or states.last is None:
            return
        self._sum_up()

        def observations(time: int) -> int:
            return max(1, round(time / (poses.usual * config.stride))) if poses.usual else 1

        # what was given up is left out, and need not be whole
        pushes = [one for one in self.pushes if one.push_id not in planned.left_out]
        yield from self._of_poses(pushes, poses, config, observations, planned, numbered, ended)
        # where no state is missing, one came late: the tip was where its neighbours say
        yield from self._of_states(pushes, [] if numbered else states.pauses, observations, planned, ended)
        for one in pushes:
            time = one.last.stamp - one.first.stamp
            if not numbered and time > SELDOM * NANOSECONDS * one.states:
                name = _named([one.push_id], planned)
                text = f"only {counted(one.states, 'pusher state')} came in the {seconds(time)} of {name}"
                yield Doubt(DoubtCode.STATES_MISSING, text, one.first.stamp, observations(time))
        yield from self._of_motion(pushes, config, planned, ended)
        common = _common(poses.pauses, states.pauses)
        for begin, end in common:
            yield Doubt(DoubtCode.BOTH_MISSING, f"neither poses nor pusher states came for {seconds(end - begin)}", begin)
        # where no state is missing, they came late, and somebody may have placed the object meanwhile
        silences = [one for one in self._silences if one.way > WAY and (not numbered or one.first.speed > RESTS)]
        silences = [one for one in silences if not any(one.first.stamp <= begin < one.last.stamp for begin, _ in common)]
        if 2 * len(silences) <= len(self.pushes):  # else this pusher reports no better
            for one in silences:
                begun, way = one.first.stamp, f"the object moved by {1e3 * one.way:.0f} mm"
                text = f"no pusher state tells of a push for {seconds(one.last.stamp - begun)}, in which {way}"
                yield Doubt(DoubtCode.STATES_MISSING, text, begun)
        if self.pushes:
            yield from self._of_ids(observations, planned, ended)
        if poses.last > states.last + LONGEST_END_SKEW * NANOSECONDS:
            text = f"the poses go on for {seconds(poses.last - states.last)} after the last pusher state"
            yield Doubt(DoubtCode.STATES_MISSING, text, states.last)

    def _of_poses(
        self,
        pushes: Sequence[Push],
        stream: "Stream[PoseSample]",
        config: "TrajectoryConfig",
        observations: Observations,
        planned: Planned,
        numbered: bool,
        ended: bool,
    ) -> Iterator[Doubt]:
        """Where no pose came for a part of a push."""
        assert stream.first is not None
        assert stream.last is not None
        pauses = [Pause(-(2**63), stream.first, stream.even), *stream.pauses]
        pauses += [Pause(stream.last, 2**63, stream.even)] if ended else []
        begins, ends = [one.first.stamp for one in pushes], [one.last.stamp for one in pushes]
        dropped, since = 0, 0
        for before, after, lost in pauses:
            limit = (LEAP + 0.5) * stream.usual if lost else config.longest_gap * NANOSECONDS
            if before == stream.last and pushes and pushes[-1].after is None:  # a run that was cut off: its end is missing
                limit = max(limit, SILENT * NANOSECONDS)
            touched = pushes[bisect_right(ends, before) : bisect_left(begins, after)]
            times = [min(after, one.last.stamp) - max(before, one.first.stamp) for one in touched]
            if unseen := [(one.push_id, time) for one, time in zip(touched, times, strict=True) if time > limit]:
                time = sum(time for _, time in unseen)
                text = f"no pose came for {seconds(time)} of {_named([push_id for push_id, _ in unseen], planned)}"
                stamp = max(before, touched[0].first.stamp)
                yield Doubt(DoubtCode.POSES_MISSING, text, stamp, sum(observations(time) for _, time in unseen))
            elif lost and touched:
                dropped, since = dropped + max(0, round(max(times) / stream.usual) - 1), since or before
        if dropped:
            text = f"{counted(dropped, 'pose')} of pushes did not come, one or two at a time, as when a camera drops frames"
            yield Doubt(DoubtCode.POSES_DROPPED, text, since, 0 if numbered else dropped // config.stride)

    def _of_states(
        self, pushes: Sequence[Push], pauses: Sequence[Pause], observations: Observations, planned: Planned, ended: bool
    ) -> Iterator[Doubt]:
        """Pushes whose beginning or end no state shows, and those with a pause."""
        after_pause = {one.after for one in pauses}
        for push in pushes:
            first, last, before, after, name = push.first, push.last, push.before, push.after, _named([push.push_id], planned)
            if before is None:
                late = first.speed > RESTS
            elif first.stamp in after_pause:
                late = _way(before, first) > WAY or abs(before.speed) > RESTS
            else:  # the same motion; an arm may come in any way
                late = before.speed > RESTS and before.line == first.line and _way(before, first) < WAY
            if late:
                text = f"the beginning of {name} is missing: the tip moves already in its first pusher state"
                yield Doubt(DoubtCode.NO_BEGINNING, text, first.stamp)
            if after is None and ended:
                yield Doubt(DoubtCode.NO_END, f"the end of {name} is missing: no pusher state follows", last.stamp)
            elif after is not None and after.stamp in after_pause:
                time = after.stamp - last.stamp
                if (last.speed * time / NANOSECONDS if self._tells_speed else _way(last, after)) > WAY:
                    text = f"the end of {name} is missing: the tip moves on, and no pusher state follows for {seconds(time)}"
                    yield Doubt(DoubtCode.NO_END, text, last.stamp)
        begins = [one.first.stamp for one in pushes]
        for start, end, _ in pauses:
            rank = bisect_right(begins, start) - 1
            if rank >= 0 and end <= pushes[rank].last.stamp and end - start > SILENT * NANOSECONDS:
                text = f"no pusher state came for {seconds(end - start)} of {_named([pushes[rank].push_id], planned)}"
                yield Doubt(DoubtCode.STATES_MISSING, text, start, observations(end - start))
        last_state = self._last
        if ended and self.pushes and last_state is not None and last_state.push_id is None and abs(last_state.speed) > RESTS:
            text = "the pusher moves in the last pusher state: others may be missing"
            yield Doubt(DoubtCode.NO_END, text, last_state.stamp)

    def _of_motion(self, pushes: Sequence[Push], config: "TrajectoryConfig", planned: Planned, ended: bool) -> Iterator[Doubt]:
        """Pushes with fewer observations than the motion of the object gives; of a plan, those with none are known."""
        told = [one for one in pushes if (ended or one.after is not None) and (one.made or planned.number is None)]
        lacking = [(one.moving - config.window) // config.stride - one.made for one in told]
        if few := [(one, number) for one, number in zip(told, lacking, strict=True) if number >= max(MISSED, one.made)]:
            made, lost = sum(one.made for one, _ in few), sum(number for _, number in few)
            names = ", ".join(_named([one.push_id], planned) for one, _ in few)
            text = f"{names} moved the object, but gave {counted(made, 'observation')}, about {lost} too few"
            text = f"{text}: tip or object is not where it is said to be, or too slow"
            yield Doubt(DoubtCode.FEW_OBSERVATIONS, text, few[0][0].first.stamp, lost)

    def _of_ids(self, observations: Observations, planned: Planned, ended: bool) -> Iterator[Doubt]:
        """Pushes that no state tells of, although others have come."""
        usual = int(np.median([one.last.stamp - one.first.stamp for one in self.pushes]))
        ids = [one.push_id for one in self.pushes]
        if not ended:  # what became of the push before the newest one may not be known yet
            ids = ids[:1] if planned.number is None else ids[: max(1, len(ids) - 1)]
        for before, first, last, number in _missing_ids(ids, planned):
            stamp = max((one.last.stamp for one in self.pushes if one.push_id == before), default=self.pushes[0].first.stamp)
            text = f"{_named([first, last], planned)} {'is' if number == 1 else 'are'} missing: the ids of the pushes jump"
            yield Doubt(DoubtCode.PUSHES_MISSING, text, stamp, observations(usual) * number)


def _common(poses: Iterable[Pause], states: Iterable[Pause]) -> list[tuple[int, int]]:
    """The times [ns] in which neither stream has samples, long enough for a push."""
    streams = ([one for one in pauses if one.after - one.before > COMMON * NANOSECONDS] for pauses in (poses, states))
    both = ((max(one.before, other.before), min(one.after, other.after)) for one, other in product(*streams))
    return [(begin, end) for begin, end in both if end - begin > COMMON * NANOSECONDS]


def _missing_ids(ids: Sequence[int], planned: Planned) -> Iterator[tuple[int, int, int, int]]:
    """The ids that are missing from those of some pushes: each time the one before them, the first, the last, and how many.

    The id of a repeated push grows by the number of the plan's pushes, so that smaller ones follow. Where none follows, and the
    plan is not known, a push that is repeated once or twice is taken for its last one. An id that comes again begins another
    run, and so does a smaller one that follows others than repeated pushes.

    Args:
        ids: at least one, in order of time.
        planned: the plan.
    """
    left_out = set(planned.left_out)
    if planned.number is not None:
        ids, left_out = [one % planned.number for one in ids], {one % planned.number for one in left_out}
    begin = (ids[0] if planned.begin is None else planned.begin) - 1
    runs: list[list[int]] = [[begin]]
    seen: set[int] = set()
    for one in ids:
        run = runs[-1]
        rank, larger = bisect_left(run, one), run[bisect_right(run, one) :]
        are_repeats = not larger or (rank and gcd(*(i - run[rank - 1] for i in larger)) > one)
        if not are_repeats or (one in seen and one != run[-1]):
            runs.append([])
            rank, seen = 0, set()
        seen.add(one)
        runs[-1][rank:] = [one]
    for run in runs:
        if planned.number is None:
            for last in run[-3:-1]:
                if last > 0 and all((one - last) % (last + 1) == 0 for one in run if one > last):
                    run = [one for one in run if one <= last]
        for before, after in pairwise(run):
            if number := after - before - 1 - sum(before < one < after for one in left_out):  # there may be billions
                first = next(one for one in range(before + 1, after) if one not in left_out)
                yield before, first, next(one for one in range(after - 1, before, -1) if one not in left_out), number


def _named(ids: Collection[int], planned: Planned) -> str:
    """Pushes that follow each other, for people: in a plan they are counted from 1, without one they have their ids."""
    counted_from = 0 if planned.number is None else 1
    first, last = min(ids) + counted_from, max(ids) + counted_from
    return f"push {first}" if first == last else f"pushes {first} to {last}"


def _way(one: "PusherSample", other: "PusherSample") -> float:
    """How far the tip is in another state from where it was [m]."""
    return float(np.hypot(*(other.tip - one.tip)))
