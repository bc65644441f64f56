"""The records of MCAP files, each checked before it is trusted.

The format is that of https://mcap.dev/spec. A chunk is trusted if its checksum is right, and any other record if its inner
lengths add up to its outer one. The library mcap reads the small records; chunks are read here, within limits.
"""

import io
import struct
import sys
import zlib
from array import array
from collections.abc import Callable, Iterator
from typing import BinaryIO, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

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
_INDEX_HEAD = struct.Struct("<HI")  # channel, length of the entries
_INDEX_ENTRY = struct.Struct("<QQ")  # log time, place in the chunk
LENGTH = struct.Struct("<Q")
CHANNEL_ID = struct.Struct("<H")


class Unsound(Exception):
    """Bytes that do not follow the format; the text says why."""


class CutShort(Unsound):
    """A record within which the file ends."""


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
        _check_attachment(stream, length)
    elif code < FIRST_PRIVATE:
        if length > RECORD_LIMIT:
            raise Unsound(f"a record is longer than {RECORD_LIMIT} bytes")
        content = stream.read(length)
        index_of(content) if code == MESSAGE_INDEX else parsed(code, content)
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

    @classmethod
    def of_index(cls, index: ChunkIndex) -> "ChunkHead":
        return cls(index.message_start_time, index.message_end_time, index.uncompressed_size, index.chunk_length)


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


def parsed(code: int, content: bytes) -> McapRecord:
    """A record that is no chunk, message, message index or attachment.

    Raises:
        Unsound: writing what was read does not give the same bytes again; or a text holds zeros, as a sector does that was
            never written.
    """
    again = RecordBuilder()
    try:
        record = _READERS[code](ReadDataStream(io.BytesIO(content)))
        record.write(again)
    except (McapError, struct.error, UnicodeError) as error:
        raise Unsound("a record is not what its length says") from error
    if again.end()[RECORD_HEAD.size :] != content:
        raise Unsound("a record is not what its length says")
    texts = [value for value in vars(record).values() if isinstance(value, str)]
    for mapping in (value for value in vars(record).values() if isinstance(value, dict)):
        texts += [text for item in mapping.items() for text in item if isinstance(text, str)]
    if any("\0" in text for text in texts):
        raise Unsound("a text in a record holds zeros")
    if isinstance(record, Schema) and record.id == 0:
        raise Unsound("a schema has the number 0")
    return record


def definition_of(schema: Schema) -> Definition:
    """The text of a schema; bytes that are not UTF-8 are replaced."""
    return Definition(schema.encoding, schema.data.decode("utf-8", "replace"))


def index_of(content: bytes) -> "tuple[int, array[int]]":
    """The channel of a message index; log time and place in the chunk of each of its messages, in turn."""
    entries = content[_INDEX_HEAD.size :]
    if len(content) < _INDEX_HEAD.size or len(entries) % _INDEX_ENTRY.size:
        raise Unsound("a message index is not what its length says")
    channel_id, size = _INDEX_HEAD.unpack_from(content)
    if size != len(entries):
        raise Unsound("a message index is not what its length says")
    found = array("Q", entries)
    if sys.byteorder == "big":
        found.byteswap()
    return channel_id, found


def _check_attachment(stream: BinaryIO, length: int) -> None:
    fields = ReadDataStream(io.BytesIO(stream.read(min(length, 16 + RECORD_LIMIT))))
    try:
        fields.read(16)
        fields.read_prefixed_string()
        fields.read_prefixed_string()
        size = fields.read8()
    except (McapError, struct.error, UnicodeError) as error:
        raise Unsound("an attachment is not what its length says") from error
    if fields.count + size + 4 != length:
        raise Unsound("an attachment is not what its length says")


_READERS: dict[int, Callable[[ReadDataStream], McapRecord]] = {
    HEADER: Header.read,
    FOOTER: Footer.read,
    SCHEMA: Schema.read,
    CHANNEL: Channel.read,
    CHUNK_INDEX: ChunkIndex.read,
    ATTACHMENT_INDEX: AttachmentIndex.read,
    STATISTICS: Statistics.read,
    METADATA: Metadata.read,
    METADATA_INDEX: MetadataIndex.read,
    SUMMARY_OFFSET: SummaryOffset.read,
    DATA_END: DataEnd.read,
}
