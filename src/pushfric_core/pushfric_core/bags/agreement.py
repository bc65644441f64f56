"""Whether the messages in a bag's files are those of one recording: each once, and none missing by their numbers."""

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.bags.contents import LAST_READ, Entries, Standing, Topic, digest

STRANGE = 2**20
"""Numbers that are farther than this from those of the other messages were given by another recorder."""

AMBIGUOUS = 0.25
"""If more of the messages are of another recording, the others may be those of another one."""

COUNTING_SHARE = 0.5
"""If fewer of the numbers follow one another, they do not count messages."""

Integers = npt.NDArray[Any]
Standings = npt.NDArray[np.uint8]


class Numbered(NamedTuple):
    """The messages of a file, and what is known of them so far."""

    entries: Entries
    standings: npt.NDArray[np.uint8]  # is changed
    topics: dict[int, str]  # by channel
    first_numbers: dict[str, int]  # of the topics whose recorder says where it began to count


class Missing(NamedTuple):
    """What the numbers of messages show."""

    by_topic: dict[str, int]  # how many are missing
    twice: dict[str, int]  # how many numbers stand for two different messages
    strangers: list[int]  # files whose messages were numbered by another recorder


def compare(files: Sequence[Numbered], is_listed: bool) -> Missing:
    """Find copies of messages, messages of other recordings, and missing numbers; the first two change their standings.

    Args:
        files: those of the bag.
        is_listed: whether metadata.yaml lists just these files. Then each may have been numbered by itself.
    """
    names = sorted({name for file in files for name in file.topics.values()})
    places = {name: place for place, name in enumerate(names)}
    mixes = np.array([digest(name.encode()) for name in names] or [0], np.uint64)
    topics, keys = [], []
    for file in files:
        table = np.zeros(2**16, np.uint16)
        for channel, name in file.topics.items():
            table[channel] = places[name]
        topics.append(table[np.asarray(file.entries.channels)])
        keys.append(np.asarray(file.entries.digests) ^ mixes[topics[-1]])
    part = np.repeat(np.arange(len(files), dtype=np.uint16), [len(file.entries) for file in files])
    standing = np.concatenate([file.standings for file in files])
    _mark_copies(np.concatenate(keys), standing)
    numbering = _Numbering(
        np.concatenate(topics), np.concatenate([np.asarray(file.entries.sequences) for file in files]), part, standing, names
    )
    found = Missing({}, {}, [])
    recordings = _recordings(files, standing, part)
    sizes = [int((np.isin(part, one) & (standing <= LAST_READ)).sum()) for one in recordings]
    apart = all(len(one) == 1 for one in recordings)  # nothing shows which file is the stranger
    for number, one in enumerate(recordings):
        if number != int(np.argmax(sizes)) and not (is_listed and apart):
            found.strangers.extend(one)
            standing[np.isin(part, one) & (standing <= LAST_READ)] = Standing.UNCHECKED if apart else Standing.FOREIGN
        else:
            numbering.check(one, {name: first for file in one for name, first in files[file].first_numbers.items()}, found)
    begin = 0
    for file in files:
        file.standings[:] = standing[begin : begin + len(file.entries)]
        begin += len(file.entries)
    return found


def _recordings(files: Sequence[Numbered], standing: Standings, part: Integers) -> list[list[int]]:
    """The files, together with those that the same recorder numbered."""
    placed = []
    for index, file in enumerate(files):
        numbers = np.asarray(file.entries.sequences)[standing[part == index] <= LAST_READ]
        if numbers.size:
            placed.append((min(file.first_numbers.values(), default=int(np.median(numbers))), index))
    found: list[list[int]] = []
    last = 0
    for first, index in sorted(placed):
        if not found or first - last > STRANGE or (first == 0) != (last == 0):  # 0: its messages have no numbers
            found.append([])
        found[-1].append(index)
        last = first
    return found


def _mark_copies(key: Integers, standing: Standings) -> None:
    """Of messages that are the same, the one against which the least speaks counts."""
    known = np.flatnonzero(standing < Standing.DOUBLED)
    order = known[np.lexsort((standing[known], key[known]))]
    standing[order[1:][key[order[1:]] == key[order[:-1]]]] = Standing.DOUBLED


