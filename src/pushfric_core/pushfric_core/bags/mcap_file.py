"""MCAP files, read record by record by the library mcap: what follows a broken chunk is still found."""

import contextlib
import functools
import io
import pathlib
import struct
import zlib
from array import array
from bisect import bisect_right
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from functools import partial
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, DataEnd, Footer, McapRecord, Message, Metadata, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk
from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import parse_qos

from pushfric_core.bags.contents import FIRST_NUMBER, UNKNOWN_TOPIC, BagMessage, Definition, Gap, Topic, in_order
from pushfric_core.bags.message_types import decoder
from pushfric_core.bags.rosbag2_metadata import CONVERT, BagMetadata, embedded_metadata
from pushfric_core.errors import InvalidInput, blaming
from pushfric_core.files.disk import reading
from pushfric_core.files.yaml_text import load_yaml
from pushfric_core.wording import counted

MAGIC = b"\x89MCAP0\r\n"

RECORD_LIMIT = 256 * 2**20
"""Largest size of a record, and of a chunk after decompression [bytes]. Recorders write chunks of 1 MiB, or of one message."""

LATEST_NS = 2**63 - 1
"""ROS cannot express a later time [ns]."""

STRANGE = 2**20
"""A message whose number is farther than this from the one before is of another recording."""

PRIVATE = 0x80
"""From here on, operation codes are free for any program."""

_HEAD = struct.Struct("<BQ")  # operation code, length
_FOOTER_SIZE, _DATA_END_SIZE = 29, 13
_BLOCK = 2**20
_FAILURES = (McapError, ValueError, struct.error, zstandard.ZstdError, RuntimeError, EOFError, MemoryError, OverflowError)


class Unsound(ValueError):
    """Bytes that cannot be trusted; the text says why."""


class CutShort(Unsound):
    """A record that reaches beyond the end."""


class Piece(NamedTuple):
    """A chunk, or messages outside chunks."""

    begin: int
    end: int
    start_ns: int  # least log time
    end_ns: int


def end_of_record(stream: BinaryIO, position: int, end: int) -> int:
    """Where the record at a position ends by its own length.

    Raises:
        CutShort: it reaches beyond `end`.
        Unsound: no record begins there.
    """
    stream.seek(position)
    head = stream.read(_HEAD.size)
    if len(head) < _HEAD.size:
        raise CutShort("a record is cut short")
    code, length = _HEAD.unpack(head)
    if not (Opcode.HEADER <= code <= Opcode.DATA_END or code >= PRIVATE):
        raise Unsound("no record begins here")
    if position + _HEAD.size + length > end:
        raise CutShort("a record reaches beyond what follows it")
    return position + _HEAD.size + int(length)


def read_record(stream: BinaryIO, position: int, end: int) -> McapRecord | None:
    """The record between two positions; None for one of a kind that only its writer knows.

    Raises:
        Unsound: it is not what its kind requires, or larger than the limit.
    """
    if end - position > RECORD_LIMIT:
        raise Unsound(f"a record of {end - position} bytes is larger than the limit of {RECORD_LIMIT}")
    stream.seek(position)
    content = stream.read(end - position)
    if content[0] >= PRIVATE:
        return None
    try:
        return next(StreamReader(io.BytesIO(content), skip_magic=True, emit_chunks=True).records)
    except _FAILURES as error:
        raise Unsound("a record is not what its length says") from error


def read_records(stream: BinaryIO, begin: int, end: int) -> Iterator[tuple[McapRecord | None, int]]:
    """The records between two positions as `read_record`, each with its end; its errors, and those of `end_of_record`."""
    while begin < end:
        after = end_of_record(stream, begin, end)
        yield read_record(stream, begin, after), after
        begin = after


