"""The records of an MCAP file, each checked before it is trusted; after damage, reading resumes at the next sound record.

The format is that of https://mcap.dev/spec. A chunk is trusted if its checksum is right, and any other record if its inner
lengths add up to its outer one.
"""

import heapq
import pathlib
import re
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import BinaryIO, NamedTuple

import lz4.frame
import zstandard

MAGIC = b"\x89MCAP0\r\n"

CHUNK_LIMIT = 256 * 2**20
"""Largest size of a chunk after decompression [bytes]; recorders write 1 MiB, or one large message."""

RECORD_LIMIT = 16 * 2**20
"""Largest size of a record that is not a chunk, a message or an attachment [bytes]."""

LATEST_NS = 2**63 - 1
"""ROS cannot express a later time [ns]."""

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = 1, 2, 3, 4, 5, 6, 7
CHUNK_INDEX, ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(8, 16)
LAST_KNOWN, FIRST_PRIVATE = DATA_END, 0x80

_RECORD_HEAD = struct.Struct("<BQ")  # operation code, length
_CHUNK_HEAD = struct.Struct("<QQQII")  # start, end, uncompressed size, checksum, length of the compression's name
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_STATISTICS = struct.Struct("<QHIIIIQQI")  # counts of messages, schemas, channels, ...; start, end; length of the map

_CANDIDATE = re.compile(rb"[\x01-\x0f](?=[\x00-\xff]{5}\x00\x00\x00)")
"""How a record shorter than 1 TiB begins."""

_SEARCH_BLOCK = 2**20
_LOOSE_RUN = 2**20  # bytes of messages outside chunks that are taken as one piece


class _Unsound(Exception):
    """Bytes that do not follow the format; the text says why."""


class _CutShort(_Unsound):
    """A record within which the file ends."""


class Schema(NamedTuple):
    """The definition of a message type."""

    name: str
    encoding: str
    data: bytes


class Channel(NamedTuple):
    """A channel: the messages of one publisher or topic."""

    schema_id: int
    topic: str
    message_encoding: str
    metadata: dict[str, str]


class Message(NamedTuple):
    """A message as it is stored."""

    log_time_ns: int
    channel_id: int
    data: bytes


class Statistics(NamedTuple):
    """The contents of the file, according to the file itself."""

    messages: int
    chunks: int
    by_channel: dict[int, int]  # empty if the writer did not count them


class Gap(NamedTuple):
    """Bytes of a file that cannot be trusted."""

    begin: int
    end: int
    reason: str
    after_ns: int | None  # log time of the last message before it, in the order of the file; None: no such message
    before_ns: int | None  # log time of the first message after it


