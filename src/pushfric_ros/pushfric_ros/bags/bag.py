"""Reading bags: every byte is checked once before the first message is returned, so that what is missing is known."""

import heapq
import os
import pathlib
import tempfile
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import zstandard

from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.wording import counted
from pushfric_ros.bags.cdr import Decoder, Definition
from pushfric_ros.bags.contents import BagMessage, Summary, Topic
from pushfric_ros.bags.mcap_file import Gap, McapFile, Span, joined
from pushfric_ros.bags.mcap_records import Channel, Schema
from pushfric_ros.bags.offered_qos import profiles_from
from pushfric_ros.bags.rosbag2_metadata import METADATA, BagMetadata, read_metadata
from pushfric_ros.files.bounded_yaml import load_yaml
from pushfric_ros.messages.types import message_class, type_hash

PathLike = str | os.PathLike[str]

FILE_LIMIT = 16 * 2**30
"""Largest size of a compressed file after decompression [bytes]."""

MESSAGE_LIMIT = 256 * 2**20
"""Largest size of a compressed message after decompression [bytes]."""


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
    contradictions: tuple[str, ...]  # between what the bag says and what it holds

    @property
    def loses_messages(self) -> bool:
        """Whether a message is missing, or may be."""
        return bool(self.missing or self.contradictions) or self.missing is None