def inner_records(chunk: McapRecord | None) -> list[Any]:
    """The schemas, channels and messages in a chunk; any other record itself.

    Raises:
        Unsound: it is larger than the limit, cannot be decompressed, or fails its checksum.
    """
    if not isinstance(chunk, Chunk):
        return [chunk]
    if chunk.uncompressed_size > RECORD_LIMIT:
        raise Unsound(f"a chunk of {chunk.uncompressed_size} bytes is larger than the limit of {RECORD_LIMIT}")
    try:
        found: list[McapRecord] = breakup_chunk(chunk, validate_crc=True)
    except _FAILURES as error:
        raise Unsound("a chunk fails its checksum, or cannot be decompressed") from error
    if any(isinstance(one, Message) and one.log_time > LATEST_NS for one in found):
        raise Unsound("a message was logged at a time beyond those of ROS")
    return found


class McapFile:
    """A file of a bag, read through once to find what it holds and what is wrong with it.

    Args:
        path: the file.
    Attributes:
        topics: those that it defines, by channel.
        counts: number of messages of each topic that can be read.
        gaps: bytes that cannot be trusted.
        doubts: contradictions: why messages may be missing, or differ from what was recorded.
        first_numbers: the number of the first message of each topic that its recorder numbered.
        missing: messages of each topic that the numbers of the others miss.
        expected: number of messages of each topic that were written; None if nothing says so.
        start_ns, end_ns: least and largest log time; 0 without messages.
        embedded: what the file says of its bag; None if it says nothing.
    Raises:
        InvalidInput: it cannot be read, is no MCAP file, or holds messages that are not of ROS 2.
    """

    def __init__(self, path: pathlib.Path) -> None:
        self.path = path
        self.gaps: list[Gap] = []
        self.doubts: list[str] = []
        self.embedded: BagMetadata | None = None
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._numbers: dict[int, array[int]] = {}  # of messages, by channel
        self._pieces: list[Piece] = []
        self._listed: dict[int, ChunkIndex] = {}  # by position
        self._chunks: set[int] = set()  # positions
        self._statistics: Statistics | None = None
        self._unchecked = 0  # messages that no checksum of a chunk covers
        self._holds = False  # whether the checksum over all holds
        with reading(path, ", expected a bag"), path.open("rb") as stream:
            begin, size = stream.read(len(MAGIC)), stream.seek(0, io.SEEK_END)
            stream.seek(max(0, size - len(MAGIC)))
            if not size:
                raise InvalidInput(f"{path}: is empty: its recorder ended before it wrote anything")
            if MAGIC not in (begin, stream.read()):
                raise InvalidInput(f"{path}: is not an MCAP file, expected a bag's folder or one of its files; {CONVERT}")
            end, damage = self._read_summary(stream, size)
            self._survey(stream, end)
            if damage:
                self._add_gap(end, size, damage)
        # a type may have been lost
        known = {number: one for number, one in self._channels.items() if one.schema_id in self._schemas or not self.gaps}
        self.topics = {number: self._topic(one) for number, one in known.items()}
        held = self._by_topic({number: len(numbers) for number, numbers in self._numbers.items()})
        self.expected = self._expected(held)
        self.counts = held - Counter({UNKNOWN_TOPIC: held[UNKNOWN_TOPIC]})
        self.first_numbers = {
            one.topic: int(text)
            for one in self._channels.values()
            if (text := one.metadata.get(FIRST_NUMBER, "")).isascii() and text.isdecimal() and len(text) < 11
        }
        self.missing = self._missing_numbers()
        self.start_ns = min((piece.start_ns for piece in self._pieces), default=0)
        self.end_ns = max((piece.end_ns for piece in self._pieces), default=0)
        if self.gaps and self._unchecked and not self._holds:
            self.doubts.append(f"{counted(self._unchecked, 'message')} may not be what was recorded: no checksum confirms them")

    def messages(self, topics: Collection[str] | None) -> Iterator[BagMessage]:
        """The messages of these topics, or of all, in order of log time; those of the same time in the order of the file.

        Raises:
            InvalidInput: the file can no longer be read.
        """
        wanted = {number: one for number, one in self.topics.items() if topics is None or one.name in topics}
        with reading(self.path), self.path.open("rb") as stream:
            yield from in_order((piece.start_ns, partial(self._content, stream, piece, wanted)) for piece in self._pieces)

    def _content(self, stream: BinaryIO, piece: Piece, wanted: dict[int, Topic]) -> list[BagMessage]:
        found = []
        try:
            for record, _ in read_records(stream, piece.begin, piece.end):
                for one in inner_records(record):
                    if isinstance(one, Message) and one.channel_id in wanted:
                        topic = wanted[one.channel_id]
                        found.append(BagMessage(topic.name, topic.type_name, one.log_time, one.data))
        except Unsound as error:
            raise ValueError(f"changed while it was read ({error})") from error
        return sorted(found, key=lambda message: message.log_time_ns)

    # --- the survey ---

    def _read_summary(self, stream: BinaryIO, size: int) -> tuple[int, str]:
        """Read what the end of the file says of the whole: where the data end, and what is wrong with it."""
        position = size - len(MAGIC) - _FOOTER_SIZE
        stream.seek(max(0, size - len(MAGIC)))
        ended = stream.read() == MAGIC and position >= len(MAGIC)
        try:
            footer = read_record(stream, position, position + _FOOTER_SIZE) if ended else None
            if not isinstance(footer, Footer):
                return size, "the recording was cut short"
            start = footer.summary_start or position
            if footer.summary_crc and _checksum(stream, start, size - len(MAGIC) - 4) != footer.summary_crc:
                return position, "the summary fails its checksum"
            found = [record for record, _ in read_records(stream, start, position)]
        except Unsound as error:
            return position, f"the summary is damaged: {error}"
        for record in found:
            if isinstance(record, Statistics):
                self._statistics = record
            elif isinstance(record, ChunkIndex):
                self._listed[record.chunk_start_offset] = record
            else:
                self._define(record)
        return start, ""

    def _survey(self, stream: BinaryIO, end: int) -> None:
        stream.seek(0)
        if stream.read(len(MAGIC)) != MAGIC:
            self._add_gap(0, len(MAGIC), "the file does not begin as an MCAP file")
        places, position, closed = sorted(self._listed), len(MAGIC), False
        while position < end and not closed:
            rank = bisect_right(places, position)
            limit = after = places[rank] if rank < len(places) else end  # a listed chunk is found whatever lies before it
            try:
                after = end_of_record(stream, position, limit)
                record = read_record(stream, position, after)
                if isinstance(record, DataEnd):
                    closed = after - position == _DATA_END_SIZE and limit == end
                    if not closed:
                        raise Unsound("the end of the data lies among them")
                    self._check_data(stream, position, record.data_section_crc)
                self._take(record, position, after)
            except Unsound as error:
                self._add_gap(position, after, str(error))
            position = after
        if end < stream.seek(0, io.SEEK_END) and not closed and not self.gaps:
            self._add_gap(end, end, "the end of the data is missing")
        for place in set(places) - self._chunks:
            if not any(gap.begin <= place < gap.end for gap in self.gaps):
                self._add_gap(place, place + self._listed[place].chunk_length, "no chunk lies where the index lists one")

    def _add_gap(self, begin: int, end: int, reason: str) -> None:
        self.gaps.append(Gap(self.path.name, begin, end, reason, self._pieces[-1].end_ns if self._pieces else None, None))

    def _take(self, record: McapRecord | None, position: int, after: int) -> None:
        if isinstance(record, Chunk):
            records = inner_records(record)
            self._chunks.add(position)
            for one in records:
                self._define(one)
            self._note(record, [one for one in records if isinstance(one, Message)], position, after)
        elif isinstance(record, Message):
            if self._listed or record.log_time > LATEST_NS:
                raise Unsound("a message lies outside the chunks, or beyond the times of ROS")
            self._note(None, [record], position, after)
        elif isinstance(record, Metadata) and record.name == "rosbag2":
            self.embedded = embedded_metadata(self.path.parent, record.metadata.get("serialized_metadata", "")) or self.embedded
        else:
            self._define(record)

    def _define(self, record: McapRecord | None) -> None:
        what = ""
        if isinstance(record, Schema) and self._schemas.setdefault(record.id, record) != record:
            what = f"the type {record.name[:80]}"
        elif isinstance(record, Channel) and self._channels.setdefault(record.id, record) != record:
            what = f"the topic {record.topic[:80]}"
        if what and (doubt := f"{what} is defined twice, in different ways") not in self.doubts:
            self.doubts.append(doubt)

    def _note(self, chunk: Chunk | None, messages: Sequence[Message], position: int, after: int) -> None:
        """Note the messages of a chunk, or a message outside chunks."""
        if not messages:
            return
        times = [message.log_time for message in messages]
        piece = Piece(position, after, min(times), max(times))
        index = self._listed.get(position)
        if self._listed and (index is None or (index.message_start_time, index.message_end_time) != piece[2:]):
            self.doubts.append(f"the chunk at byte {position} is not the one that the index lists")
        last = self._pieces[-1] if self._pieces else None
        if chunk is None and last is not None and last.end == position and after - last.begin <= _BLOCK:
            self._pieces.pop()  # one piece with those before it
            piece = Piece(last.begin, after, min(last.start_ns, piece.start_ns), max(last.end_ns, piece.end_ns))
        self._pieces.append(piece)
        if self.gaps and self.gaps[-1].before_ns is None:
            self.gaps = [gap if gap.before_ns is not None else gap._replace(before_ns=min(times)) for gap in self.gaps]
        self._unchecked += 0 if chunk is not None and chunk.uncompressed_crc else len(messages)
        for message in messages:
            self._numbers.setdefault(message.channel_id, array("I")).append(message.sequence)

    def _check_data(self, stream: BinaryIO, position: int, said: int) -> None:
        if said:
            self._holds = _checksum(stream, 0, position) == said
            if not self._holds and not any(gap.begin < position for gap in self.gaps):
                self._add_gap(0, position, "the data section fails its checksum")

    # --- what it amounts to ---

    def _topic(self, channel: Channel) -> Topic:
        where, schema = f"{self.path}: {channel.topic[:80]}", self._schemas.get(channel.schema_id)
        if channel.message_encoding != "cdr":
            raise InvalidInput(f"{where} is encoded as {channel.message_encoding[:80]!r}, expected ROS 2 messages (cdr)")
        if schema is None:
            raise InvalidInput(f"{where} has no type, expected that of a ROS 2 message")
        with blaming(f"{where} has QoS profiles that are not those of rosbag2"):
            profiles = profiles_from(channel.metadata.get("offered_qos_profiles", ""))
        hash_text = channel.metadata.get("topic_type_hash", "")
        count = len(self._numbers.get(channel.id, ()))
        return Topic(channel.topic, schema.name, profiles, hash_text, count, definition_of(schema))

    def _by_topic(self, counts: dict[int, int]) -> Counter[str]:
        """Numbers of messages, given by channel."""
        found: Counter[str] = Counter()
        for number, count in counts.items():
            found[self.topics[number].name if number in self.topics else UNKNOWN_TOPIC] += count
        return found

    def _expected(self, held: Counter[str]) -> Counter[str] | None:
        if self._statistics is None:
            return held if self._holds else None  # the checksum over all says that nothing was lost
        expected, total = self._by_topic(self._statistics.channel_message_counts) or held, self._statistics.message_count
        if total != expected.total():
            self.doubts.append(f"the file says it holds {total} messages, but there are {expected.total()}")
        return expected + Counter({UNKNOWN_TOPIC: total - expected.total()})

    def _missing_numbers(self) -> Counter[str]:
        """The messages of each topic that were numbered and are not there; what else is wrong with the numbers is a doubt."""
        missing: Counter[str] = Counter()
        for name, first in self.first_numbers.items():
            parts = [
                self._numbers[number] for number, one in self.topics.items() if one.name == name and number in self._numbers
            ]
            values = np.concatenate([np.zeros(0, np.int64), *parts]).astype(np.int64)
            if len(parts) > 1:
                values.sort()  # the types of one topic share their numbers
            steps = np.diff(values, prepend=first - 1)
            if strange := int(((steps < 1) | (steps > STRANGE)).sum()):
                what = f"{counted(strange, 'message')} of {name[:80]}"
                self.doubts.append(f"the numbers of {what} do not follow: copies, another order, or another recording")
            missing[name] = int((steps - 1)[(steps > 1) & (steps <= STRANGE)].sum())
        return +missing