class _Piece(NamedTuple):
    """A chunk, or a run of messages outside chunks."""

    begin: int
    end: int
    is_chunk: bool
    start_ns: int
    end_ns: int


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

    def messages(self, wanted: Callable[[int], bool]) -> Iterator[Message]:
        """The sound messages of the wanted channels in order of log time; those of the same time in the order of the file.

        Raises:
            OSError: the file can no longer be read.
        """
        waiting: list[tuple[int, int, int, Message]] = []
        with self.path.open("rb") as stream:
            for piece in self._pieces:
                while waiting and waiting[0][0] < piece.start_ns:
                    yield heapq.heappop(waiting)[3]
                try:
                    for number, message in enumerate(self._content(stream, piece)):
                        if message.channel_id in self.channels and wanted(message.channel_id):
                            heapq.heappush(waiting, (message.log_time_ns, piece.begin, number, message))
                except _Unsound as error:
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
            except _Unsound as error:
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

    def _last_ns(self) -> int | None:
        return self._pieces[-1].end_ns if self._pieces else None

    def _skip(self, stream: BinaryIO, position: int, size: int, reason: str, search_from: int | None = None) -> int:
        """Record a gap from `position` on; return where it ends."""
        resumed = self._next_sound(stream, position + 1 if search_from is None else search_from, size)
        if self.gaps and self.gaps[-1].end == position:  # one gap, for the first reason
            position, reason = self.gaps[-1].begin, self.gaps[-1].reason
            self.gaps.pop()
        self.gaps.append(Gap(position, resumed, reason, self._last_ns(), None))
        return resumed

    def _note_piece(self, piece: _Piece) -> None:
        self._pieces.append(piece)
        for index in range(len(self.gaps) - 1, -1, -1):
            if self.gaps[index].before_ns is not None:
                break
            self.gaps[index] = self.gaps[index]._replace(before_ns=piece.start_ns)

    def _take(self, stream: BinaryIO, position: int, size: int) -> int:
        """Read the record at `position`; return where the next one begins. Raises _Unsound."""
        code, length = _sound_record(stream, position, size)
        begin, end = position + _RECORD_HEAD.size, position + _RECORD_HEAD.size + length
        if code == CHUNK:
            self._chunked = True
            self._take_chunk(stream, position, end, size)
        elif code == MESSAGE:
            return self._take_loose(stream, position, size)
        elif code == FOOTER:
            self._take_footer(stream, position, end)
            return end + len(MAGIC)
        elif code in (SCHEMA, CHANNEL, STATISTICS, DATA_END):
            stream.seek(begin)
            content = stream.read(length)
            in_summary = self._summary is not None
            if code == SCHEMA:
                number, schema = _schema(content)
                (self._summary_schemas if in_summary else self.schemas).setdefault(number, schema)
            elif code == CHANNEL:
                number, channel = _channel(content)
                (self._summary_channels if in_summary else self.channels).setdefault(number, channel)
            elif code == STATISTICS:
                self.statistics = _statistics(content)
            else:
                self._check_data(stream, position, content)
                self._summary = end
        elif code == ATTACHMENT and _checksum(stream, begin, end - 4) != int.from_bytes(_read(stream, end - 4, 4), "little"):
            raise _Unsound("an attachment fails its checksum")
        return end

    def _take_chunk(self, stream: BinaryIO, position: int, end: int, size: int) -> None:
        try:
            content = _chunk(stream, position, end)
            has_checksum = any(_read(stream, position + _RECORD_HEAD.size + 24, 4))
            counts: Counter[int] = Counter()
            times: list[int] = []
            schemas, channels = {}, {}
            for code, begin, length in _records(content):
                if code == MESSAGE:
                    channel_id, _, log_time, _ = _message_head(content, begin, length)
                    counts[channel_id] += 1
                    times.append(log_time)
                elif code == SCHEMA:
                    number, schema = _schema(content[begin : begin + length])
                    schemas[number] = schema
                elif code == CHANNEL:
                    number, channel = _channel(content[begin : begin + length])
                    channels[number] = channel
        except _Unsound as error:
            # if a sound record follows, the length of the chunk can be trusted, and only the chunk is lost
            try:
                _sound_record(stream, end, size)
            except _Unsound:
                raise error from None
            self.gaps.append(Gap(position, end, str(error), self._last_ns(), None))
            return
        for number, schema in schemas.items():
            self.schemas.setdefault(number, schema)
        for number, channel in channels.items():
            self.channels.setdefault(number, channel)
        self.counts.update(counts)
        if times:
            self._checked = self._checked and has_checksum
            self._note_piece(_Piece(position, end, True, min(times), max(times)))

    def _take_loose(self, stream: BinaryIO, position: int, size: int) -> int:
        """Read the messages outside chunks that begin at `position`; return where they end, or where a gap after them ends."""
        taken: list[tuple[int, int, int]] = []  # begin, channel, log time
        begin = position
        unsound: _Unsound | None = None
        while position < size and position - begin < _LOOSE_RUN:
            try:
                code, length = _sound_record(stream, position, size)
            except _Unsound as error:
                unsound = error
                break
            if code != MESSAGE:
                break
            channel_id, _, log_time, _ = _message_head(
                _read(stream, position + _RECORD_HEAD.size, _MESSAGE_HEAD.size), 0, length
            )
            taken.append((position, channel_id, log_time))
            position += _RECORD_HEAD.size + length
        end = position
        if unsound is not None and not isinstance(unsound, _CutShort):
            end, _, _ = taken.pop()  # it has no checksum, and the damage after it may have begun in it
        if taken:
            self._checked = False
            self.counts.update(channel_id for _, channel_id, _ in taken)
            times = [log_time for _, _, log_time in taken]
            self._note_piece(_Piece(begin, end, False, min(times), max(times)))
        return position if unsound is None else self._skip(stream, end, size, str(unsound), position)

    def _check_data(self, stream: BinaryIO, position: int, content: bytes) -> None:
        expected = int.from_bytes(content, "little")
        if expected and not self.gaps and _checksum(stream, 0, position) != expected:
            self.gaps.append(Gap(0, position, "the data section fails its checksum", None, None))
            self.doubtful = not self._checked

    def _take_footer(self, stream: BinaryIO, position: int, end: int) -> None:
        summary, _, expected = struct.unpack("<QQI", _read(stream, position + 9, 20))
        self.finished = True
        if _read(stream, end, len(MAGIC)) != MAGIC:
            self.finished = False
            raise _Unsound("the file does not end as an MCAP file")
        if summary and expected and (summary > position or _checksum(stream, summary, position + 25) != expected):
            self.gaps.append(Gap(min(summary, position), position, "the summary fails its checksum", self._last_ns(), None))
            self.statistics = None
            self._summary_channels, self._summary_schemas = {}, {}

    def _next_sound(self, stream: BinaryIO, position: int, size: int) -> int:
        """Where the first trustworthy record at or after `position` begins; the size of the file if there is no such record."""
        overlap = _RECORD_HEAD.size - 1
        while position < size:
            block = _read(stream, position, _SEARCH_BLOCK + overlap)
            for match in _CANDIDATE.finditer(block):
                if match.start() < _SEARCH_BLOCK and self._trusted(stream, position + match.start(), size):
                    return position + match.start()
            position += _SEARCH_BLOCK
        return size

    def _trusted(self, stream: BinaryIO, position: int, size: int) -> bool:
        """Whether what looks like a record is one. A message has little structure, so two sound records must follow it."""
        following = 2
        try:
            while following and position < size - len(MAGIC):
                code, length = _sound_record(stream, position, size)
                if code > LAST_KNOWN:
                    return False
                if code != MESSAGE:
                    return True
                if self._chunked:  # it would be part of a chunk that fails its checksum
                    return False
                following -= 1
                position += _RECORD_HEAD.size + length
        except _Unsound:
            return False
        return True

    def _content(self, stream: BinaryIO, piece: _Piece) -> Iterator[Message]:
        if piece.is_chunk:
            content = _chunk(stream, piece.begin, piece.end)
        else:
            content = _read(stream, piece.begin, piece.end - piece.begin)
        for code, begin, length in _records(content):
            if code == MESSAGE:
                channel_id, _, log_time, _ = _message_head(content, begin, length)
                yield Message(log_time, channel_id, content[begin + _MESSAGE_HEAD.size : begin + length])


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
                        code, length = _sound_record(stream, self._position, size)
                    except _CutShort:
                        return found
                    begin = self._position + _RECORD_HEAD.size
                    content = _chunk(stream, self._position, begin + length) if code == CHUNK else b""
                    if code == CHANNEL:
                        stream.seek(begin)
                        number, channel = _channel(stream.read(length))
                        self.channels.setdefault(number, channel)
                    for inner, at, size_of in _records(content):
                        if inner == CHANNEL:
                            number, channel = _channel(content[at : at + size_of])
                            self.channels.setdefault(number, channel)
                        elif inner == MESSAGE:
                            channel_id, _, log_time, _ = _message_head(content, at, size_of)
                            found.append(Message(log_time, channel_id, content[at + _MESSAGE_HEAD.size : at + size_of]))
                    self._position = begin + length
        except _Unsound as error:
            raise ValueError(f"{self.path}: {error}") from error