class StoredFile(Protocol):
    """One file of a bag, whatever its format."""

    path: pathlib.Path
    gaps: list[Gap]
    doubts: list[str]  # why messages that are read may differ from what was written
    unconfirmed: Mapping[str, Span]  # messages intact in damaged chunks, by topic; they are read only if asked for
    marked: Mapping[str, Span]  # messages that `bag recover` marked as unconfirmed, by topic; they are read
    start_ns: int
    end_ns: int

    @property
    def topics(self) -> list[Topic]:
        """Its topics, one or more times each."""
        ...

    @property
    def expected(self) -> dict[str, int] | None:
        """Number of messages of each topic according to the file; None if it does not say."""
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
    Raises:
        InvalidInput: `path` is not a bag, cannot be read, or contains messages that are not of ROS 2.
    """

    def __init__(self, path: PathLike, ignore_metadata: bool = False) -> None:
        self.path = pathlib.Path(path)
        self._decompressed: tempfile.TemporaryDirectory[str] | None = None
        metadata = None if ignore_metadata else read_metadata(self.path)
        self._compressed_messages = metadata is not None and metadata.compression_mode == "message"
        self._files = [self._open(file, metadata) for file in bag_files(self.path, metadata)]
        self.summary = _summary(self._files)
        self.damage = _damage(self._files, self.summary, metadata)
        self._decoders: dict[str, Decoder] = {}
        self._definitions = {topic.type_name: topic.definition for topic in self.summary.topics}

    def require_whole(self) -> None:
        """Refuse a bag from which messages are missing.

        Raises:
            DamagedBag: messages are missing; one line says which.
        """
        if self.damage is not None and self.damage.loses_messages:
            raise DamagedBag(f"{self.what_is_missing()}; --partial goes on with what there is, `pushfric bag verify` says more")

    def what_is_missing(self, with_places: bool = True) -> str:
        """A line that says how many messages of which topics are missing and, with places, when."""
        assert self.damage is not None
        gaps, missing, contradictions = self.damage.gaps, self.damage.missing, self.damage.contradictions
        if missing:
            count = sum(missing.values())
            each = ", ".join(f"{number} of {topic}" for topic, number in missing.items())
            said = f"{count} of {count + self.summary.message_count} messages are missing: {each}"
        elif missing is None:
            said = f"an unknown number of messages is missing, {self.summary.message_count} can be read"
        elif contradictions and with_places:
            said = contradictions[0]
        elif contradictions:
            said = "what it says contradicts what it holds"
        else:
            said = "no message is missing"
        spans = "; ".join(f"{one.file.name}: {one.gap.reason}, {self.when(one.gap)}" for one in gaps[:3])
        more = f" and {len(gaps) - 3} more places" if len(gaps) > 3 else ""
        return f"{self.path}: the bag is damaged, {said}" + (f" ({spans}{more})" if gaps and with_places else "")

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
            unconfirmed: also those that are intact in chunks whose checksum fails.
        Raises:
            InvalidInput: a file can no longer be read.
        """
        for message in heapq.merge(
            *(self._read(file, topics, unconfirmed) for file in self._files), key=lambda message: message.log_time_ns
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
            self._decoders[name] = Decoder(name, self._definitions.get(name, Definition("", "")))
        return self._decoders[name](message.raw)

    def unconfirmed(self, in_chunks: bool) -> dict[str, Span]:
        """The messages of each topic that no sound checksum covers: those marked by `recover`, and those in damaged chunks.

        Args:
            in_chunks: count the latter, too.
        """
        marked = [item for file in self._files for item in file.marked.items()]
        return joined(marked + [item for file in self._files for item in file.unconfirmed.items() if in_chunks])

    def _read(self, file: StoredFile, topics: Collection[str] | None, unconfirmed: bool) -> Iterator[BagMessage]:
        try:
            for message in file.read(topics, unconfirmed):
                if self._compressed_messages:
                    message = message._replace(raw=_decompressed(message.raw, file.path))
                yield message
        except OSError as error:
            raise InvalidInput(f"{file.path}: cannot be read: {error.strerror}") from error

    def _open(self, file: pathlib.Path, metadata: BagMetadata | None) -> StoredFile:
        try:
            if file.suffix == ".zstd":
                file = self._decompress(file)
            if McapFile.recognized(file):
                return _McapBagFile(file)
            with file.open("rb") as stream:
                is_sqlite = stream.read(len(SQLITE_MAGIC)) == SQLITE_MAGIC
        except OSError as error:
            raise InvalidInput(f"{file}: cannot be read: {error.strerror}, expected a bag") from error
        except ValueError as error:
            raise InvalidInput(f"{str(file)!r}: cannot be read: {error}, expected a bag") from error
        if not is_sqlite:
            raise InvalidInput(f"{file}: is neither an MCAP file nor a database, expected a bag's folder or one of its files")
        from pushfric_ros.bags.sqlite_file import SqliteFile  # imported late: it loads SQLite, which few bags need

        return SqliteFile(file)

    def _decompress(self, file: pathlib.Path) -> pathlib.Path:
        """A decompressed copy of a file, within limits, in a temporary folder that is removed with this object."""
        if self._decompressed is None:
            self._decompressed = tempfile.TemporaryDirectory(prefix="pushfric-bag-")
        copy = pathlib.Path(self._decompressed.name) / file.stem
        size = 0
        try:
            with file.open("rb") as stream, copy.open("wb") as out:
                for block in zstandard.ZstdDecompressor().read_to_iter(stream):
                    size += len(block)
                    if size > FILE_LIMIT:
                        raise InvalidInput(f"{file}: holds more than the limit of {FILE_LIMIT} bytes")
                    out.write(block)
        except zstandard.ZstdError as error:
            if not size:
                raise InvalidInput(f"{file}: cannot be decompressed: {error}") from error
        return copy  # if it is cut short, so is the file in it


SQLITE_MAGIC = b"SQLite format 3\0"


def bag_files(path: pathlib.Path, metadata: BagMetadata | None) -> list[pathlib.Path]:
    """The files of a bag: those that its metadata lists, those in its folder, or the one file that is given.

    Raises:
        InvalidInput: the folder holds no files of a bag.
    """
    if metadata is not None:
        return list(metadata.files)
    if not os.path.isdir(path):
        return [path]
    for pattern in ("*.mcap", "*.mcap.zstd", "*.db3", "*.db3.zstd"):
        if files := sorted(path.glob(pattern)):
            return files
    raise InvalidInput(f"{path}: is not a bag, expected {METADATA}, or an .mcap or .db3 file in it")


def recorded_class(topic: Topic) -> type:
    """The installed class of a recorded topic.

    Raises:
        InvalidInput: the type is not installed, or not with the definition that the bag was recorded with.
    """
    installed = message_class(topic.type_name)
    if topic.type_hash and topic.type_hash != type_hash(topic.type_name):
        raise InvalidInput(f"{topic.name}: was recorded with another definition of {topic.type_name} than the one installed")
    return installed


class _McapBagFile:
    """An MCAP file as rosbag2 writes it."""

    def __init__(self, path: pathlib.Path) -> None:
        self._file = file = McapFile(path)
        self.path, self.gaps, self.start_ns, self.end_ns = path, file.gaps, file.start_ns, file.end_ns
        self.marked: Mapping[str, Span] = file.marked
        self.doubts = ["messages may not be what was recorded"] if file.doubtful else []
        for topic, span in file.marked.items():
            when = f"from {(span.first_ns - file.start_ns) * 1e-9:.3f} s to {(span.last_ns - file.start_ns) * 1e-9:.3f} s"
            self.doubts.append(
                f"{counted(span.messages, 'message')} of {' '.join(topic.split())[:80]}, {when}, may not be what was recorded:"
                " saved from a chunk that failed its checksum"
            )
        self._topics: dict[int, Topic] = {}
        for number, channel in file.channels.items():
            schema = file.schemas.get(channel.schema_id)
            if schema is not None or not file.gaps:  # the schema may have been lost
                self._topics[number] = _topic(path, channel, schema, file.counts[number])
        known = [(topic.name, file.unconfirmed[number]) for number, topic in self._topics.items() if number in file.unconfirmed]
        self.unconfirmed: Mapping[str, Span] = joined(known)

    @property
    def topics(self) -> list[Topic]:
        return list(self._topics.values())

    @property
    def expected(self) -> dict[str, int] | None:
        statistics = self._file.statistics
        if statistics is None:
            return None
        by_topic: dict[str, int] = {}
        for number, count in statistics.by_channel.items():
            name = self._topics[number].name if number in self._topics else _UNKNOWN
            by_topic[name] = by_topic.get(name, 0) + count
        if not by_topic:  # a writer may count all messages, but not channel by channel
            for topic in self._topics.values():
                by_topic[topic.name] = by_topic.get(topic.name, 0) + topic.message_count
        if statistics.messages > sum(by_topic.values()):
            by_topic[_UNKNOWN] = by_topic.get(_UNKNOWN, 0) + statistics.messages - sum(by_topic.values())
        return by_topic

    def read(self, topics: Collection[str] | None, unconfirmed: bool) -> Iterator[BagMessage]:
        wanted = {n: t for n, t in self._topics.items() if topics is None or t.name in topics}
        for message in self._file.messages(wanted.__contains__, unconfirmed):
            topic = wanted[message.channel_id]
            yield BagMessage(topic.name, topic.type_name, message.log_time_ns, message.data)


_UNKNOWN = "a topic that is no longer known"


def _topic(file: pathlib.Path, channel: Channel, schema: Schema | None, count: int) -> Topic:
    where = f"{file}: {channel.topic[:80]}"
    if channel.message_encoding != "cdr":
        raise InvalidInput(f"{where} is encoded as {channel.message_encoding[:80]!r}, expected ROS 2 messages (cdr)")
    if schema is None:
        raise InvalidInput(f"{where} has no type, expected that of a ROS 2 message")
    try:
        profiles = profiles_from(load_yaml(channel.metadata.get("offered_qos_profiles", "")))
    except ValueError as error:
        raise InvalidInput(f"{where} has QoS profiles that are not those of rosbag2: {error}") from error
    text = Definition(schema.encoding, schema.data.decode("utf-8", "replace"))
    return Topic(channel.topic, schema.name, profiles, channel.metadata.get("topic_type_hash", ""), count, text)


def _summary(files: list[StoredFile]) -> Summary:
    topics: dict[tuple[str, str], Topic] = {}
    for file in files:
        for topic in file.topics:
            known = topics.get((topic.name, topic.type_name))
            if known is not None:  # known from an earlier file of the bag, or from another publisher
                if known.definition.text != topic.definition.text:
                    raise InvalidInput(f"{file.path}: {topic.name} has two definitions of {topic.type_name}, expected one")
                profiles = known.qos_profiles + tuple(qos for qos in topic.qos_profiles if qos not in known.qos_profiles)
                count = known.message_count + topic.message_count
                topic = Topic(topic.name, topic.type_name, profiles, topic.type_hash, count, topic.definition)
            topics[topic.name, topic.type_name] = topic
    spans = [(file.start_ns, file.end_ns) for file in files if any(topic.message_count for topic in file.topics)]
    start, end = (min(start for start, _ in spans), max(end for _, end in spans)) if spans else (0, 0)
    return Summary(tuple(topics.values()), start, end)


def _damage(files: list[StoredFile], summary: Summary, metadata: BagMetadata | None) -> Damage | None:
    gaps = tuple(FileGap(file.path, gap) for file in files for gap in file.gaps)
    found: Counter[str] = Counter()
    for topic in summary.topics:
        found[topic.name] += topic.message_count
    contradictions = [f"{file.path.name}: {doubt}" for file in files for doubt in file.doubts]
    missing: dict[str, int] | None = None
    expected_of_files = [file.expected for file in files]
    if all(expected is not None for expected in expected_of_files):
        expected: Counter[str] = Counter()
        for counts in expected_of_files:
            expected.update(counts or {})
        missing = _compared(expected, found, "the files say they hold", contradictions)
    if metadata is not None:
        of_metadata = _compared(Counter(metadata.by_topic), found, f"{METADATA} says the bag holds", contradictions)
        held = sum(found.values()) + sum((of_metadata if missing is None else missing).values())
        if metadata.message_count != held:
            contradictions.append(f"{METADATA} says the bag holds {metadata.message_count} messages, but it held {held}")
        if missing is None:
            missing = of_metadata
        elif of_metadata != missing:
            contradictions.append(f"{METADATA} and the files say different numbers of messages")
    if missing is None and not gaps:
        missing = {}  # nothing in the bag says how many there were, and nothing is damaged
    if not (gaps or missing or contradictions):
        return None
    unconfirmed = joined(item for file in files for item in file.unconfirmed.items())
    return Damage(gaps, missing, {topic: span.messages for topic, span in unconfirmed.items()}, tuple(contradictions))


def _compared(expected: Counter[str], found: Counter[str], said: str, contradictions: list[str]) -> dict[str, int]:
    """Number of missing messages by topic; more messages than expected are a contradiction."""
    for name, count in found.items():
        if count > expected[name]:
            contradictions.append(f"{said} {expected[name]} messages of {name}, but there are {count}")
    return {name: count - found[name] for name, count in expected.items() if count > found[name]}


def _decompressed(raw: bytes, file: pathlib.Path) -> bytes:
    try:
        declared = zstandard.frame_content_size(raw)
        if declared > MESSAGE_LIMIT:
            raise InvalidInput(f"{file}: a message of {declared} bytes is larger than the limit of {MESSAGE_LIMIT}")
        return zstandard.ZstdDecompressor().decompress(raw, max_output_size=MESSAGE_LIMIT if declared < 0 else 0)
    except zstandard.ZstdError as error:
        raise InvalidInput(f"{file}: a message cannot be decompressed: {error}") from error