@functools.lru_cache(maxsize=100)
def profiles_from(text: str) -> tuple[Qos, ...]:
    """The profiles of a topic, in YAML; most topics have the same ones.

    Raises:
        ValueError: rosbag2 did not write this.
    """
    entries: Any = load_yaml(text) or []
    try:
        found = tuple(parse_qos(entries))
        numbers = [n for one in found for n in (one.depth, *one.deadline, *one.lifespan, *one.liveliness_lease_duration)]
    except (LookupError, TypeError, AttributeError) as error:
        raise ValueError(f"expected QoS profiles as rosbag2 writes them, got {str(entries)[:80]}") from error
    if wrong := [number for number in numbers if type(number) is not int or number < 0]:
        raise ValueError(f"expected depths and durations in whole numbers of 0 or more, got {str(wrong[0])[:80]!r}")
    return found


def definition_of(schema: Schema) -> Definition:
    """The text of a schema; bytes that are not UTF-8 are replaced."""
    return Definition(schema.encoding, schema.data.decode("utf-8", "replace"))


def _checksum(stream: BinaryIO, begin: int, end: int) -> int:
    stream.seek(begin)
    value = 0
    while begin < end and (block := stream.read(min(_BLOCK, end - begin))):
        value = zlib.crc32(block, value)
        begin += len(block)
    return value


