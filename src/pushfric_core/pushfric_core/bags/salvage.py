"""Messages in a damaged chunk that is not compressed, as rosbag2 writes them by default: those that the damage did not reach.

The checksum of a chunk says that bytes are wrong, but not which. The head of each record can be checked one by one: its code,
its length, its channel, its time, and that another record follows it. The message index behind the chunk lists the place and
the time of each message. Nothing can be checked in the content of a message. It is taken as intact

1. if its head is right, and if the next record begins right where it ends, and
2. if each block of the file that it touches contains a head that is right. Storage loses whole blocks: a lost one would have
   taken that head along.

A broken head shows where the damage is. If all heads are right, the damage must be in a block without a head, in a long
message. If there is no such block, either, less than a block is damaged, which can be anywhere, and nothing is taken as intact.

None of this is possible in a compressed chunk: what a decompressor returns after damaged bytes depends on them.
"""

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Set
from typing import NamedTuple

from mcap.records import Channel, Schema

from pushfric_core.bags.mcap_records import (
    CHANNEL,
    MESSAGE,
    MESSAGE_HEAD,
    RECORD_HEAD,
    SCHEMA,
    Unsound,
    parsed,
)

LARGEST = 2**26
"""A larger chunk is not searched [bytes]: it holds little else than one message."""

BLOCK, SECTOR = 4096, 512
"""What storage loses as a whole [bytes]: a block, on older disks a sector. Where the damage is not seen, the smaller counts."""

EVIDENCE = 8
"""Least number of bytes of heads that show that a block is not damaged."""

_CANDIDATE = re.compile(rb"[\x03-\x05](?=[\x00-\xff]{4}\x00{4})")
"""How a schema, a channel or a message shorter than 4 GiB begins."""

_CHECKED = ((0, 11), (15, 23))  # the bytes of a message's head that are checked: code, length and channel; log time


class DamagedPart(NamedTuple):
    """A part of a file that contains records and is damaged somewhere."""

    begin: int  # its place in the file
    content: bytes
    opened: bool  # whether it begins with a record, right after the head of the chunk
    closed: bool  # whether its last record ends where it ends, because a sound record follows
    first_ns: int  # no message was logged earlier
    last_ns: int  # or later
    listed: Mapping[int, Mapping[int, int]]  # the message index, as far as it is known: by channel, log times by place


class Run(NamedTuple):
    """Intact messages, one after the other."""

    begin: int  # in the file
    end: int
    messages: list[tuple[int, int]]  # the channel and log time [ns] of each


class Intact(NamedTuple):
    """What is intact in a region."""

    runs: list[Run]
    schemas: dict[int, Schema]
    channels: dict[int, Channel]


class _Record(NamedTuple):
    begin: int  # in the content
    end: int
    code: int
    channel_id: int  # 0 for a definition
    log_time_ns: int


def intact(region: DamagedPart, known: Set[int]) -> Intact:
    """What the damage of a region did not reach.

    Args:
        region: a part of the file.
        known: the channels that are defined elsewhere in the file.
    """
    found = Intact([], {}, {})
    channels = set(known)
    heads: list[_Record] = []  # all that are right
    whole: list[_Record] = []  # those that another record follows
    position, broken = 0, not region.opened
    while position < len(region.content):
        record = _record(region, position, channels)
        if record is None or not _is_followed(region, record, channels):
            if record is not None:
                heads.append(record)
            broken = True
            following = _next(region, position + 1, channels)
            if following is None:
                break
            record = following
        heads.append(record)
        whole.append(record)
        position = record.end
    for record in whole:
        if record.code == SCHEMA:
            schema = parsed(SCHEMA, _content(region, record))
            found.schemas.setdefault(schema.id, schema)
        elif record.code == CHANNEL:
            channel = parsed(CHANNEL, _content(region, record))
            found.channels.setdefault(channel.id, channel)
    size = BLOCK if broken else SECTOR
    shown = _shown(region, heads, size)
    safe = [all(block in shown for block in _blocks(region, one, size)) for one in whole]
    if broken or not all(safe):
        found.runs.extend(_runs(region, [one for one, is_safe in zip(whole, safe, strict=True) if is_safe]))
    return found


def _record(region: DamagedPart, position: int, channels: set[int]) -> _Record | None:
    """The record at a position, if its head is right; the channel that it defines is added."""
    content = region.content
    begin = position + RECORD_HEAD.size
    if begin > len(content):
        return None
    code, length = RECORD_HEAD.unpack_from(content, position)
    if length > len(content) - begin:
        return None
    if code == MESSAGE:
        if length < MESSAGE_HEAD.size:
            return None
        channel_id, _, log_time, _ = MESSAGE_HEAD.unpack_from(content, begin)
        listed = region.listed.get(channel_id)
        if listed is not None:
            right = listed.get(position) == log_time
        else:
            right = channel_id in channels and region.first_ns <= log_time <= region.last_ns
        return _Record(position, begin + length, code, channel_id, log_time) if right else None
    definition = _Record(position, begin + length, code, 0, 0)
    try:
        if code == SCHEMA:
            text = parsed(SCHEMA, _content(region, definition)).data.decode()
            return None if "\0" in text else definition
        if code == CHANNEL:
            channels.add(parsed(CHANNEL, _content(region, definition)).id)
            return definition
    except (Unsound, UnicodeDecodeError):
        return None
    return None


def _content(region: DamagedPart, record: _Record) -> bytes:
    return region.content[record.begin + RECORD_HEAD.size : record.end]


def _is_followed(region: DamagedPart, record: _Record, channels: set[int]) -> bool:
    if record.end == len(region.content):
        return region.closed
    return _record(region, record.end, channels) is not None


def _next(region: DamagedPart, position: int, channels: set[int]) -> _Record | None:
    """The next record that another one follows."""
    for match in _CANDIDATE.finditer(region.content, position):
        record = _record(region, match.start(), channels)
        if record is not None and _is_followed(region, record, channels):
            return record
    return None


def _shown(region: DamagedPart, heads: list[_Record], size: int) -> set[int]:
    """The blocks of the file that contain enough bytes of heads that are right."""
    spans = [(region.begin - RECORD_HEAD.size, region.begin)] * region.opened
    end = region.begin + len(region.content)
    spans += [(end, end + RECORD_HEAD.size)] * region.closed
    for head in heads:
        begin = region.begin + head.begin
        checked = (
            _CHECKED if head.code == MESSAGE else ((0, head.end - head.begin),)
        )  # a definition is text, which shows damage
        spans += [(begin + first, begin + last) for first, last in checked]
    evidence: Counter[int] = Counter()
    for begin, last in spans:
        for block in range(begin // size, (last - 1) // size + 1):
            evidence[block] += min(last, (block + 1) * size) - max(begin, block * size)
    return {block for block, count in evidence.items() if count >= EVIDENCE}


def _blocks(region: DamagedPart, record: _Record, size: int) -> range:
    return range((region.begin + record.begin) // size, (region.begin + record.end - 1) // size + 1)


def _runs(region: DamagedPart, intact: list[_Record]) -> Iterator[Run]:
    run: Run | None = None
    for record in intact:
        if record.code != MESSAGE:
            continue
        if run is None or run.end != region.begin + record.begin:
            if run is not None:
                yield run
            run = Run(region.begin + record.begin, 0, [])
        run = run._replace(end=region.begin + record.end)
        run.messages.append((record.channel_id, record.log_time_ns))
    if run is not None:
        yield run
