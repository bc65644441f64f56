"""Bags whose files, parts or chunks were lost, doubled, swapped or mixed with those of another recording.

What such a bag holds is known to the message. So a message that vanishes, counts twice or is not of the recording without a
word is a failure.
"""

import functools
import io
import itertools
import pathlib
import shutil
import struct
import zlib
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import yaml
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer

from pushfric_core.bags.bag import Bag
from pushfric_core.bags.contents import FIRST_NUMBER, BagMessage, Topic
from pushfric_core.bags.mcap_file import MAGIC, end_of_record
from pushfric_core.bags.recovery import recover
from pushfric_core.bags.rosbag2_metadata import METADATA

DEMO = pathlib.Path(__file__).resolve().parents[1] / "bags/rubber_rect4"
STRING = "std_msgs/msg/String"

DAMAGES = (
    "nothing", "lost part", "doubled part", "swapped parts", "foreign part", "lost chunk", "doubled chunk", "foreign chunk",
    "exchanged chunk", "swapped chunks", "moved pose", "stale end",
)  # fmt: skip


class Silent(Exception):
    """A message was lost, doubled or taken from elsewhere without a word."""


class Layout(NamedTuple):
    """How a recorder writes, and what is left of it."""

    parts: int
    compression: CompressionType
    chunk_size: int
    numbered: bool
    library: str
    checked: bool  # a checksum over all
    finished: bool
    metadata: bool


@functools.cache
def _topics() -> tuple[Topic, ...]:
    return Bag(DEMO).summary.topics


@functools.cache
def _recorded() -> tuple[BagMessage, ...]:
    return tuple(Bag(DEMO).messages())[:600]


def _foreign(shift_ns: int) -> tuple[BagMessage, ...]:
    """Another recording of the same cell: other poses at these times, or later or earlier."""
    return tuple(
        one._replace(log_time_ns=one.log_time_ns + shift_ns, raw=one.raw[:-3] + bytes([one.raw[-3] ^ 85]) + one.raw[-2:])
        for one in _recorded()
    )


def save_mcap(
    path, messages, schema=(STRING, "ros2msg", b"string data"), encoding="cdr", metadata=None, profile="ros2", **options
):
    """A file of one topic as others write it: of each message, the time [ns], its bytes, and perhaps a number."""
    with path.open("wb") as stream:
        writer = Writer(stream, **options)
        writer.start(profile)
        channel = writer.register_channel("/text", encoding, writer.register_schema(*schema), metadata or {})
        for stamp, raw, *number in messages:
            writer.add_message(channel, stamp, raw, stamp, *number)
        writer.finish()


def _file(messages: Sequence[BagMessage], first: Counter[str], layout: Layout, **options: object) -> bytes:
    """An MCAP file; `first` has the next number of each topic."""
    stream = io.BytesIO()
    writer = Writer(stream, layout.chunk_size, layout.compression, enable_data_crcs=layout.checked, **options)
    writer.start(profile="ros2", library=layout.library)
    channels, schemas = {}, {}
    for topic in _topics():
        name, text = topic.type_name, topic.definition.text.encode()
        schemas[name] = schemas.get(name) or writer.register_schema(name, "ros2msg", text)
        marks = {FIRST_NUMBER: str(first[topic.name])} if layout.numbered else {}
        channels[topic.name] = writer.register_channel(topic.name, "cdr", schemas[name], marks)
    for message in messages:
        number = first[message.topic] if layout.numbered else 0
        first[message.topic] += 1
        writer.add_message(channels[message.topic], message.log_time_ns, message.raw, message.log_time_ns, number)
    writer.finish()
    return stream.getvalue()


def files_of(messages: Sequence[BagMessage], first_number: int, layout: Layout, **options: object) -> list[bytes]:
    first = Counter({topic.name: first_number for topic in _topics()})
    edges = np.linspace(0, len(messages), layout.parts + 1).astype(int)
    return [_file(messages[begin:end], first, layout, **options) for begin, end in itertools.pairwise(edges)]


