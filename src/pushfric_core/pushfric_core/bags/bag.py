"""Reading bags: every byte is checked once before the first message is returned, so that what is missing is known."""

import os
import pathlib
import tempfile
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np
import zstandard
from mcap.records import Channel, Schema

from pushfric_core.bags import agreement, parts
from pushfric_core.bags.cdr import Decoder, decoder
from pushfric_core.bags.contents import (
    BEFORE,
    FIRST_NUMBER,
    LAST_READ,
    LAST_SAVED,
    BagMessage,
    Definition,
    Entries,
    Standing,
    Summary,
    Topic,
    in_order,
)
from pushfric_core.bags.mcap_file import UNCONFIRMED, Gap, McapFile, Span, Standings
from pushfric_core.bags.mcap_records import HELD_LIMIT, definition_of
from pushfric_core.bags.offered_qos import profiles_from
from pushfric_core.bags.rosbag2_metadata import METADATA, BagMetadata, embedded_metadata, read_metadata
from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.wording import counted

PathLike = str | os.PathLike[str]

FILE_LIMIT = 16 * 2**30
"""Largest size of a compressed file after decompression [bytes]."""

RATIO_LIMIT = 1000
"""No recording of 256 MiB or more is compressed by more than this."""


class DamagedBag(PushfricError):
    """Messages are missing from a bag."""


class FileGap(NamedTuple):
    """A gap in one of a bag's files."""

    file: pathlib.Path
    gap: Gap


@dataclass(frozen=True)
class Damage:
    """What is wrong with a bag."""

    gaps: tuple[FileGap, ...]  # bytes that cannot be trusted
    missing: dict[str, int] | None  # messages that cannot be read, by topic; None: the bag does not say how many it had
    unconfirmed: dict[str, int]  # those of them that are intact, though the checksum of their chunk fails
    foreign: dict[str, int]  # messages of another recording, which are not read
    doubled: dict[str, int]  # copies of messages, which are not read either
    contradictions: tuple[str, ...]  # between what the bag says and what it holds

    @property
    def loses_messages(self) -> bool:
        """Whether a message is missing, or may be."""
        return bool(self.missing or self.foreign or self.contradictions) or self.missing is None


class StoredFile(Protocol):
    """One file of a bag, whatever its format."""

    path: pathlib.Path
    gaps: list[Gap]
    doubts: list[str]  # why messages may be missing, or differ from what was written
    topics: dict[int, Topic]  # by channel
    entries: Entries  # of all its messages
    standings: Standings  # of each of them
    embedded: BagMetadata | None  # what it says of its bag
    library: str  # that wrote it; empty if it does not say
    first_numbers: dict[str, int]  # of each topic, where its recorder began to count messages
    held: list[tuple[int, int, int]]  # what is held in memory when, in order: first and last log time [ns], bytes

    @property
    def expected(self) -> Mapping[str, int] | None:
        """Messages of each topic according to the file; None if it does not say."""
        ...

    def read(self, topics: Collection[str] | None, unconfirmed: bool) -> Iterator[BagMessage]:
        """Messages by log time."""
        ...


