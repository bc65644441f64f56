"""The records of MCAP files, each checked before it is trusted.

The format is that of https://mcap.dev/spec. A chunk is trusted if its checksum is right, and any other record if its inner
lengths add up to its outer one.
"""

import struct
import sys
import zlib
from array import array
from collections.abc import Callable, Iterator
from typing import BinaryIO, NamedTuple

import lz4.frame
import zstandard

from pushfric_core.bags.contents import Definition

MAGIC = b"\x89MCAP0\r\n"

HELD_LIMIT = 256 * 2**20
"""Most bytes of a bag that are held in memory at once: of a chunk or a message after decompression, of chunks that overlap in
time, or of the list of messages. Recorders write chunks of 1 MiB, or of one large message."""

RECORD_LIMIT = 16 * 2**20
"""Largest size of a record that is not a chunk, a message or an attachment [bytes]."""

LATEST_NS = 2**63 - 1
"""ROS cannot express a later time [ns]."""

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = 1, 2, 3, 4, 5, 6, 7
CHUNK_INDEX, ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(8, 16)
LAST_KNOWN, FIRST_PRIVATE = DATA_END, 0x80

BLOCK = 2**20
"""Files are read in pieces of this size [bytes]."""

RECORD_HEAD = struct.Struct("<BQ")  # operation code, length
CHUNK_HEAD = struct.Struct("<QQQII")  # start, end, uncompressed size, checksum, length of the compression's name
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_INDEX_ENTRY = struct.Struct("<QQ")  # log time, place in the chunk
LENGTH = struct.Struct("<Q")
CHANNEL_ID = struct.Struct("<H")


class Unsound(Exception):
    """Bytes that do not follow the format; the text says why."""


class CutShort(Unsound):
    """A record within which the file ends."""


class Schema(NamedTuple):
    """The definition of a message type."""

    name: str
    encoding: str
    data: bytes

    @property
    def definition(self) -> Definition:
        """The text; bytes that are not UTF-8 are replaced."""
        return Definition(self.encoding, self.data.decode("utf-8", "replace"))


class Channel(NamedTuple):
    """A channel: the messages of one publisher or topic."""

    schema_id: int
    topic: str
    message_encoding: str
    metadata: dict[str, str]


class Statistics(NamedTuple):
    """The contents of the file, according to the file itself."""

    messages: int
    chunks: int
    by_channel: dict[int, int]  # empty if the writer did not count them


def read(stream: BinaryIO, position: int, count: int) -> bytes:
    stream.seek(position)
    return stream.read(count)


def checksum_of(stream: BinaryIO, begin: int, end: int) -> int:
    stream.seek(begin)
    value = 0
    while begin < end and (block := stream.read(min(BLOCK, end - begin))):
        value = zlib.crc32(block, value)
        begin += len(block)
    return value


def sound_record(stream: BinaryIO, position: int, size: int) -> tuple[int, int]:
    """Operation code and length of the record at `position`.

    Raises:
        Unsound: it reaches beyond the file, or its inner lengths do not add up to its length.
    """
    head = read(stream, position, RECORD_HEAD.size)
    if len(head) < RECORD_HEAD.size:
        raise CutShort("the file ends within a record")
    code, length = RECORD_HEAD.unpack(head)
    if not (HEADER <= code <= LAST_KNOWN or code >= FIRST_PRIVATE):
        raise Unsound("no record begins here")
    if length > size - position - RECORD_HEAD.size:
        raise CutShort("a record reaches beyond the end of the file")
    if code == CHUNK:
        content = stream.read(CHUNK_HEAD.size + 32)
        names = CHUNK_HEAD.unpack_from(content)[4] if len(content) > CHUNK_HEAD.size else 33
        if names > 16 or length < CHUNK_HEAD.size + names + 8:
            raise Unsound("a chunk is not what its length says")
        (stored,) = struct.unpack_from("<Q", content, CHUNK_HEAD.size + names)
        if length != CHUNK_HEAD.size + names + 8 + stored:
            raise Unsound("a chunk is not what its length says")
    elif code == MESSAGE:
        message_head(stream.read(MESSAGE_HEAD.size), 0, length)
        check_held("a message", length)
    elif code == ATTACHMENT:
        _attachment(stream, length)
    elif code < FIRST_PRIVATE:
        if length > RECORD_LIMIT:
            raise Unsound(f"a record is longer than {RECORD_LIMIT} bytes")
        _CHECKS[code](stream.read(length))
    return code, length