class _Numbering(NamedTuple):
    """The messages of all files."""

    topic: Integers  # place in `names`
    number: Integers
    part: Integers
    standing: Standings
    names: list[str]

    def check(self, files: list[int], first: dict[str, int], found: Missing) -> None:
        """Find what is missing in the files of one recording."""
        number, topic = self.number, self.topic
        read = (self.standing <= LAST_READ) & np.isin(self.part, files)
        groups = [group for place in range(len(self.names)) if number[group := read & (topic == place)].any()]
        if not groups:
            return
        apart = sum(_span(number[group]) for group in groups)
        together = not first and len(np.unique(number[read])) == read.sum() and _span(number[read]) < apart
        counting = sum(int(group.sum()) for group in groups if _follow(number[group])) > COUNTING_SHARE * read.sum()
        for group in [read] if together else groups:
            name = "topics that share their numbers" if together else self.names[topic[group][0]]
            chosen = self._near(np.flatnonzero(group), first.get(name), counting)
            by_part = [chosen[self.part[chosen] == one] for one in files if (self.part[chosen] == one).any()]
            ranges = sorted((number[one].min(), number[one].max()) for one in by_part)
            joined = all(before[1] < after[0] for before, after in itertools.pairwise(ranges))
            for one in [chosen] if joined else by_part:
                if not one.size:
                    continue
                values, counts = np.unique(number[one].astype(np.int64), return_counts=True)
                if not _follow(values):
                    continue
                begin = min(first.get(name, values[0]), values[0]) if joined else values[0]
                if gaps := int(values[-1] - begin + 1 - len(values)):
                    found.by_topic[name] = found.by_topic.get(name, 0) + gaps
                if 0 < (counts > 1).mean() < COUNTING_SHARE:
                    found.twice[name] = found.twice.get(name, 0) + int((counts > 1).sum())
                    self.standing[one[np.isin(number[one], values[counts > 1])]] = Standing.FOREIGN

    def _near(self, chosen: Integers, first: int | None, counting: bool) -> Integers:
        """The messages whose numbers are near the first one or, if it is not known, the largest such group; mark the others.

        Args:
            chosen: messages of a topic.
            first: where its recorder began to count; None: not known.
            counting: whether the numbers of most messages of all topics count them.
        """
        numbers = self.number[chosen].astype(np.int64)
        ordered = np.sort(numbers)
        steps = np.diff(ordered)
        edges = [0, *(np.flatnonzero(steps > STRANGE) + 1), len(ordered)]
        if len(edges) == 2 and (first is None or abs(ordered[0] - first) <= STRANGE):
            return chosen
        if first is None and not _follow(numbers):
            if counting:  # those of this topic do, too, but they are too few to show which of them are strange
                self.standing[chosen[self.standing[chosen] == Standing.SOUND]] = Standing.UNCHECKED
            return chosen
        lows = ordered[edges[:-1]]
        number = int(np.argmax(np.diff(edges)) if first is None else np.argmin(np.abs(lows - first)))
        near = (numbers >= lows[number]) & (numbers <= ordered[edges[number + 1] - 1])
        if first is not None and abs(lows[number] - first) > STRANGE:
            near[:] = False
        if first is None and ((~near).mean() > AMBIGUOUS or not near[0]):  # nothing shows which recording is that of the file
            others = np.isin(self.part, self.part[chosen]) & (self.standing == Standing.SOUND)
            self.standing[others] = Standing.UNCHECKED
        self.standing[chosen[~near]] = Standing.FOREIGN
        return np.asarray(chosen[near])


def _follow(numbers: Integers) -> bool:
    """Whether numbers follow one another; otherwise they do not count messages."""
    values = np.unique(np.asarray(numbers).astype(np.int64))
    return len(values) <= 1 or bool((np.diff(values) == 1).mean() >= COUNTING_SHARE)


def _span(numbers: npt.NDArray[np.uint32]) -> int:
    return int(numbers.max()) - int(numbers.min())


def by_topic(entries: Entries, standings: npt.NDArray[np.uint8], topics: Mapping[int, Topic]) -> dict[Standing, Counter[str]]:
    """The number of messages of each standing and topic."""
    found: dict[Standing, Counter[str]] = {one: Counter() for one in Standing}
    pairs = np.asarray(entries.channels).astype(np.uint32) * 16 + standings
    for pair, count in zip(*(each.tolist() for each in np.unique(pairs, return_counts=True)), strict=True):
        channel, standing = divmod(pair, 16)
        found[Standing(standing)][topics[channel].name if channel in topics else UNKNOWN_TOPIC] += count
    return found


UNKNOWN_TOPIC = "a topic that is no longer known"