class Bag:
    """A bag, read through once to find what it contains and what is lost.

    Args:
        path: a folder as rosbag2 writes it, or one of its files.
        ignore_metadata: take the files in the folder, whatever its metadata.yaml says.
    Attributes:
        path: the argument.
        summary: what can be read.
        damage: what is wrong; None if the bag is whole.
        notes: what cannot be known, and what was lost before the bag was recovered; not damage.
        lost: what is not in the bag, or may not be, in words; without what is missing from its files.
        standings: the number of messages of each topic in the files by what speaks against them.
    Raises:
        InvalidInput: `path` is not a bag, cannot be read, contains messages that are not of ROS 2, or needs more memory than
            the limit.
    """

    def __init__(self, path: PathLike, ignore_metadata: bool = False) -> None:
        self.path = pathlib.Path(path)
        self._decompressed: tempfile.TemporaryDirectory[str] | None = None
        metadata = None if ignore_metadata else read_metadata(self.path)
        self._compressed_messages = metadata is not None and metadata.compression_mode == "message"
        found = parts.parts_of(self.path, metadata)
        self._files = self._opened(found.files)
        self._check_held()
        numbers = agreement.compare(
            [agreement.Numbered(file.entries, file.standings, {n: topic.name for n, topic in file.topics.items()},
                                file.first_numbers) for file in self._files],
            metadata is not None and found.complete,
        )  # fmt: skip
        for file in self._files:
            _mark_surplus([file], file.expected)
        if any(file.expected is None for file in self._files):  # else metadata.yaml contradicts counts that all messages fit
            _mark_surplus(self._files, None if metadata is None else metadata.by_topic)
        counts = [agreement.by_topic(file.entries, file.standings, file.topics) for file in self._files]
        unsettled = [*found.doubts, *self._compared(found.files, counts, metadata)]
        for file, path in zip(self._files, found.files, strict=True):
            if any(path in doubt.files for doubt in unsettled):
                file.standings[file.standings == Standing.SOUND] = Standing.UNCHECKED
        counts = [agreement.by_topic(file.entries, file.standings, file.topics) for file in self._files]
        self.standings = {one: sum((count[one] for count in counts), Counter[str]()) for one in Standing}
        self.summary = self._summary(counts)
        doubts = [*(doubt.text for doubt in unsettled), *self._apart(found.apart), *self._doubts(numbers)]
        self.damage = self._damage(metadata, found.complete, numbers.by_topic, doubts)
        said = [metadata, *(file.embedded for file in self._files)]
        texts = {" ".join(one.custom[BEFORE].split())[:500] for one in said if one is not None and BEFORE in one.custom}
        self.notes = (
            *(f"{self.path}: {text}" for text in found.notes),
            *(f"{self.path} was recovered; before that, {text}" for text in sorted(texts)),
        )
        self.lost = (*sorted(texts), *found.notes, *(doubt.text for doubt in unsettled if not doubt.files))
        self._decoders: dict[str, Decoder] = {}
        self._definitions = {topic.type_name: topic.definition for topic in self.summary.topics}

    def require_whole(self) -> None:
        """Refuse a bag from which messages are missing.

        Raises:
            DamagedBag: messages are missing; one line says which.
        """
        if self.damage is not None and self.damage.loses_messages:
            raise DamagedBag(f"{self.what_is_missing()}; --partial goes on with what there is, `pushfric bag verify` says more")

    @property
    def doubtful(self) -> Counter[str]:
        """The messages of each topic that can be read or saved, though nothing confirms them."""
        return sum((self.standings[one] for one in Standing if Standing.SOUND < one <= LAST_SAVED), Counter[str]())

    @property
    def doubts(self) -> tuple[str, ...]:
        """Contradictions, one line each; empty if the bag is whole."""
        return () if self.damage is None else (self.what_is_missing(with_places=False), *self.damage.contradictions)

    def what_is_missing(self, with_places: bool = True) -> str:
        """A line that says how many messages of which topics are missing and, with places, when."""
        assert self.damage is not None
        gaps, missing, contradictions = self.damage.gaps, self.damage.missing, self.damage.contradictions
        surplus = [
            f"{sum(counts.values())} messages {what}: {each(counts)}"
            for counts, what in ((self.damage.foreign, "are of another recording"), (self.damage.doubled, "are copies"))
            if counts
        ]
        if missing:
            count = sum(missing.values())
            said = f"{count} of {count + self.summary.message_count} messages are missing: {each(missing)}"
        elif missing is None:
            said = f"an unknown number of messages is missing, {self.summary.message_count} can be read"
        elif contradictions and with_places:
            said = contradictions[0] + (f" (and {len(contradictions) - 1} more doubts)" if contradictions[1:] else "")
        elif contradictions:
            said = "what it says contradicts what it holds"
        else:
            said = "no message is missing"
        spans = "; ".join(f"{one.file.name}: {one.gap.reason}, {self.when(one.gap)}" for one in gaps[:3])
        more = f" and {len(gaps) - 3} more places" if len(gaps) > 3 else ""
        places = f" ({spans}{more})" if gaps and with_places else ""
        return f"{self.path}: the bag is damaged, {'; '.join([said, *surplus])}{places}"

    def when(self, gap: Gap) -> str:
        """The time that a gap covers, counted from the beginning of the bag."""
        start = self.summary.start_ns
        after = "from the beginning" if gap.after_ns is None else f"from {(gap.after_ns - start) * 1e-9:.3f} s"
        before = "to the end" if gap.before_ns is None else f"to {(gap.before_ns - start) * 1e-9:.3f} s"
        return f"{after} {before}"

    def messages(
        self,
        topics: Collection[str] | None = None,
        start_ns: int | None = None,
        end_ns: int | None = None,
        unconfirmed: bool = False,
    ) -> Iterator[BagMessage]:
        """All messages that can be read, in order of log time; those of the same time in the order they were written.

        Args:
            topics: full names of the topics to read; None: all.
            start_ns: first log time to read.
            end_ns: first log time not to read.
            unconfirmed: also those that are intact in chunks whose checksum fails, and those of another recording.
        Raises:
            InvalidInput: a file can no longer be read.
        """
        for message in in_order(
            (file.held[0][0], rank, partial(self._read, file, topics, unconfirmed))
            for rank, file in enumerate(self._files)
            if file.held
        ):
            if end_ns is not None and message.log_time_ns >= end_ns:
                return
            if start_ns is None or message.log_time_ns >= start_ns:
                yield message

    def deserialize(self, message: BagMessage) -> Any:
        """The content of a message: an object with an attribute for each field of its type.

        Raises:
            InvalidInput: the definition of its type cannot be used.
            ValueError: its bytes are not such a message.
        """
        name = message.type_name
        if name not in self._decoders:
            self._decoders[name] = decoder(name, self._definitions.get(name, Definition("", "")))
        return self._decoders[name](message.raw)

    def unconfirmed(self, standing: Standing) -> dict[str, Span]:
        """The messages of each topic that have this standing: how many, and from when to when."""
        found: dict[str, Span] = {}
        for file in self._files:
            for topic, span in _spans(file, file.standings == standing):
                found[topic] = span.joined(found[topic]) if topic in found else span
        return found

    def _read(self, file: StoredFile, topics: Collection[str] | None, unconfirmed: bool) -> Iterator[BagMessage]:
        try:
            for message in file.read(topics, unconfirmed):
                if self._compressed_messages:
                    message = message._replace(raw=_decompressed(message.raw, file.path))
                yield message
        except OSError as error:
            raise InvalidInput(f"{file.path}: cannot be read: {error.strerror}") from error

    def _opened(self, files: Sequence[pathlib.Path]) -> list[StoredFile]:
        opened, count = [], 0
        for file in files:
            opened.append(self._open(file))
            count += len(opened[-1].entries)
            if count * Entries.SIZE > HELD_LIMIT:
                raise InvalidInput(f"{self.path}: holds more messages than the limit of {HELD_LIMIT // Entries.SIZE}")
        return opened

    def _check_held(self) -> None:
        """Refuse a bag of which too much would be held in memory at once.

        Raises:
            InvalidInput: its chunks overlap too much.
        """
        events = []
        for rank, file in enumerate(self._files):
            for number, (start, end, size) in enumerate(file.held):
                events += [(start, rank, number, size), (end, rank, number + 0.5, -size)]
        held = 0
        for time, _, _, size in sorted(events):
            held += size
            if held > HELD_LIMIT:
                when = (time - min(event[0] for event in events)) * 1e-9
                what = f"chunks that overlap at {when:.3f} s take {held} bytes"
                raise InvalidInput(f"{self.path}: {what}, more than the limit of {HELD_LIMIT}")

    def _apart(self, files: Sequence[pathlib.Path]) -> list[str]:
        """What is said of files that do not belong to the bag."""
        doubts = []
        for path in files:
            try:
                held = f"{len(self._open(path).entries)} messages"
            except InvalidInput as error:
                held = f"what cannot be read: {str(error)[:200]}"
            doubts.append(f"{METADATA} does not list {path.name}, which lies in the folder and holds {held}; it is not read")
        return doubts

    def _doubts(self, numbers: agreement.Missing) -> list[str]:
        """What is said of the messages that are read though nothing confirms them."""
        doubts = [f"{file.path.name}: {doubt}" for file in self._files for doubt in file.doubts]
        strangers = (self._files[number].path.name for number in numbers.strangers)
        doubts += [f"{name}: its messages were numbered by another recorder than those of others" for name in strangers]
        for topic, count in numbers.twice.items():
            doubts.append(f"{counted(count, 'number')} of messages of {topic[:80]} {'is' if count == 1 else 'are'} used twice")
        for standing in (Standing.MARKED, Standing.UNCHECKED):
            for topic, (count, first, last) in self.unconfirmed(standing).items():
                start = self.summary.start_ns
                when = f"from {(first - start) * 1e-9:.3f} s to {(last - start) * 1e-9:.3f} s"
                what = f"{counted(count, 'message')} of {' '.join(topic.split())[:80]}"
                doubts.append(f"{what}, {when}, may not be what was recorded: {standing.doubt}")
        return doubts

    def _summary(self, counts: list[dict[Standing, Counter[str]]]) -> Summary:
        topics: dict[tuple[str, str], Topic] = {}
        for file in self._files:
            number_of = Counter(np.asarray(file.entries.channels)[file.standings <= LAST_READ].tolist())
            for channel, found in file.topics.items():
                topic = replace(found, message_count=number_of[channel])
                known = topics.get((topic.name, topic.type_name))
                if known is not None:  # known from an earlier file of the bag, or from another publisher
                    if known.definition.text != topic.definition.text:
                        raise InvalidInput(f"{file.path}: {topic.name} has two definitions of {topic.type_name}, expected one")
                    profiles = known.qos_profiles + tuple(qos for qos in topic.qos_profiles if qos not in known.qos_profiles)
                    count = known.message_count + topic.message_count
                    topic = replace(topic, qos_profiles=profiles, message_count=count)
                topics[topic.name, topic.type_name] = topic
        times = [np.asarray(file.entries.log_times)[file.standings <= LAST_READ] for file in self._files]
        start = min((int(one.min()) for one in times if one.size), default=0)
        end = max((int(one.max()) for one in times if one.size), default=0)
        return Summary(tuple(topics.values()), start, end)

    def _damage(
        self, metadata: BagMetadata | None, complete: bool, absent: dict[str, int], contradictions: list[str]
    ) -> Damage | None:
        """What is wrong.

        Args:
            metadata: of the bag.
            complete: whether the files are those that it lists.
            absent: of each topic, how many numbers of messages are absent.
            contradictions: those known so far.
        """
        gaps = tuple(FileGap(file.path, gap) for file in self._files for gap in file.gaps)
        found = sum((self.standings[one] for one in Standing if one <= LAST_READ), Counter[str]())
        missing: dict[str, int] | None = None
        expected_of_files = [file.expected for file in self._files]
        if all(expected is not None for expected in expected_of_files):
            expected: Counter[str] = Counter()
            for counts in expected_of_files:
                expected.update(counts or {})
            missing = _compared(expected, found, "the files say they hold", contradictions)
        if metadata is not None:
            of_metadata = _compared(Counter(metadata.by_topic), found, f"{METADATA} says the bag holds", contradictions)
            held = sum(found.values()) + sum((of_metadata if missing is None or not complete else missing).values())
            if metadata.message_count != held:
                contradictions.append(f"{METADATA} says the bag holds {metadata.message_count} messages, but it held {held}")
            if complete and missing not in (None, of_metadata):
                contradictions.append(f"{METADATA} and the files say different numbers of messages")
            if missing is None:
                missing = of_metadata
            elif not complete:
                missing = dict(Counter(missing) | Counter(of_metadata))
        if missing is None and not gaps:
            missing = {}  # nothing in the bag says how many there were, and nothing is damaged
        if missing is not None:
            missing = dict(Counter(missing) | Counter(absent))
        foreign, doubled = (dict(self.standings[one]) for one in (Standing.FOREIGN, Standing.DOUBLED))
        if not (gaps or missing or contradictions or foreign or doubled):
            return None
        return Damage(gaps, missing, dict(self.standings[Standing.SALVAGED]), foreign, doubled, tuple(contradictions))

    def _compared(
        self, files: Sequence[pathlib.Path], counts: list[dict[Standing, Counter[str]]], metadata: BagMetadata | None
    ) -> list[parts.Doubt]:
        covered = []
        for path, file, count in zip(files, self._files, counts, strict=True):
            times = np.asarray(file.entries.log_times)[file.standings <= LAST_READ]
            held = sum(count[one].total() for one in Standing if one <= LAST_READ)
            expected = held if not file.gaps else None
            if file.expected is not None:
                expected = sum(file.expected.values())
            times.sort()
            start, end = (int(times[0]), int(times[-1])) if times.size else (0, 0)
            pause = int(np.diff(times).max()) if times.size > 1 else 0
            covered.append(parts.Covered(path, held, expected, start, end, pause, file.library, file.embedded))
        return parts.compared(covered, metadata if self.path.is_dir() else None)

    def _open(self, file: pathlib.Path) -> StoredFile:
        try:
            if file.suffix == ".zstd":
                file = self._decompress(file)
            if McapFile.recognized(file):
                return _McapBagFile(file)
            with file.open("rb") as stream:
                is_sqlite = stream.read(len(SQLITE_MAGIC)) == SQLITE_MAGIC
        except OSError as error:
            raise InvalidInput(f"{file}: cannot be read: {error.strerror}, expected a bag") from error
        except MemoryError as error:
            raise InvalidInput(f"{file}: there is not enough memory to read it") from error
        except ValueError as error:
            raise InvalidInput(f"{str(file)!r}: cannot be read: {error}, expected a bag") from error
        if not is_sqlite:
            raise InvalidInput(f"{file}: is neither an MCAP file nor a database, expected a bag's folder or one of its files")
        from pushfric_core.bags.sqlite_file import SqliteFile  # imported late: it loads SQLite, which few bags need

        return SqliteFile(file)

    def _decompress(self, file: pathlib.Path) -> pathlib.Path:
        """A decompressed copy of a file, within limits, in a temporary folder that is removed with this object."""
        if self._decompressed is None:
            self._decompressed = tempfile.TemporaryDirectory(prefix="pushfric-bag-")
        copy = pathlib.Path(self._decompressed.name) / file.stem
        size, limit = 0, min(FILE_LIMIT, HELD_LIMIT + RATIO_LIMIT * file.stat().st_size)
        try:
            with file.open("rb") as stream, copy.open("wb") as out:
                for block in zstandard.ZstdDecompressor().read_to_iter(stream):
                    size += len(block)
                    if size > limit:
                        raise InvalidInput(f"{file}: holds more than the limit of {limit} bytes")
                    out.write(block)
        except zstandard.ZstdError as error:
            if not size:
                raise InvalidInput(f"{file}: cannot be decompressed: {error}") from error
        return copy  # if it is cut short, so is the file in it