def metadata_of(messages: Sequence[BagMessage], parts: int) -> str:
    """metadata.yaml as rosbag2 writes it, as far as it is used."""
    edges = np.linspace(0, len(messages), parts + 1).astype(int)
    files = [
        {"path": f"bag_{number}.mcap", "message_count": int(end - begin),
         "starting_time": {"nanoseconds_since_epoch": messages[begin].log_time_ns},
         "duration": {"nanoseconds": messages[end - 1].log_time_ns - messages[begin].log_time_ns}}
        for number, (begin, end) in enumerate(itertools.pairwise(edges))
    ]  # fmt: skip
    counts = Counter(message.topic for message in messages)
    information = {
        "version": 9, "storage_identifier": "mcap", "message_count": len(messages), "compression_format": "",
        "compression_mode": "", "relative_file_paths": [file["path"] for file in files], "files": files,
        "topics_with_message_count": [
            {"topic_metadata": {"name": name}, "message_count": count} for name, count in counts.items()
        ],
    }  # fmt: skip
    return yaml.safe_dump({"rosbag2_bagfile_information": information})


def records_of(content: bytes) -> list[tuple[int, int, int]]:
    """Code, begin and end of the records of a file."""
    stream, position, found = io.BytesIO(content), len(MAGIC), []
    while position < len(content) - len(MAGIC):
        end = end_of_record(stream, position, len(content))
        found.append((content[position], position, end))
        position = end
    return found


def chunks_of(content: bytes) -> list[bytes]:
    """The chunks of a file, each with the indexes that follow it."""
    marks = [begin for code, begin, _ in records_of(content) if code in (Opcode.CHUNK, Opcode.DATA_END)]
    return [content[begin:end] for begin, end in itertools.pairwise(marks)]


def with_chunks(content: bytes, chunks: Sequence[bytes], mended: bool) -> bytes:
    """A file with other chunks; mended: its end still finds the summary, and has its checksum."""
    found = records_of(content)
    first = min(begin for code, begin, _ in found if code == Opcode.CHUNK)
    end = next(begin for code, begin, _ in found if code == Opcode.DATA_END)
    data_end, footer = (next(one for one in found if one[0] == code) for code in (Opcode.DATA_END, Opcode.FOOTER))
    start, offsets, _ = struct.unpack("<QQI", content[footer[1] + 9 : footer[2]])
    body = content[:first] + b"".join(chunks)
    moved = len(body) - end
    rest = content[data_end[2] : footer[1]]
    if not mended or not start:
        return body + content[end:]
    last = content[end : data_end[2] - 4] + bytes(4)  # no checksum over all
    head = content[footer[1] : footer[1] + 9] + struct.pack("<QQ", start + moved, offsets + moved if offsets else 0)
    return body + last + rest + head + struct.pack("<I", zlib.crc32(rest + head)) + MAGIC


def _without_checksum(chunk: bytes, messages: Sequence[BagMessage], rng: np.random.Generator) -> bytes:
    """An uncompressed chunk whose checksum is 0 and one of whose poses was moved."""
    poses = [one.raw for one in messages if one.topic.endswith("/object_pose") and one.raw in chunk]
    if not poses:
        return chunk
    pose = poses[int(rng.integers(len(poses)))]
    place = chunk.index(pose) + len(pose) - 400
    changed = bytearray(chunk)
    changed[place + 5] ^= 1 << int(rng.integers(8))
    changed[33:37] = bytes(4)  # the checksum
    return bytes(changed)