def records(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Operation code, begin and length of the records in a chunk."""
    position, size = 0, len(content)
    while position < size:
        if size - position < RECORD_HEAD.size:
            raise Unsound("a chunk ends within a record")
        code, length = RECORD_HEAD.unpack_from(content, position)
        position += RECORD_HEAD.size
        if length > size - position:
            raise Unsound("a record reaches beyond the end of its chunk")
        yield code, position, length
        position += length


def message_head(content: bytes, begin: int, length: int) -> tuple[int, int, int, int]:
    if length < MESSAGE_HEAD.size or len(content) - begin < MESSAGE_HEAD.size:
        raise Unsound("a message is shorter than its head")
    head = MESSAGE_HEAD.unpack_from(content, begin)
    if head[2] > LATEST_NS:
        raise Unsound("a message was logged at a time beyond those of ROS")
    return head


def check_held(what: str, size: int) -> None:
    """Raises Unsound if something is too large to be held in memory."""
    if size > HELD_LIMIT:
        raise Unsound(f"{what} of {size} bytes is larger than the limit of {HELD_LIMIT}")


class ChunkHead(NamedTuple):
    """What a chunk says of itself, and what the index of the file repeats."""

    start_ns: int
    end_ns: int
    size: int  # after decompression
    length: int  # of the whole record in the file


def chunk_content(stream: BinaryIO, position: int, end: int) -> tuple[ChunkHead, bytes, bool]:
    """Head of a chunk, its records, decompressed, and whether it has a checksum, which is then right.

    Raises:
        Unsound: the chunk is not what its head says, or larger than the limit; nothing that large is allocated.
    """
    try:
        start_ns, end_ns, size, expected, names = CHUNK_HEAD.unpack(read(stream, position + RECORD_HEAD.size, CHUNK_HEAD.size))
        compression = stream.read(names).decode("ascii", "replace")
        (length,) = LENGTH.unpack(stream.read(LENGTH.size))
    except struct.error as error:
        raise CutShort("the file ends within a chunk") from error
    check_held("a chunk", max(size, length))
    stored = stream.read(length)
    try:
        if compression == "zstd":
            declared = zstandard.frame_content_size(stored)
            if declared not in (-1, size):  # the size that a frame declares is allocated before it is read
                raise Unsound(f"a chunk of {size} bytes declares {declared}")
            raw = zstandard.ZstdDecompressor().decompress(stored, max_output_size=size, allow_extra_data=False) if size else b""
        elif compression == "lz4":
            raw = lz4.frame.LZ4FrameDecompressor().decompress(stored, max_length=size + 1)
        elif compression == "":
            raw = stored
        else:
            raise Unsound(f"a chunk is compressed by {compression!r}, expected zstd, lz4 or nothing")
    except (zstandard.ZstdError, RuntimeError, ValueError, EOFError) as error:
        raise Unsound("a chunk cannot be decompressed") from error
    if len(raw) != size:
        raise Unsound(f"a chunk has {len(raw)} bytes, expected {size}")
    if expected and zlib.crc32(raw) != expected:
        raise Unsound("a chunk fails its checksum")
    return ChunkHead(start_ns, end_ns, size, end - position), raw, bool(expected)


class _Fields:
    """Reads the content of a record; raises Unsound if it ends too early."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._position = 0

    def number(self, size: int) -> int:
        return int.from_bytes(self.raw(size), "little")

    def raw(self, size: int) -> bytes:
        begin, self._position = self._position, self._position + size
        if self._position > len(self._content):
            raise Unsound("a record is shorter than what it holds")
        return self._content[begin : self._position]

    def sized(self) -> bytes:
        return self.raw(self.number(4))

    def text(self) -> str:
        try:
            text = self.sized().decode()
        except UnicodeDecodeError as error:
            raise Unsound("a text in a record is not UTF-8") from error
        if "\0" in text:  # as in a sector that was never written
            raise Unsound("a text in a record holds zeros")
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
            raise Unsound("a record is longer than what it holds")


def header_of(content: bytes) -> tuple[str, str]:
    """Profile and library."""
    fields = _Fields(content)
    found = fields.text(), fields.text()
    fields.finish()
    return found


def schema_of(content: bytes) -> tuple[int, Schema]:
    fields = _Fields(content)
    number, schema = fields.number(2), Schema(fields.text(), fields.text(), fields.sized())
    fields.finish()
    if number == 0:
        raise Unsound("a schema has the number 0")
    return number, schema


def channel_of(content: bytes) -> tuple[int, Channel]:
    fields = _Fields(content)
    number, schema_id = fields.number(2), fields.number(2)
    channel = Channel(schema_id, fields.text(), fields.text(), fields.texts())
    fields.finish()
    return number, channel


def metadata_of(content: bytes) -> tuple[str, dict[str, str]]:
    fields = _Fields(content)
    name, texts = fields.text(), fields.texts()
    fields.finish()
    return name, texts


def index_of(content: bytes) -> "tuple[int, array[int]]":
    """The channel of a message index; log time and place in the chunk of each of its messages, in turn."""
    fields = _Fields(content)
    channel_id, entries = fields.number(2), fields.sized()
    fields.finish()
    if len(entries) % _INDEX_ENTRY.size:
        raise Unsound("a message index is not what its length says")
    found = array("Q", entries)
    if sys.byteorder == "big":
        found.byteswap()
    return channel_id, found


def chunk_index_of(content: bytes) -> ChunkHead:
    """What the index of the file says of a chunk."""
    fields = _Fields(content)
    start_ns, end_ns = fields.number(8), fields.number(8)
    fields.raw(8)
    length = fields.number(8)
    fields.sized()
    fields.raw(8)
    fields.sized()
    fields.raw(8)
    found = ChunkHead(start_ns, end_ns, fields.number(8), length)
    fields.finish()
    return found


def statistics_of(content: bytes) -> Statistics:
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
        raise Unsound("an attachment is not what its length says")


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
    HEADER: header_of,
    FOOTER: _parts(8, 8, 4),
    SCHEMA: schema_of,
    CHANNEL: channel_of,
    MESSAGE_INDEX: _parts(2, None),
    CHUNK_INDEX: chunk_index_of,
    ATTACHMENT_INDEX: _parts(8, 8, 8, 8, 8, None, None),
    STATISTICS: statistics_of,
    METADATA: metadata_of,
    METADATA_INDEX: _parts(8, 8, None),
    SUMMARY_OFFSET: _parts(1, 8, 8),
    DATA_END: _parts(4),
}