SQLITE_MAGIC = b"SQLite format 3\0"


class _McapBagFile:
    """An MCAP file as rosbag2 writes it."""

    def __init__(self, path: pathlib.Path) -> None:
        self._file = file = McapFile(path)
        self.path, self.gaps, self.library = path, file.gaps, file.library
        self.entries, self.standings = file.entries, file.standings
        pieces = sorted(file.pieces, key=lambda piece: (piece.start_ns, piece.begin))
        self.held = [(piece.start_ns, piece.end_ns, piece.size) for piece in pieces]
        self.topics: dict[int, Topic] = {}
        self.first_numbers: dict[str, int] = {}
        for number, channel in file.channels.items():
            schema = file.schemas.get(channel.schema_id)
            if schema is not None or not file.gaps:  # the schema may have been lost
                self.topics[number] = _topic(path, channel, schema)
                if (first := channel.metadata.get(FIRST_NUMBER, "")).isascii() and first.isdecimal() and len(first) < 11:
                    self.first_numbers[channel.topic] = int(first)
            else:
                self.standings[np.asarray(file.entries.channels) == number] = Standing.UNKNOWN
        self._marks = {
            number: " ".join(channel.metadata.get(UNCONFIRMED, "").split())[:200] for number, channel in file.channels.items()
        }
        texts = [texts.get("serialized_metadata", "") for name, texts in file.metadata if name == "rosbag2"]
        self.embedded = embedded_metadata(path.parent, texts[-1]) if texts else None
        self.doubts: list[str] = []

    @property
    def expected(self) -> Mapping[str, int] | None:
        statistics = self._file.statistics
        if statistics is None:
            return None
        by_topic: Counter[str] = Counter()
        for number, count in statistics.channel_message_counts.items():
            by_topic[self.topics[number].name if number in self.topics else agreement.UNKNOWN_TOPIC] += count
        if not by_topic:  # a writer may count all messages, but not channel by channel
            for standing, counts in agreement.by_topic(self.entries, self.standings, self.topics).items():
                if standing <= LAST_READ:
                    by_topic += counts
        if (more := statistics.message_count - by_topic.total()) > 0:
            by_topic[agreement.UNKNOWN_TOPIC] += more
        return by_topic

    def read(self, topics: Collection[str] | None, unconfirmed: bool) -> Iterator[BagMessage]:
        wanted = {n: t for n, t in self.topics.items() if topics is None or t.name in topics}
        for message in self._file.messages(wanted.__contains__, unconfirmed):
            topic = wanted[message.channel_id]
            doubt = ""
            if message.standing:  # not sound
                marked = message.standing == Standing.MARKED
                doubt = (marked and self._marks[message.channel_id]) or message.standing.doubt
            yield BagMessage(topic.name, topic.type_name, message.log_time_ns, message.data, doubt)