class Input(NamedTuple):
    """A message of a run."""

    topic: str  # relative name
    msg: Any
    received: int | None  # when it was recorded, or came by topic [ns]; None: not known


class GrowingFile:
    """A file that its writer has not finished: what was flushed so far, read on from where the last reading ended.

    Args:
        path: the file; it need not exist yet.
        namespace: of the cell.
        names: of the topics to read, relative to the cell.
    """

    def __init__(self, path: pathlib.Path, namespace: str, names: Sequence[str]) -> None:
        self.path = path
        self._names = {f"{namespace.rstrip('/')}/{name}": name for name in names}
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._position = len(MAGIC)

    def read_on(self) -> list[Input]:
        """The messages that have come since the last call, in the order of the file; a record still being written comes later.

        Raises:
            OSError: the file cannot be read.
            ValueError: its bytes do not follow the format, or are not such messages.
            InvalidInput: the definition of a type cannot be used.
        """
        found: list[Input] = []
        try:
            with contextlib.suppress(FileNotFoundError, CutShort), self.path.open("rb") as stream:
                for record, after in read_records(stream, self._position, self.path.stat().st_size):
                    for one in inner_records(record):
                        if isinstance(one, Schema):
                            self._schemas.setdefault(one.id, one)
                        elif isinstance(one, Channel):
                            self._channels.setdefault(one.id, one)
                        elif isinstance(one, Message) and self._channels[one.channel_id].topic in self._names:
                            found.append(self._decoded(one))
                    self._position = after
        except KeyError as error:
            raise Unsound(f"a message of which the topic or the type is not defined: {error}") from error
        return found

    def _decoded(self, message: Message) -> Input:
        """The message, by the definition in the file."""
        channel = self._channels[message.channel_id]
        schema = self._schemas[channel.schema_id]
        content = decoder(schema.name, definition_of(schema))(message.data)
        return Input(self._names[channel.topic], content, message.log_time)