# --- records ---


def _read(stream: BinaryIO, position: int, count: int) -> bytes:
    stream.seek(position)
    return stream.read(count)


def _checksum(stream: BinaryIO, begin: int, end: int) -> int:
    stream.seek(begin)
    value = 0
    while begin < end and (block := stream.read(min(_SEARCH_BLOCK, end - begin))):
        value = zlib.crc32(block, value)
        begin += len(block)
    return value


def _sound_record(stream: BinaryIO, position: int, size: int) -> tuple[int, int]:
    """Operation code and length of the record at `position`.

    Raises:
        _Unsound: it reaches beyond the file, or its inner lengths do not add up to its length.
    """
    head = _read(stream, position, _RECORD_HEAD.size)
    if len(head) < _RECORD_HEAD.size:
        raise _CutShort("the file ends within a record")
    code, length = _RECORD_HEAD.unpack(head)
    if not (HEADER <= code <= LAST_KNOWN or code >= FIRST_PRIVATE):
        raise _Unsound("no record begins here")
    if length > size - position - _RECORD_HEAD.size:
        raise _CutShort("a record reaches beyond the end of the file")
    if code == CHUNK:
        content = stream.read(_CHUNK_HEAD.size + 32)
        names = _CHUNK_HEAD.unpack_from(content)[4] if len(content) > _CHUNK_HEAD.size else 33
        if names > 16 or length < _CHUNK_HEAD.size + names + 8:
            raise _Unsound("a chunk is not what its length says")
        (stored,) = struct.unpack_from("<Q", content, _CHUNK_HEAD.size + names)
        if length != _CHUNK_HEAD.size + names + 8 + stored:
            raise _Unsound("a chunk is not what its length says")
    elif code == MESSAGE:
        _message_head(stream.read(_MESSAGE_HEAD.size), 0, length)
    elif code == ATTACHMENT:
        _attachment(stream, length)
    elif code < FIRST_PRIVATE:
        if length > RECORD_LIMIT:
            raise _Unsound(f"a record is longer than {RECORD_LIMIT} bytes")
        _CHECKS[code](stream.read(length))
    return code, length


