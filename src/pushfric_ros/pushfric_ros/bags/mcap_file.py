"""The sound parts of an MCAP file; after damage, reading resumes at the next sound record."""

import heapq
import pathlib
import re
import struct
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import BinaryIO, NamedTuple, TypeVar

from pushfric_ros.bags import salvage
from pushfric_ros.bags.mcap_records import (
    ATTACHMENT,
    BLOCK,
    CHANNEL,
    CHUNK,
    CHUNK_HEAD,
    DATA_END,
    FOOTER,
    LAST_KNOWN,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    METADATA,
    RECORD_HEAD,
    SCHEMA,
    STATISTICS,
    Channel,
    CutShort,
    Schema,
    Statistics,
    Unsound,
    channel_of,
    checksum_of,
    chunk_content,
    index_of,
    message_head,
    metadata_of,
    read,
    records,
    schema_of,
    sound_record,
    statistics_of,
)

UNCONFIRMED = "pushfric_unconfirmed_messages"
"""Name of the metadata record that says which messages of a recovered file have no checksum that holds."""

Key = TypeVar("Key")

_SPAN = re.compile(r"([0-9]{1,18}) from ([0-9]{1,19}) to ([0-9]{1,19})")

_DEFINITIONS = 1000  # of so many one after the other, one follows the other
_DAY_NS = 86_400 * 10**9

_CANDIDATE = re.compile(rb"[\x01-\x0f](?=[\x00-\xff]{5}\x00\x00\x00)")
"""How a record shorter than 1 TiB begins."""

_LOOSE_RUN = 2**20  # bytes of messages outside chunks that are taken as one piece


class Message(NamedTuple):
    """A message as it is stored."""

    log_time_ns: int
    channel_id: int
    data: bytes


class Span(NamedTuple):
    """Some messages: how many, and when the first and the last of them were logged [ns]."""

    messages: int
    first_ns: int
    last_ns: int

    def joined(self, other: "Span") -> "Span":
        first, last = min(self.first_ns, other.first_ns), max(self.last_ns, other.last_ns)
        return Span(self.messages + other.messages, first, last)

    def text(self) -> str:
        return f"{self.messages} from {self.first_ns} to {self.last_ns}"

    @classmethod
    def from_text(cls, text: str) -> "Span":
        """Raises Unsound."""
        found = _SPAN.fullmatch(text)
        if found is None:
            raise Unsound(f"expected a number of messages and two times, got {text[:80]!r}")
        return cls(*map(int, found.groups()))


def joined(spans: Iterable[tuple[Key, Span]]) -> dict[Key, Span]:
    """One span for each key, such as a topic or a channel."""
    found: dict[Key, Span] = {}
    for key, span in spans:
        found[key] = span.joined(found[key]) if key in found else span
    return found


class Gap(NamedTuple):
    """Bytes of a file that cannot be trusted."""

    begin: int
    end: int
    reason: str
    after_ns: int | None  # log time of the last message before it, in the order of the file; None: no such message
    before_ns: int | None  # log time of the first message after it


class _Piece(NamedTuple):
    """A chunk, or a run of messages outside chunks or in a damaged one."""

    begin: int
    end: int
    is_chunk: bool
    start_ns: int
    end_ns: int
    confirmed: bool = True  # whether no checksum says that some of these messages may be wrong


class _Suspect(NamedTuple):
    """A damaged part of the file that may contain intact messages."""

    begin: int
    end: int