def _mark_surplus(files: Sequence[StoredFile], said: Mapping[str, int] | None) -> None:
    """If there are more messages of a topic than are said, nothing shows which of them are right."""
    if said is None:
        return
    held: Counter[str] = Counter()
    for file in files:
        for standing, counts in agreement.by_topic(file.entries, file.standings, file.topics).items():
            held += counts if standing <= LAST_READ else Counter()
    for file in files:
        surplus = [number for number, topic in file.topics.items() if held[topic.name] > said.get(topic.name, 0)]
        file.standings[np.isin(file.entries.channels, surplus) & (file.standings == Standing.SOUND)] = Standing.UNCHECKED


def _spans(file: StoredFile, chosen: "np.ndarray[Any, np.dtype[np.bool_]]") -> Iterator[tuple[str, Span]]:
    """Some messages of a file by topic: how many, and from when to when."""
    channels, times = np.asarray(file.entries.channels), np.asarray(file.entries.log_times)
    for channel in np.unique(channels[chosen]).tolist():
        if channel in file.topics:
            when = times[chosen & (channels == channel)]
            yield file.topics[channel].name, Span(len(when), int(when.min()), int(when.max()))


def each(counts: dict[str, int]) -> str:
    """Numbers of messages by topic, in words."""
    return ", ".join(f"{count} of {' '.join(topic.split())[:80]}" for topic, count in counts.items())


