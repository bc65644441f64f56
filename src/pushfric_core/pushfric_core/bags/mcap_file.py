"""The sound parts of an MCAP file; after damage, reading resumes at the next sound record."""

import itertools
import pathlib
import re
import struct
from array import array
from bisect import bisect_right, insort
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, BinaryIO, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
from mcap.records import Channel, ChunkIndex, DataEnd, Header, McapRecord, Metadata, Schema, Statistics

from pushfric_core.bags import salvage
from pushfric_core.bags.agreement import AMBIGUOUS
from pushfric_core.bags.cdr import Decoder
from pushfric_core.bags.contents import (
    LAST_READ,
    LAST_SAVED,
    LONG_PAUSE_NS,
    LONG_PAUSE_RATIO,
    Entries,
    Standing,
    in_order,
)
from pushfric_core.bags.mcap_records import (
    ATTACHMENT,
    BLOCK,
    CHANNEL,
    CHANNEL_ID,
    CHUNK,
    CHUNK_HEAD,
    FOOTER,
    HELD_LIMIT,
    LAST_KNOWN,
    LATEST_NS,
    LENGTH,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    RECORD_HEAD,
    SCHEMA,
    ChunkHead,
    CutShort,
    Unsound,
    checksum_of,
    chunk_content,
    definition_of,
    index_of,
    message_head,
    parsed,
    read,
    records,
    sound_record,
)
from pushfric_core.errors import InvalidInput

UNCONFIRMED = "pushfric_unconfirmed"
"""In the metadata of a channel: why nothing confirms its messages. So the mark comes with the messages, whatever is lost."""

Key = TypeVar("Key")

_DEFINITIONS = 1000  # of so many one after the other, one follows the other
_DAY_NS = 86_400 * 10**9

_CANDIDATE = re.compile(rb"[\x01-\x0f](?=[\x00-\xff]{5}\x00\x00\x00)")
"""How a record shorter than 1 TiB begins."""

_LOOSE_RUN = 2**20  # bytes of messages outside chunks that are taken as one piece


_ORDER_NS = {"pushfric": 10**7}
_LOOSE_ORDER_NS = 10**9
"""How far behind a chunk the next one may begin, by library: recorders may write what several threads receive [ns]."""

Standings = npt.NDArray[np.uint8]

STANDINGS = tuple(Standing)  # by value


class Message(NamedTuple):
    """A message as it is stored."""

    log_time_ns: int
    channel_id: int
    data: bytes
    standing: Standing = Standing.SOUND


class Span(NamedTuple):
    """Some messages: how many, and when the first and the last of them were logged [ns]."""

    messages: int
    first_ns: int
    last_ns: int

    def joined(self, other: "Span") -> "Span":
        first, last = min(self.first_ns, other.first_ns), max(self.last_ns, other.last_ns)
        return Span(self.messages + other.messages, first, last)


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