@dataclass
class McapFile:
    """The sound parts of a file, found by reading it once from beginning to end.

    Args:
        path: the file.
    Raises:
        OSError: it cannot be read.
    """

    path: pathlib.Path
    schemas: dict[int, Schema] = field(default_factory=dict, init=False)
    channels: dict[int, Channel] = field(default_factory=dict, init=False)
    counts: Counter[int] = field(default_factory=Counter, init=False)  # of sound messages, by channel
    unconfirmed: dict[int, Span] = field(default_factory=dict, init=False)  # messages intact in damaged chunks, by channel
    marked: dict[str, Span] = field(default_factory=dict, init=False)  # messages marked as unconfirmed, by topic
    gaps: list[Gap] = field(default_factory=list, init=False)
    statistics: Statistics | None = field(default=None, init=False)
    finished: bool = field(default=False, init=False)  # whether the file ends as a finished one does
    doubtful: bool = field(default=False, init=False)  # whether a message that is read may differ from what was written
    start_ns: int = field(default=0, init=False)  # least and largest log time; 0 without messages
    end_ns: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self._pieces: list[_Piece] = []
        self._summary_channels: dict[int, Channel] = {}
        self._summary_schemas: dict[int, Schema] = {}
        self._summary: int | None = None  # position where it begins
        self._chunked = False
        self._checked = True  # whether each message had a checksum
        self._suspects: list[_Suspect] = []  # where intact messages may be
        self._places: dict[int, dict[int, int]] | None = None  # what the indexes of the last chunk must say; None: not known
        with self.path.open("rb") as stream:
            self._survey(stream)
        self._pieces.sort(key=lambda piece: (piece.start_ns, piece.begin))
        if self._pieces:
            self.start_ns, self.end_ns = self._pieces[0].start_ns, max(piece.end_ns for piece in self._pieces)

    @staticmethod
    def recognized(path: pathlib.Path) -> bool:
        """Whether a file begins or ends as MCAP files do.

        Raises:
            OSError: it cannot be read.
        """
        with path.open("rb") as stream:
            begin = stream.read(len(MAGIC))
            stream.seek(max(0, path.stat().st_size - len(MAGIC)))
            return MAGIC in (begin, stream.read())

    def messages(self, wanted: Callable[[int], bool], unconfirmed: bool = False) -> Iterator[Message]:
        """The sound messages of the wanted channels in order of log time; those of the same time in the order of the file.

        Args:
            wanted: which channels.
            unconfirmed: also those that are intact in damaged chunks.
        Raises:
            OSError: the file can no longer be read.
        """
        waiting: list[tuple[int, int, int, Message]] = []
        with self.path.open("rb") as stream:
            for piece in self._pieces:
                if not (piece.confirmed or unconfirmed):
                    continue
                while waiting and waiting[0][0] < piece.start_ns:
                    yield heapq.heappop(waiting)[3]
                try:
                    for number, message in enumerate(self._content(stream, piece)):
                        if message.channel_id in self.channels and wanted(message.channel_id):
                            heapq.heappush(waiting, (message.log_time_ns, piece.begin, number, message))
                except Unsound as error:
                    raise OSError(0, f"changed while it was read ({error})") from error
        while waiting:
            yield heapq.heappop(waiting)[3]

    # --- the survey ---

    def _survey(self, stream: BinaryIO) -> None:
        size = self.path.stat().st_size
        position = len(MAGIC)
        stream.seek(0)
        if stream.read(len(MAGIC)) != MAGIC:
            position = self._skip(stream, 0, size, "the file does not begin as an MCAP file")
        while position < size and not self.finished:
            try:
                position = self._take(stream, position, size)
            except Unsound as error:
                position = self._skip(stream, position, size, str(error))
        if not self.finished:
            counts = self.statistics
            if counts is not None and counts.by_channel and sum(counts.by_channel.values()) != counts.messages:
                self.statistics = None  # damaged, like the end of the file with the checksum
            self.gaps.append(Gap(size, size, "the recording was cut short", self._last_ns(), None))
        elif position < size:
            self.gaps.append(Gap(position, size, "something follows the end of the bag", self._last_ns(), None))
        # the summary repeats definitions that may have been in lost chunks
        self.channels = self._summary_channels | self.channels
        self.schemas = self._summary_schemas | self.schemas
        confirmed = list(self._pieces)
        for suspect in self._suspects if self._chunked else ():
            self._search(stream, suspect, size, confirmed)

    def _last_ns(self) -> int | None:
        return self._pieces[-1].end_ns if self._pieces else None

    def _skip(self, stream: BinaryIO, position: int, size: int, reason: str, search_from: int | None = None) -> int:
        """Record a gap from `position` on; return where it ends."""
        resumed = self._next_sound(stream, position + 1 if search_from is None else search_from, size)
        if self.gaps and self.gaps[-1].end == position:  # one gap, for the first reason
            position, reason = self.gaps[-1].begin, self.gaps[-1].reason
            self.gaps.pop()
            self._suspects = [one for one in self._suspects if one.begin < position]
        self._suspects.append(_Suspect(position, resumed))
        self.gaps.append(Gap(position, resumed, reason, self._last_ns(), None))
        return resumed

    def _note_piece(self, piece: _Piece) -> None:
        self._pieces.append(piece)
        for index in range(len(self.gaps) - 1, -1, -1):
            if self.gaps[index].before_ns is not None:
                break
            self.gaps[index] = self.gaps[index]._replace(before_ns=piece.start_ns)

    def _take(self, stream: BinaryIO, position: int, size: int) -> int:
        """Read the record at `position`; return where the next one begins. Raises Unsound."""
        code, length = sound_record(stream, position, size)
        begin, end = position + RECORD_HEAD.size, position + RECORD_HEAD.size + length
        if code == CHUNK:
            self._chunked = True
            self._take_chunk(stream, position, end, size)
        elif code == MESSAGE:
            return self._take_loose(stream, position, size)
        elif code == MESSAGE_INDEX and self._places is not None:
            channel_id, entries = index_of(read(stream, begin, length))
            if entries != self._places.get(channel_id, {}):
                raise Unsound("a message index contradicts its chunk")
        elif code == FOOTER:
            self._take_footer(stream, position, end)
            return end + len(MAGIC)
        elif code in (SCHEMA, CHANNEL, STATISTICS, METADATA, DATA_END):
            stream.seek(begin)
            content = stream.read(length)
            in_summary = self._summary is not None
            if code == SCHEMA:
                number, schema = schema_of(content)
                (self._summary_schemas if in_summary else self.schemas).setdefault(number, schema)
            elif code == CHANNEL:
                number, channel = channel_of(content)
                (self._summary_channels if in_summary else self.channels).setdefault(number, channel)
            elif code == STATISTICS:
                self.statistics = statistics_of(content)
            elif code == METADATA:
                name, texts = metadata_of(content)
                if name == UNCONFIRMED:
                    self.marked = {topic: Span.from_text(text) for topic, text in texts.items()}
            else:
                self._check_data(stream, position, content)
                self._summary = end
        elif code == ATTACHMENT and checksum_of(stream, begin, end - 4) != int.from_bytes(read(stream, end - 4, 4), "little"):
            raise Unsound("an attachment fails its checksum")
        return end

    def _take_chunk(self, stream: BinaryIO, position: int, end: int, size: int) -> None:
        self._places = None
        try:
            content = chunk_content(stream, position, end)
            has_checksum = any(read(stream, position + RECORD_HEAD.size + 24, 4))
            places: dict[int, dict[int, int]] = {}
            schemas, channels = {}, {}
            for code, begin, length in records(content):
                if code == MESSAGE:
                    channel_id, _, log_time, _ = message_head(content, begin, length)
                    places.setdefault(channel_id, {})[begin - RECORD_HEAD.size] = log_time
                elif code == SCHEMA:
                    number, schema = schema_of(content[begin : begin + length])
                    schemas[number] = schema
                elif code == CHANNEL:
                    number, channel = channel_of(content[begin : begin + length])
                    channels[number] = channel
        except Unsound as error:
            # if a sound record follows, the length of the chunk can be trusted, and only the chunk is lost
            try:
                sound_record(stream, end, size)
            except Unsound:
                raise error from None
            self.gaps.append(Gap(position, end, str(error), self._last_ns(), None))
            self._suspects.append(_Suspect(position, end))
            return
        for number, schema in schemas.items():
            self.schemas.setdefault(number, schema)
        for number, channel in channels.items():
            self.channels.setdefault(number, channel)
        self._places = places
        self.counts.update({channel_id: len(one) for channel_id, one in places.items()})
        if places:
            self._checked = self._checked and has_checksum
            times = [log_time for one in places.values() for log_time in one.values()]
            self._note_piece(_Piece(position, end, True, min(times), max(times)))

    def _take_loose(self, stream: BinaryIO, position: int, size: int) -> int:
        """Read the messages outside chunks that begin at `position`; return where they end, or where a gap after them ends."""
        taken: list[tuple[int, int, int]] = []  # begin, channel, log time
        begin = position
        unsound: Unsound | None = None
        while position < size and position - begin < _LOOSE_RUN:
            try:
                code, length = sound_record(stream, position, size)
            except Unsound as error:
                unsound = error
                break
            if code != MESSAGE:
                break
            channel_id, _, log_time, _ = message_head(read(stream, position + RECORD_HEAD.size, MESSAGE_HEAD.size), 0, length)
            taken.append((position, channel_id, log_time))
            position += RECORD_HEAD.size + length
        end = position
        if unsound is not None and not isinstance(unsound, CutShort):
            end, _, _ = taken.pop()  # it has no checksum, and the damage after it may have begun in it
        if taken:
            self._checked = False
            self.counts.update(channel_id for _, channel_id, _ in taken)
            times = [log_time for _, _, log_time in taken]
            self._note_piece(_Piece(begin, end, False, min(times), max(times)))
        return position if unsound is None else self._skip(stream, end, size, str(unsound), position)

    def _check_data(self, stream: BinaryIO, position: int, content: bytes) -> None:
        expected = int.from_bytes(content, "little")
        if expected and not self.gaps and checksum_of(stream, 0, position) != expected:
            self.gaps.append(Gap(0, position, "the data section fails its checksum", None, None))
            self.doubtful = not self._checked

    def _take_footer(self, stream: BinaryIO, position: int, end: int) -> None:
        summary, _, expected = struct.unpack("<QQI", read(stream, position + 9, 20))
        self.finished = True
        if read(stream, end, len(MAGIC)) != MAGIC:
            self.finished = False
            raise Unsound("the file does not end as an MCAP file")
        if summary and expected and (summary > position or checksum_of(stream, summary, position + 25) != expected):
            self.gaps.append(Gap(min(summary, position), position, "the summary fails its checksum", self._last_ns(), None))
            self.statistics = None
            self._summary_channels, self._summary_schemas = {}, {}

    def _search(self, stream: BinaryIO, suspect: _Suspect, size: int, confirmed: list[_Piece]) -> None:
        """Search a damaged part of the file for intact messages."""
        region = self._region(stream, suspect, size, confirmed)
        if region is None:
            return
        found = salvage.intact(region, self.channels.keys())
        self.channels = found.channels | self.channels
        self.schemas = found.schemas | self.schemas
        for run in found.runs:
            times = [log_time for _, log_time in run.messages]
            self._pieces.append(_Piece(run.begin, run.end, False, min(times), max(times), False))
            spans = ((channel_id, Span(1, log_time, log_time)) for channel_id, log_time in run.messages)
            self.unconfirmed = joined((*self.unconfirmed.items(), *spans))

    def _region(self, stream: BinaryIO, suspect: _Suspect, size: int, confirmed: list[_Piece]) -> salvage.Region | None:
        """The records in a damaged part of the file; None if they are compressed, or too many."""
        begin, end = suspect
        first = min((piece.start_ns for piece in confirmed), default=0) - _DAY_NS
        last = max((piece.end_ns for piece in confirmed), default=2**64) + _DAY_NS
        opened, index = False, {}
        code, length = RECORD_HEAD.unpack(read(stream, begin, RECORD_HEAD.size).ljust(RECORD_HEAD.size, b"\0"))
        head = stream.read(CHUNK_HEAD.size + 8)
        if code == CHUNK and len(head) == CHUNK_HEAD.size + 8:
            start_ns, end_ns, _, _, names = CHUNK_HEAD.unpack_from(head)
            if 0 < names <= 16 and length - CHUNK_HEAD.size - names < 2**40:
                return None  # compressed
            if names == 0 and length - len(head) == int.from_bytes(head[CHUNK_HEAD.size :], "little"):
                begin += RECORD_HEAD.size + len(head)
                first, last, opened = start_ns, end_ns, True
                if suspect.begin + RECORD_HEAD.size + length == end:
                    index = self._index_after(stream, end, size)
        if end - begin > salvage.LARGEST:
            return None
        return salvage.Region(begin, read(stream, begin, end - begin), opened, end < size, first, last, index)

    def _index_after(self, stream: BinaryIO, position: int, size: int) -> dict[int, dict[int, int]]:
        """The message index that follows a chunk, as far as it is sound."""
        found = {}
        try:
            while position < size:
                code, length = sound_record(stream, position, size)
                if code != MESSAGE_INDEX:
                    break
                channel_id, entries = index_of(read(stream, position + RECORD_HEAD.size, length))
                found[channel_id] = entries
                position += RECORD_HEAD.size + length
        except Unsound:
            pass  # the rest is damaged
        return found

    def _next_sound(self, stream: BinaryIO, position: int, size: int) -> int:
        """Where the first trustworthy record at or after `position` begins; the size of the file if there is no such record."""
        overlap = RECORD_HEAD.size - 1
        while position < size:
            block = read(stream, position, BLOCK + overlap)
            for match in _CANDIDATE.finditer(block):
                if match.start() < BLOCK and self._trusted(stream, position + match.start(), size):
                    return position + match.start()
            position += BLOCK
        return size

    def _trusted(self, stream: BinaryIO, position: int, size: int) -> bool:
        """Whether what looks like a record is one. A message has little structure, so two sound records must follow it."""
        following, definitions = 2, _DEFINITIONS
        try:
            while following and definitions and position < size - len(MAGIC):
                code, length = sound_record(stream, position, size)
                if code > LAST_KNOWN:
                    return False
                if self._chunked and code in (SCHEMA, CHANNEL):  # of the summary; or of a chunk, then messages follow
                    definitions -= 1
                elif code != MESSAGE:
                    return True
                elif self._chunked:  # it would be part of a chunk that fails its checksum
                    return False
                else:
                    following -= 1
                position += RECORD_HEAD.size + length
        except Unsound:
            return False
        return True

    def _content(self, stream: BinaryIO, piece: _Piece) -> Iterator[Message]:
        if piece.is_chunk:
            content = chunk_content(stream, piece.begin, piece.end)
        else:
            content = read(stream, piece.begin, piece.end - piece.begin)
        for code, begin, length in records(content):
            if code == MESSAGE:
                channel_id, _, log_time, _ = message_head(content, begin, length)
                yield Message(log_time, channel_id, content[begin + MESSAGE_HEAD.size : begin + length])