def try_one(seed: int, folder: pathlib.Path, what: str = "") -> str:
    """Make a bag, damage it, and read it; return what was done.

    Args:
        seed: of everything.
        folder: where files are written.
        what: one of DAMAGES; empty: drawn.
    Raises:
        Silent: something vanished or came in without a word.
    """
    rng = np.random.default_rng(seed)
    what = what or DAMAGES[int(rng.integers(len(DAMAGES)))]
    layout = Layout(
        parts=int(rng.choice([1, 3])) if "part" not in what else 3,
        compression=CompressionType.NONE if what == "moved pose" else list(CompressionType)[int(rng.integers(3))],
        chunk_size=int(rng.choice([2**12, 2**14])),
        numbered=bool(rng.integers(2)),
        library=str(rng.choice(["pushfric", "libmcap 1.2"])),
        checked=what == "moved pose" or bool(rng.integers(2)),
        finished=bool(rng.integers(2)) or "part" in what or what == "nothing",
        metadata=bool(rng.integers(2)),
    )
    case = f"seed {seed}: {what}, {layout}"
    messages, far = _recorded(), int(rng.choice([-86_400, -600, 600, 86_400])) * 10**9
    # without numbers, nothing but the time distinguishes recordings of one cell
    foreign = _foreign(far if not layout.numbered or rng.random() < 0.5 else 0)
    files = files_of(messages, int(rng.integers(1, 2**30)), layout)
    others = files_of(foreign, int(rng.integers(2**30 + 2**21, 2**31)), layout)
    names = [f"bag_{number}.mcap" for number in range(layout.parts)]
    one, other = (int(each) for each in rng.choice(layout.parts, 2, replace=layout.parts == 1))
    if what == "lost part":
        del files[one], names[one]
        if one < layout.parts - 1 and not layout.metadata and rng.random() < 0.5:
            names = [f"bag_{number}.mcap" for number in range(len(files))]  # if one of the first, its numbers must show it
            if one == 0:
                names = ["bag_1.mcap", "bag_2.mcap"]
    elif what == "doubled part":
        files.append(files[one])
        names.append(str(rng.choice(["bag_3.mcap", "copy_0.mcap", "bag_01.mcap"])))
    elif what == "swapped parts":
        files[one], files[other] = files[other], files[one]
    elif what == "foreign part":
        files[one] = others[one]
    elif what != "nothing":
        chunks, theirs = chunks_of(files[one]), chunks_of(others[one])
        place, from_ = int(rng.integers(len(chunks))), int(rng.integers(len(theirs)))
        if what == "lost chunk":
            del chunks[place]
        elif what == "doubled chunk":
            chunks.insert(int(rng.integers(len(chunks) + 1)), chunks[place])
        elif what == "foreign chunk":
            chunks.insert(1 + int(rng.integers(len(chunks))), theirs[max(1, from_)])
        elif what == "exchanged chunk":
            place = max(1, place)
            chunks[place] = theirs[min(place, len(theirs) - 1)]
        elif what == "swapped chunks":
            chunks[place], chunks[-1] = chunks[-1], chunks[place]
        elif what == "moved pose":
            chunks[place] = _without_checksum(chunks[place], messages, rng)
        elif what == "stale end":
            place = min(1 + int(rng.integers(len(chunks))), len(chunks) - 1)
            chunks = [*chunks[:place], chunks[place][: len(chunks[place]) // 2], *theirs[min(from_, len(theirs) - 2) :]]
        files[one] = with_chunks(files[one], chunks, bool(rng.integers(2)))
        if not layout.finished:
            files[one] = files[one][: sum(map(len, chunks)) + len(files[one]) // 50]
    bag = folder / "bag"
    shutil.rmtree(bag, ignore_errors=True)
    bag.mkdir()
    for name, content in zip(names, files, strict=True):
        (bag / name).write_bytes(content)
    if layout.metadata:
        (bag / METADATA).write_text(metadata_of(messages, layout.parts))
    _check(bag, messages, case, folder, intact=what == "nothing")
    return what


def _content(bag: Bag) -> Counter[tuple[str, int, bytes]]:
    return Counter((one.topic, one.log_time_ns, one.raw) for one in bag.messages())


def _check(path: pathlib.Path, messages: Sequence[BagMessage], case: str, folder: pathlib.Path, intact: bool) -> None:
    true = Counter((one.topic, one.log_time_ns, one.raw) for one in messages)
    bag = Bag(path)
    read = _content(bag)
    if intact and bag.damage is not None:
        raise Silent(f"{case}: a whole bag is said to be damaged: {bag.damage}")
    if true - read and not (bag.notes or bag.lost or (bag.damage is not None and bag.damage.loses_messages)):
        raise Silent(f"{case}: {sum((true - read).values())} messages vanish: {bag.damage}")
    if read != true and bag.damage is None and not bag.notes:
        raise Silent(f"{case}: what is read is not what was recorded")
    shutil.rmtree(folder / "out", ignore_errors=True)
    recover(path, folder / "out")
    saved = Bag(folder / "out")
    if _content(saved) != read:
        raise Silent(f"{case}: what is recovered is not what is read")
    if saved.damage is None and not (saved.notes or saved.lost) and read != true:
        raise Silent(f"{case}: what is recovered is not what was recorded")