class Piece(NamedTuple):
    """A chunk, or a run of messages outside chunks or in a damaged one."""

    begin: int
    end: int
    head: ChunkHead | None  # of a chunk
    start_ns: int
    end_ns: int
    entries: range  # of its messages
    is_checked: bool  # whether a checksum covers it
    salvaged: bool = False  # whether its checksum says that some of its messages may be wrong

    @property
    def size(self) -> int:
        """Memory held while it is read [bytes]."""
        return self.end - self.begin if self.head is None else self.head.size


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
    library: str = field(default="", init=False)  # that wrote the file
    schemas: dict[int, Schema] = field(default_factory=dict, init=False)
    channels: dict[int, Channel] = field(default_factory=dict, init=False)
    entries: Entries = field(default_factory=Entries, init=False)  # of all messages, in order of `pieces`
    standings: Standings = field(default_factory=lambda: np.zeros(0, np.uint8), init=False)  # of each of them
    pieces: list[Piece] = field(default_factory=list, init=False)
    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list, init=False)  # the file's records of this kind
    gaps: list[Gap] = field(default_factory=list, init=False)
    statistics: Statistics | None = field(default=None, init=False)
    finished: bool = field(default=False, init=False)  # whether the file ends as a finished one does

    def __post_init__(self) -> None:
        self._summary_channels: dict[int, Channel] = {}
        self._summary_schemas: dict[int, Schema] = {}
        self._definitions = 0  # bytes of schemas and channels
        self._redefined: list[tuple[int, dict[int, Schema], dict[int, Channel]]] = []  # in which piece, and what
        self._index: Counter[ChunkHead] = Counter()  # of the chunks
        self._summary: int | None = None  # position where it begins
        self._chunked = False
        self._holds = False  # whether the checksum over all holds
        self._suspects: list[_Suspect] = []  # where intact messages may be
        self._places: dict[int, array[int]] | None = None  # what the indexes of the last chunk must say; None: not known
        with self.path.open("rb") as stream:
            self._survey(stream)
        self.standings = self._judged()

    @property
    def is_damaged(self) -> bool:
        """Whether bytes before the summary are damaged, or missing."""
        return any(self._summary is None or gap.begin < self._summary for gap in self.gaps)

    @property
    def start_ns(self) -> int:
        """The least log time; 0 without messages."""
        return min((piece.start_ns for piece in self.pieces), default=0)

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
        """The messages of the wanted channels in order of log time; those of the same time in the order of the file.

        Args:
            wanted: which channels.
            unconfirmed: also those that are read only on demand.
        Raises:
            OSError: the file can no longer be read.
        """
        last = LAST_SAVED if unconfirmed else LAST_READ
        with self.path.open("rb") as stream:
            yield from in_order(
                (piece.start_ns, piece.begin, partial(self._sorted, stream, piece, wanted, last)) for piece in self.pieces
            )

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
            said = self.statistics
            by_channel = said.channel_message_counts if said is not None else {}
            if said is not None and by_channel and sum(by_channel.values()) != said.message_count:
                self.statistics = None  # damaged, like the end of the file with the checksum
            self.gaps.append(Gap(size, size, "the recording was cut short", self._last_ns(), None))
        elif position < size:
            self.gaps.append(Gap(position, size, "something follows the end of the bag", self._last_ns(), None))
        # the summary repeats the definitions, some of which may have been in lost chunks
        self.channels |= self._summary_channels
        self.schemas |= self._summary_schemas
        confirmed = list(self.pieces)
        for suspect in self._suspects if self._chunked else ():
            self._search(stream, suspect, size, confirmed)

    def _last_ns(self) -> int | None:
        return self.pieces[-1].end_ns if self.pieces else None

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

    def _note_piece(self, begin: int, end: int, head: ChunkHead | None, entries: Entries, is_checked: bool) -> None:
        times = entries.log_times
        piece = Piece(begin, end, head, min(times), max(times), self._note_entries(entries), is_checked)
        self.pieces.append(piece)
        for index in range(len(self.gaps) - 1, -1, -1):
            if self.gaps[index].before_ns is not None:
                break
            self.gaps[index] = self.gaps[index]._replace(before_ns=piece.start_ns)

    def _note_entries(self, entries: Entries) -> range:
        first = len(self.entries)
        if (first + len(entries)) * Entries.SIZE > HELD_LIMIT:
            raise InvalidInput(f"{self.path}: holds more messages than the limit of {HELD_LIMIT // Entries.SIZE}")
        self.entries.extend(entries)
        return range(first, len(self.entries))

    def _note_definitions(self, schemas: dict[int, Schema], channels: dict[int, Channel], in_summary: bool = False) -> None:
        if not in_summary and (schemas or channels):
            self._redefined.append((len(self.pieces), schemas, channels))  # the messages of the next piece follow them
        self._definitions += sum(len(one.data) for one in schemas.values()) + 100 * (len(schemas) + len(channels))
        if self._definitions > HELD_LIMIT:
            raise InvalidInput(f"{self.path}: its definitions of types are larger than the limit of {HELD_LIMIT} bytes")
        for number, schema in schemas.items():
            (self._summary_schemas if in_summary else self.schemas).setdefault(number, schema)
        for number, channel in channels.items():
            (self._summary_channels if in_summary else self.channels).setdefault(number, channel)

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
            expected = self._places.get(channel_id, array("Q"))
            if entries != expected and sorted(zip(entries[::2], entries[1::2], strict=True)) != sorted(
                zip(expected[::2], expected[1::2], strict=True)
            ):
                raise Unsound("a message index contradicts its chunk")
        elif code == FOOTER:
            self._take_footer(stream, position, end)
            return end + len(MAGIC)
        elif code == ATTACHMENT:
            if checksum_of(stream, begin, end - 4) != int.from_bytes(read(stream, end - 4, 4), "little"):
                raise Unsound("an attachment fails its checksum")
        elif code <= LAST_KNOWN and code != MESSAGE_INDEX:
            self._take_small(stream, position, end, parsed(code, read(stream, begin, length)))
        return end

    def _take_small(self, stream: BinaryIO, position: int, end: int, record: McapRecord) -> None:
        in_summary = self._summary is not None
        match record:
            case Header(library=library):
                self.library = library
            case Schema():
                self._note_definitions({record.id: record}, {}, in_summary)
            case Channel():
                self._note_definitions({}, {record.id: record}, in_summary)
            case Statistics():
                self.statistics = record
            case ChunkIndex():
                self._index[ChunkHead.of_index(record)] += 1
            case Metadata():
                self.metadata.append((record.name, record.metadata))
            case DataEnd():
                self._check_data(stream, position, record.data_section_crc)
                self._summary = end

    def _take_chunk(self, stream: BinaryIO, position: int, end: int, size: int) -> None:
        self._places = None
        places: dict[int, array[int]] = {}
        schemas, channels, entries = {}, {}, Entries()
        try:
            head, content, is_checked = chunk_content(stream, position, end)
            view = memoryview(content)
            for code, begin, length in records(content):
                if code == MESSAGE:
                    channel_id, sequence, log_time, _ = message_head(content, begin, length)
                    places.setdefault(channel_id, array("Q")).extend((log_time, begin - RECORD_HEAD.size))
                    entries.append(channel_id, sequence, log_time, view[begin + 2 : begin + length])
                elif code == SCHEMA:
                    schema = parsed(SCHEMA, content[begin : begin + length])
                    schemas[schema.id] = schema
                elif code == CHANNEL:
                    channel = parsed(CHANNEL, content[begin : begin + length])
                    channels[channel.id] = channel
        except Unsound as error:
            # if a sound record follows, the length of the chunk can be trusted, and only the chunk is lost
            try:
                sound_record(stream, end, size)
            except Unsound:
                raise error from None
            self.gaps.append(Gap(position, end, str(error), self._last_ns(), None))
            self._suspects.append(_Suspect(position, end))
            return
        self._places = places
        self._note_definitions(schemas, channels)
        if len(entries):
            self._note_piece(position, end, head, entries, is_checked)

    def _take_loose(self, stream: BinaryIO, position: int, size: int) -> int:
        """Read the messages outside chunks that begin at `position`; return where they end, or where a gap after them ends."""
        taken, begin, entries = [position], position, Entries()
        unsound: Unsound | None = None
        while position < size and position - begin < _LOOSE_RUN:
            try:
                code, length = sound_record(stream, position, size)
            except Unsound as error:
                unsound = error
                break
            if code != MESSAGE:
                break
            content = read(stream, position + RECORD_HEAD.size, length)
            channel_id, sequence, log_time, _ = message_head(content, 0, length)
            if position > begin and position + RECORD_HEAD.size + length - begin > HELD_LIMIT:
                break
            entries.append(channel_id, sequence, log_time, content[2:])
            position += RECORD_HEAD.size + length
            taken.append(position)
        end = position
        if unsound is not None and not isinstance(unsound, CutShort):
            end = taken[-2]  # the last message has no checksum, and the damage after it may have begun in it
            entries.pop()
        if len(entries):
            self._note_piece(begin, end, None, entries, False)
        return position if unsound is None else self._skip(stream, end, size, str(unsound), position)

    def _check_data(self, stream: BinaryIO, position: int, expected: int) -> None:
        if expected and not self.gaps:
            self._holds = checksum_of(stream, 0, position) == expected
            if not self._holds:
                self.gaps.append(Gap(0, position, "the data section fails its checksum", None, None))

    def _take_footer(self, stream: BinaryIO, position: int, end: int) -> None:
        summary, _, expected = struct.unpack("<QQI", read(stream, position + 9, 20))
        self.finished = True
        if read(stream, end, len(MAGIC)) != MAGIC:
            self.finished = False
            raise Unsound("the file does not end as an MCAP file")
        if summary and expected and (summary > position or checksum_of(stream, summary, position + 25) != expected):
            self.gaps.append(Gap(min(summary, position), position, "the summary fails its checksum", self._last_ns(), None))
            self.statistics = None
            self._summary_channels, self._summary_schemas, self._index = {}, {}, Counter()

    def _search(self, stream: BinaryIO, suspect: _Suspect, size: int, confirmed: list[Piece]) -> None:
        """Search a damaged part of the file for intact messages."""
        region = self._region(stream, suspect, size, confirmed)
        if region is None:
            return
        found = salvage.intact(region, self.channels.keys())
        self.channels = found.channels | self.channels
        self.schemas = found.schemas | self.schemas
        for run in found.runs:
            content, entries = read(stream, run.begin, run.end - run.begin), Entries()
            for _, begin, length in records(content):
                channel_id, sequence, log_time, _ = message_head(content, begin, length)
                entries.append(channel_id, sequence, log_time, content[begin + 2 : begin + length])
            first, last = min(entries.log_times), max(entries.log_times)
            self.pieces.append(Piece(run.begin, run.end, None, first, last, self._note_entries(entries), False, salvaged=True))

    def _region(self, stream: BinaryIO, suspect: _Suspect, size: int, confirmed: list[Piece]) -> salvage.DamagedPart | None:
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
        return salvage.DamagedPart(begin, read(stream, begin, end - begin), opened, end < size, first, last, index)

    def _index_after(self, stream: BinaryIO, position: int, size: int) -> dict[int, dict[int, int]]:
        """The message index that follows a chunk, as far as it is sound."""
        found = {}
        try:
            while position < size:
                code, length = sound_record(stream, position, size)
                if code != MESSAGE_INDEX:
                    break
                channel_id, entries = index_of(read(stream, position + RECORD_HEAD.size, length))
                found[channel_id] = dict(zip(entries[1::2], entries[::2], strict=True))
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

    def _sorted(self, stream: BinaryIO, piece: Piece, wanted: Callable[[int], bool], last: Standing) -> Iterator[Message]:
        """The messages of a piece in order of log time, up to a standing."""
        standings = [STANDINGS[value] for value in self.standings[piece.entries.start : piece.entries.stop].tolist()]
        channels = set(self.entries.channels[piece.entries.start : piece.entries.stop])
        if all(standing > last for standing in set(standings)) or not any(map(wanted, channels)):
            return
        times = self.entries.log_times[piece.entries.start : piece.entries.stop]
        try:
            content = self._content(stream, piece)
            places = array("Q", (begin for code, begin, _ in records(content) if code == MESSAGE))
        except Unsound as error:
            raise OSError(0, f"changed while it was read ({error})") from error
        if len(places) != len(times):
            raise OSError(0, "changed while it was read")
        for number in np.argsort(np.asarray(times), kind="stable").tolist():
            begin = places[number]
            (channel_id,) = CHANNEL_ID.unpack_from(content, begin)
            if wanted(channel_id) and standings[number] <= last:
                (length,) = LENGTH.unpack_from(content, begin - LENGTH.size)
                data = content[begin + MESSAGE_HEAD.size : begin + length]
                yield Message(times[number], channel_id, data, standings[number])

    def _content(self, stream: BinaryIO, piece: Piece) -> bytes:
        if piece.head is not None:
            return chunk_content(stream, piece.begin, piece.end)[1]
        return read(stream, piece.begin, piece.end - piece.begin)

    # --- what speaks against messages ---

    def _judged(self) -> Standings:
        """The standing of each message, as far as this file alone shows it."""
        found = np.zeros(len(self.entries), np.uint8)
        channels = np.asarray(self.entries.channels)
        unchecked = self.is_damaged and not self._holds
        for piece in self.pieces:
            if piece.salvaged:
                found[piece.entries] = Standing.SALVAGED
            elif unchecked and not piece.is_checked:
                found[piece.entries] = Standing.UNCHECKED
        marked = [number for number, channel in self.channels.items() if UNCONFIRMED in channel.metadata]
        found[np.isin(channels, marked) & (found == Standing.SOUND)] = Standing.MARKED
        if strangers := self._strangers():
            strange = np.zeros(len(found), bool)
            for number in strangers:
                strange[self.pieces[number].entries] = True
            digests = np.asarray(self.entries.digests)
            if (strange & ~np.isin(digests, digests[~strange])).sum() > AMBIGUOUS * len(found):
                found[found == Standing.SOUND] = Standing.UNCHECKED  # nothing shows which recording is that of the file
            found[strange] = Standing.FOREIGN
        unknown = ~np.isin(channels, list(self.channels))
        found[unknown] = Standing.UNKNOWN
        return found

    def _strangers(self) -> set[int]:
        """The pieces that belong to another recording.

        They define a channel otherwise than the rest of the file, or the file's index does not list them. Where the file has no
        index, they break the order of time, which all other chunks keep.
        """
        found = set()
        for number, schemas, channels in self._redefined:
            if any(self.schemas[one] != schema for one, schema in schemas.items()) or any(
                self.channels[one] != channel for one, channel in channels.items()
            ):
                found.add(number)
        found &= {*range(len(self.pieces))}
        sound = [number for number, piece in enumerate(self.pieces) if not piece.salvaged]
        if self.finished and self._index:
            listed = Counter(self._index)
            for number in sound:
                head = self.pieces[number].head
                if head is not None and not listed[head]:
                    found.add(number)
                elif head is not None:
                    listed[head] -= 1
            return found
        tolerance = _ORDER_NS.get(self.library, _LOOSE_ORDER_NS)
        pieces = [self.pieces[number] for number in sound]
        return found | {sound[number] for number in self._disordered(pieces, tolerance)}

    def _disordered(self, pieces: Sequence[Piece], tolerance_ns: int) -> set[int]:
        """The pieces outside the longest part of the file that keeps the order of time, and those as likely to be so."""
        in_order_ = _longest(pieces, tolerance_ns)
        if self.gaps and len(in_order_) > 2:
            in_order_ = self._largest_part(pieces, in_order_)
        kept, left_out = set(in_order_), []
        for number, piece in enumerate(pieces):
            if number in kept:
                continue
            left_out.append(number)
            place = bisect_right(in_order_, number)
            against = [one for one in in_order_[max(0, place - 2) : place] if not _follow(pieces[one], piece, tolerance_ns)]
            against += [one for one in in_order_[place : place + 2] if not _follow(piece, pieces[one], tolerance_ns)]
            if len(against) == 1 and not self._copies(piece, pieces[against[0]]):
                left_out.append(against[0])  # one of the two is wrong, and nothing shows which
        return set(left_out)

    def _largest_part(self, pieces: Sequence[Piece], numbers: list[int]) -> list[int]:
        """The largest part of a damaged file between pauses that no recording has."""
        pauses = [pieces[after].start_ns - pieces[before].end_ns for before, after in itertools.pairwise(numbers)]
        usual = sorted(pauses)[-2]
        parts: list[list[int]] = [[numbers[0]]]
        for number, pause in zip(numbers[1:], pauses, strict=True):
            if pause > max(LONG_PAUSE_NS, LONG_PAUSE_RATIO * usual):
                parts.append([])
            parts[-1].append(number)
        return max(parts, key=lambda part: sum(len(pieces[number].entries) for number in part))

    def _copies(self, first: Piece, second: Piece) -> bool:
        digests = [set(self.entries.digests[one.entries.start : one.entries.stop]) for one in (first, second)]
        return digests[0] <= digests[1] or digests[1] <= digests[0]