class GrowingFile:
    """A file that its writer has not finished: what was flushed so far, read on from where the last reading ended.

    Args:
        path: the file; it need not exist yet.
    """

    def __init__(self, path: pathlib.Path) -> None:
        self.path = path
        self.channels: dict[int, Channel] = {}
        self._position = len(MAGIC)

    def read_on(self) -> list[Message]:
        """The messages that have come since the last call, in the order of the file; a record still being written comes later.

        Raises:
            OSError: the file cannot be read.
            ValueError: its bytes do not follow the format.
        """
        found: list[Message] = []
        if not self.path.exists():
            return found
        size = self.path.stat().st_size
        try:
            with self.path.open("rb") as stream:
                while True:
                    try:
                        code, length = sound_record(stream, self._position, size)
                    except CutShort:
                        return found
                    begin = self._position + RECORD_HEAD.size
                    content = chunk_content(stream, self._position, begin + length) if code == CHUNK else b""
                    if code == CHANNEL:
                        stream.seek(begin)
                        number, channel = channel_of(stream.read(length))
                        self.channels.setdefault(number, channel)
                    for inner, at, size_of in records(content):
                        if inner == CHANNEL:
                            number, channel = channel_of(content[at : at + size_of])
                            self.channels.setdefault(number, channel)
                        elif inner == MESSAGE:
                            channel_id, _, log_time, _ = message_head(content, at, size_of)
                            found.append(Message(log_time, channel_id, content[at + MESSAGE_HEAD.size : at + size_of]))
                    self._position = begin + length
        except Unsound as error:
            raise ValueError(f"{self.path}: {error}") from error