def _topic(file: pathlib.Path, channel: Channel, schema: Schema | None) -> Topic:
    where = f"{file}: {channel.topic[:80]}"
    if channel.message_encoding != "cdr":
        raise InvalidInput(f"{where} is encoded as {channel.message_encoding[:80]!r}, expected ROS 2 messages (cdr)")
    if schema is None:
        raise InvalidInput(f"{where} has no type, expected that of a ROS 2 message")
    try:
        profiles = profiles_from(channel.metadata.get("offered_qos_profiles", ""))
    except ValueError as error:
        raise InvalidInput(f"{where} has QoS profiles that are not those of rosbag2: {error}") from error
    return Topic(channel.topic, schema.name, profiles, channel.metadata.get("topic_type_hash", ""), 0, definition_of(schema))


def _compared(expected: Counter[str], found: Counter[str], said: str, contradictions: list[str]) -> dict[str, int]:
    """Number of missing messages by topic; more messages than expected are a contradiction."""
    for name, count in found.items():
        if count > expected[name]:
            contradictions.append(f"{said} {expected[name]} messages of {name}, but there are {count}")
    return {name: count - found[name] for name, count in expected.items() if count > found[name]}


def _decompressed(raw: bytes, file: pathlib.Path) -> bytes:
    try:
        declared = zstandard.frame_content_size(raw)
        if declared > HELD_LIMIT:
            raise InvalidInput(f"{file}: a message of {declared} bytes is larger than the limit of {HELD_LIMIT}")
        return zstandard.ZstdDecompressor().decompress(raw, max_output_size=HELD_LIMIT if declared < 0 else 0)
    except zstandard.ZstdError as error:
        raise InvalidInput(f"{file}: a message cannot be decompressed: {error}") from error