def _follow(first: Piece, second: Piece, tolerance_ns: int) -> bool:
    """Whether one piece can stand before another one."""
    return second.start_ns >= first.end_ns - tolerance_ns


def _longest(pieces: Sequence[Piece], tolerance_ns: int) -> list[int]:
    """The pieces that keep the order of time and hold the most messages."""
    best: list[tuple[int, int, int]] = []  # end, messages, piece: the best ends, both numbers growing
    before: dict[int, int] = {}
    for number, piece in enumerate(pieces):
        place = bisect_right(best, (piece.start_ns + tolerance_ns, LATEST_NS, 0))
        count = len(piece.entries)
        if place:
            count += best[place - 1][1]
            before[number] = best[place - 1][2]
        place = bisect_right(best, (piece.end_ns, LATEST_NS, 0))
        if place and best[place - 1][1] >= count:
            continue
        insort(best, (piece.end_ns, count, number))
        place = bisect_right(best, (piece.end_ns, count, number))
        while place < len(best) and best[place][1] <= count:
            del best[place]
    found = [best[-1][2]] if best else []
    while found and found[-1] in before:
        found.append(before[found[-1]])
    return found[::-1]


class GrowingFile:
    """A file that its writer has not finished: what was flushed so far, read on from where the last reading ended.

    Args:
        path: the file; it need not exist yet.
    """

    def __init__(self, path: pathlib.Path) -> None:
        self.path = path
        self.channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._decoders: dict[int, Decoder] = {}  # by channel
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
                    content = chunk_content(stream, self._position, begin + length)[1] if code == CHUNK else b""
                    if code in (SCHEMA, CHANNEL):
                        stream.seek(begin)
                        self._define(code, stream.read(length))
                    for inner, at, size_of in records(content):
                        if inner in (SCHEMA, CHANNEL):
                            self._define(inner, content[at : at + size_of])
                        elif inner == MESSAGE:
                            channel_id, _, log_time, _ = message_head(content, at, size_of)
                            found.append(Message(log_time, channel_id, content[at + MESSAGE_HEAD.size : at + size_of]))
                    self._position = begin + length
        except Unsound as error:
            raise ValueError(f"{self.path}: {error}") from error

    def decoded(self, message: Message) -> Any:
        """The content of a message, by the definition in the file.

        Raises:
            InvalidInput: the definition is missing or cannot be used.
            ValueError: its bytes are not such a message.
        """
        if message.channel_id not in self._decoders:
            schema = self._schemas.get(self.channels[message.channel_id].schema_id)
            if schema is None:
                raise ValueError(f"{self.path}: {self.channels[message.channel_id].topic[:80]} has no type")
            self._decoders[message.channel_id] = Decoder(schema.name, definition_of(schema))
        return self._decoders[message.channel_id](message.data)

    def _define(self, code: int, content: bytes) -> None:
        if code == SCHEMA:
            schema = parsed(SCHEMA, content)
            self._schemas.setdefault(schema.id, schema)
        else:
            channel = parsed(CHANNEL, content)
            self.channels.setdefault(channel.id, channel)