def _records(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Operation code, begin and length of the records in a chunk."""
    position, size = 0, len(content)
    while position < size:
        if size - position < _RECORD_HEAD.size:
            raise _Unsound("a chunk ends within a record")
        code, length = _RECORD_HEAD.unpack_from(content, position)
        position += _RECORD_HEAD.size
        if length > size - position:
            raise _Unsound("a record reaches beyond the end of its chunk")
        yield code, position, length
        position += length


def _message_head(content: bytes, begin: int, length: int) -> tuple[int, int, int, int]:
    if length < _MESSAGE_HEAD.size or len(content) - begin < _MESSAGE_HEAD.size:
        raise _Unsound("a message is shorter than its head")
    head = _MESSAGE_HEAD.unpack_from(content, begin)
    if head[2] > LATEST_NS:
        raise _Unsound("a message was logged at a time beyond those of ROS")
    return head


def _chunk(stream: BinaryIO, position: int, end: int) -> bytes:
    """The records of a chunk, decompressed, and checked against its checksum if it has one."""
    content = memoryview(_read(stream, position + _RECORD_HEAD.size, end - position - _RECORD_HEAD.size))
    _, _, size, expected, names = _CHUNK_HEAD.unpack_from(content)
    compression = bytes(content[_CHUNK_HEAD.size : _CHUNK_HEAD.size + names]).decode("ascii", "replace")
    stored = content[_CHUNK_HEAD.size + names + 8 :]
    if size > CHUNK_LIMIT:
        raise _Unsound(f"a chunk of {size} bytes is larger than the limit of {CHUNK_LIMIT}")
    try:
        if compression == "zstd":
            declared = zstandard.frame_content_size(stored)
            if declared not in (-1, size):  # the size that a frame declares is allocated before it is read
                raise _Unsound(f"a chunk of {size} bytes declares {declared}")
            raw = zstandard.ZstdDecompressor().decompress(stored, max_output_size=size, allow_extra_data=False) if size else b""
        elif compression == "lz4":
            frame = lz4.frame.LZ4FrameDecompressor()
            raw = frame.decompress(stored, max_length=size + 1)
        elif compression == "":
            raw = bytes(stored)
        else:
            raise _Unsound(f"a chunk is compressed by {compression!r}, expected zstd, lz4 or nothing")
    except (zstandard.ZstdError, RuntimeError, ValueError, EOFError, MemoryError) as error:
        raise _Unsound("a chunk cannot be decompressed") from error
    if len(raw) != size:
        raise _Unsound(f"a chunk has {len(raw)} bytes, expected {size}")
    if expected and zlib.crc32(raw) != expected:
        raise _Unsound("a chunk fails its checksum")
    return raw


class _Fields:
    """Reads the content of a record; raises _Unsound if it ends too early."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._position = 0

    def number(self, size: int) -> int:
        return int.from_bytes(self.raw(size), "little")

    def raw(self, size: int) -> bytes:
        begin, self._position = self._position, self._position + size
        if self._position > len(self._content):
            raise _Unsound("a record is shorter than what it holds")
        return self._content[begin : self._position]

    def sized(self) -> bytes:
        return self.raw(self.number(4))

    def text(self) -> str:
        try:
            text = self.sized().decode()
        except UnicodeDecodeError as error:
            raise _Unsound("a text in a record is not UTF-8") from error
        if "\0" in text:  # as in a sector that was never written
            raise _Unsound("a text in a record holds zeros")
        return text

    def texts(self) -> dict[str, str]:
        inner = _Fields(self.sized())
        found = {}
        while not inner.ended:
            key = inner.text()
            found[key] = inner.text()
        return found

    @property
    def ended(self) -> bool:
        return self._position == len(self._content)

    def finish(self) -> None:
        if not self.ended:
            raise _Unsound("a record is longer than what it holds")


def _schema(content: bytes) -> tuple[int, Schema]:
    fields = _Fields(content)
    number, schema = fields.number(2), Schema(fields.text(), fields.text(), fields.sized())
    fields.finish()
    if number == 0:
        raise _Unsound("a schema has the number 0")
    return number, schema


def _channel(content: bytes) -> tuple[int, Channel]:
    fields = _Fields(content)
    number, schema_id = fields.number(2), fields.number(2)
    channel = Channel(schema_id, fields.text(), fields.text(), fields.texts())
    fields.finish()
    return number, channel


def _metadata(content: bytes) -> None:
    fields = _Fields(content)
    fields.text()
    fields.texts()
    fields.finish()


def _statistics(content: bytes) -> Statistics:
    fields = _Fields(content)
    messages = fields.number(8)
    fields.raw(2 + 4 + 4 + 4)
    chunks = fields.number(4)
    fields.raw(8 + 8)
    inner = _Fields(fields.sized())
    fields.finish()
    by_channel = {}
    while not inner.ended:
        channel_id = inner.number(2)
        by_channel[channel_id] = inner.number(8)
    return Statistics(messages, chunks, by_channel)


def _attachment(stream: BinaryIO, length: int) -> None:
    head = stream.read(min(length, 16 + RECORD_LIMIT))
    fields = _Fields(head)
    fields.raw(16)
    fields.sized()
    fields.sized()
    size = fields.number(8)
    if fields._position + size + 4 != length:
        raise _Unsound("an attachment is not what its length says")


def _parts(*sizes: int | None) -> Callable[[bytes], None]:
    """A check that a record consists of numbers of these sizes; None stands for a part with its own size."""

    def check(content: bytes) -> None:
        fields = _Fields(content)
        for size in sizes:
            if size is None:
                fields.sized()
            else:
                fields.raw(size)
        fields.finish()

    return check


_CHECKS: dict[int, Callable[[bytes], object]] = {
    HEADER: _parts(None, None),
    FOOTER: _parts(8, 8, 4),
    SCHEMA: _schema,
    CHANNEL: _channel,
    MESSAGE_INDEX: _parts(2, None),
    CHUNK_INDEX: _parts(8, 8, 8, 8, None, 8, None, 8, 8),
    ATTACHMENT_INDEX: _parts(8, 8, 8, 8, 8, None, None),
    STATISTICS: _statistics,
    METADATA: _metadata,
    METADATA_INDEX: _parts(8, 8, None),
    SUMMARY_OFFSET: _parts(1, 8, 8),
    DATA_END: _parts(4),
}
