"""Damaged bags: every lost message is known, all others are saved, and hostile bytes are refused in one line."""

import json
import pathlib
import re
import shutil
import struct

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, Writer
from typer.testing import CliRunner

from pushfric_core.errors import InvalidInput
from pushfric_ros.bags import mcap_file
from pushfric_ros.bags.bag import Bag, DamagedBag
from pushfric_ros.bags.cdr import ARRAY_LIMIT, DEFINITION_LIMIT, Decoder, Definition
from pushfric_ros.bags.contents import BagMessage
from pushfric_ros.bags.mcap_file import CHUNK_LIMIT, MAGIC, McapFile
from pushfric_ros.bags.offered_qos import INFINITE_NS
from pushfric_ros.bags.recovery import recover
from pushfric_ros.commands import cli

DEMO = pathlib.Path(__file__).resolve().parents[3] / "bags/rubber_rect4"
SECTOR = 4096
STRING = "std_msgs/msg/String"


@pytest.fixture
def copy(tmp_path):
    """A copy of the demo's bag, in a folder with the name of the bag."""
    return pathlib.Path(shutil.copytree(DEMO, tmp_path / "bag" / DEMO.name))


def mcap_of(folder: pathlib.Path) -> pathlib.Path:
    return next(folder.glob("*.mcap"))


def zero_sector(folder: pathlib.Path, number: int, content: bytes) -> None:
    begin = number * SECTOR
    size = len(content[begin : begin + SECTOR])
    mcap_of(folder).write_bytes(content[:begin] + bytes(size) + content[begin + size :])


def messages_of(path: pathlib.Path) -> list[BagMessage]:
    return list(Bag(path).messages())


# --- sectors ---


def test_what_a_lost_sector_takes_along_is_known_to_the_message(copy, tmp_path):
    content, original = mcap_of(copy).read_bytes(), messages_of(copy)
    sectors = range(-(-len(content) // SECTOR))
    saved = []
    for number in (0, 1, *sectors[2:-3:6], *sectors[-3:]):
        zero_sector(copy, number, content)
        bag = Bag(copy)
        assert bag.damage is not None, f"sector {number}"
        read = list(bag.messages())
        assert not bag.damage.contradictions
        assert sum(bag.damage.missing.values()) == len(original) - len(read)
        assert bag.damage.loses_messages == (len(read) < len(original))
        remaining = iter(original)
        assert all(message in remaining for message in read)  # a part of them, in the same order
        kept = set(read)
        lost = [message for message in original if message not in kept]
        for topic, count in bag.damage.missing.items():
            assert sum(message.topic == topic for message in lost) == count
        for message in lost:
            assert any(
                (gap.after_ns is None or gap.after_ns <= message.log_time_ns)
                and (gap.before_ns is None or message.log_time_ns <= gap.before_ns)
                for _, gap in bag.damage.gaps
            )
        out = tmp_path / f"saved {number}"
        recover(copy, out)
        assert Bag(out).damage is None
        assert messages_of(out) == read
        saved.append(len(read) / len(original))
    assert np.mean(saved) >= 0.97


def estimated(bag, *options):
    """The number of data points, and what is said of the bag."""
    run = CliRunner().invoke(cli.app, ["estimate", str(bag), *options, "--json"])
    assert run.exit_code == 0
    return json.loads(run.stdout)["data_points"], run.stderr


def test_estimate_refuses_what_is_missing_unless_told_otherwise(copy):
    whole, _ = estimated(copy)
    content = mcap_of(copy).read_bytes()
    zero_sector(copy, 20, content)
    expected = r"messages are missing: \d+ of /cell/.* from \d+\.\d+ s to \d+\.\d+ s"
    for command in (["estimate"], ["region"], ["replay", "--headless"]):
        run = CliRunner().invoke(cli.app, [*command, str(copy)])
        assert isinstance(run.exception, DamagedBag)
        assert re.search(expected, str(run.exception))
    partial, said = estimated(copy, "--partial")
    assert "messages are missing" in said
    assert whole / 2 < partial <= whole


def test_damage_that_loses_nothing_is_a_warning(copy):
    whole, _ = estimated(copy)
    content = mcap_of(copy).read_bytes()
    zero_sector(copy, len(content) // SECTOR - 1, content)  # in the summary
    damaged, said = estimated(copy)
    assert "the bag is damaged, no message is missing" in said
    assert damaged == whole


@pytest.mark.parametrize(
    ("damage", "code"), [(None, 0), (lambda content: content[:100_000], 1), (lambda content: b"no bag at all", 2)]
)
def test_verify_says_whether_a_bag_is_whole(copy, damage, code, monkeypatch, capfd):
    recorded = len(list(Bag(copy).messages()))
    if damage is not None:
        mcap_of(copy).write_bytes(damage(mcap_of(copy).read_bytes()))
    monkeypatch.setattr("sys.argv", ["pushfric", "bag", "verify", str(copy), "--json"])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert (end.value.code or 0) == code
    out, _ = capfd.readouterr()
    if code < 2:
        said = json.loads(out)
        assert said["whole"] == (code == 0)
        assert said["messages"] + sum(said["missing"].values()) == recorded
        assert bool(said["gaps"]) == (code == 1)


# --- hostile bytes ---


def record(code: int, content: bytes) -> bytes:
    return struct.pack("<BQ", code, len(content)) + content


def chunk(compression: str, stored: bytes, size: int, checksum: int = 0) -> bytes:
    name = compression.encode()
    head = struct.pack("<QQQII", 1, 1, size, checksum, len(name)) + name + struct.pack("<Q", len(stored))
    return record(mcap_file.CHUNK, head + stored)


HEADER = MAGIC + record(mcap_file.HEADER, struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0))


@pytest.mark.parametrize(
    ("stored", "compression", "size", "reason"),
    [
        (zstandard.compress(b"x" * 1000), "zstd", 20 * 2**30, "larger than the limit"),
        (zstandard.compress(b"x" * 1000), "zstd", 999, "a chunk of 999 bytes declares 1000"),
        (lz4.frame.compress(b"x" * 10**7), "lz4", 100, "a chunk has 101 bytes, expected 100"),
        (b"\x04\x22\x4d\x18nonsense", "lz4", 100, "cannot be decompressed"),
        (b"nonsense", "zstd", 100, "cannot be decompressed"),
        (b"x" * 10, "", 11, "a chunk has 10 bytes, expected 11"),
        (b"x" * 10, "brotli", 10, "compressed by 'brotli'"),
        (b"x" * 10, "", 10, "reaches beyond the end of its chunk"),
        (record(mcap_file.MESSAGE, b"x" * 21), "", 30, "shorter than its head"),
        (record(mcap_file.MESSAGE, struct.pack("<HIQQ", 1, 0, 2**63, 0)), "", 31, "beyond those of ROS"),
    ],
)
def test_a_chunk_that_lies_is_left_out(tmp_path, stored, compression, size, reason):
    path = tmp_path / "hostile.mcap"
    path.write_bytes(HEADER + chunk(compression, stored, size))
    gaps = McapFile(path).gaps
    assert reason in gaps[0].reason
    assert recover(path, tmp_path / "out").summary.message_count == 0


def test_a_frame_that_declares_20_gib_is_not_allocated(tmp_path):
    """A frame's own header decides what the decompressor allocates, whatever the chunk says."""
    frame = bytearray(zstandard.ZstdCompressor().compress(b"x" * 2**17))  # a size of four bytes
    assert zstandard.frame_content_size(bytes(frame)) == 2**17
    where = bytes(frame).index(struct.pack("<I", 2**17))
    frame[where : where + 4] = struct.pack("<I", 2**32 - 1)
    path = tmp_path / "hostile.mcap"
    path.write_bytes(HEADER + chunk("zstd", bytes(frame), CHUNK_LIMIT))
    assert f"a chunk of {CHUNK_LIMIT} bytes declares {2**32 - 1}" in McapFile(path).gaps[0].reason


def write_with(
    path: pathlib.Path, qos: str = "", definition: bytes = b"string data", raw: bytes = b"\0\1\0\0\2\0\0\0a\0"
) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        schema = writer.register_schema(STRING, "ros2msg", definition)
        writer.add_message(writer.register_channel("/text", "cdr", schema, {"offered_qos_profiles": qos}), 1, raw, 1)
        writer.finish()


QOS = """
- {history: keep_last, depth: 1, reliability: reliable, durability: volatile, liveliness: automatic,
   deadline: {sec: 1, nsec: 0}, lifespan: {sec: 1, nsec: 0}, liveliness_lease_duration: {sec: %s, nsec: 0}}
"""


@pytest.mark.parametrize("seconds", ["aaaaaaaaaa", "-1", "1.5", "[]", "null", "'9'", "0x" + "f" * 5000, "!!int ''", "*a"])
def test_a_duration_that_is_none_is_refused(tmp_path, seconds):
    write_with(tmp_path / "hostile.mcap", QOS % seconds)
    with pytest.raises(InvalidInput, match="/text has QoS profiles that are not those of rosbag2: "):
        Bag(tmp_path / "hostile.mcap")


def test_a_duration_beyond_those_of_ros_has_no_limit(tmp_path):
    write_with(tmp_path / "long.mcap", QOS % (2**62))
    (topic,) = Bag(tmp_path / "long.mcap").summary.topics
    assert topic.qos_profiles[0].liveliness_lease_duration == INFINITE_NS


@pytest.mark.parametrize(
    ("definition", "raw", "error", "expected"),
    [
        (b"string data", b"", ValueError, "not a std_msgs/msg/String: "),
        (b"string data", b"\0\1\0\0\xff\xff\xff\x7fa\0", ValueError, "not a std_msgs/msg/String: "),
        (b"string data", b"\0\1\0\0\2\0\0\0\xff\0", ValueError, "not a std_msgs/msg/String: "),
        (b"string[] data", b"\0\1\0\0\xff\xff\xff\xff", ValueError, "not a std_msgs/msg/String: "),
        (b"String data", b"\0\1\0\0", InvalidInput, "definition of it is not understood"),
        (b"strange data", b"\0\1\0\0", InvalidInput, "definition of it is not understood"),
        (b"string[1000000000] data", b"\0\1\0\0", InvalidInput, f"expected at most {ARRAY_LIMIT}"),
        (b"# " * DEFINITION_LIMIT, b"\0\1\0\0", InvalidInput, f"expected at most {DEFINITION_LIMIT}"),
        (b"float64 import\nfloat64 class", b"\0\1\0\0" + bytes(8), ValueError, "not a std_msgs/msg/String"),
    ],
)
def test_what_cannot_be_taken_apart_is_refused(tmp_path, definition, raw, error, expected):
    write_with(tmp_path / "hostile.mcap", definition=definition, raw=raw)
    bag = Bag(tmp_path / "hostile.mcap")
    (message,) = bag.messages()
    with pytest.raises(error, match=expected):
        bag.deserialize(message)


@pytest.mark.parametrize("name", ["String", "a/b", "a/msg/B\nMSG: c", "../x/msg/Y", "a/msg/B'"])
def test_a_type_name_that_is_none_is_refused(name):
    with pytest.raises(InvalidInput, match="is not one of ROS 2, expected package/msg/Type"):
        Decoder(name, Definition("ros2msg", "string data"))


def test_random_bytes_do_no_harm(copy, tmp_path, rng):
    """Flipped, zeroed, doubled and removed bytes, everywhere in a bag."""
    content = mcap_of(copy).read_bytes()[-60_000:]
    start = mcap_of(copy).read_bytes()[:6_000]
    for number in range(60):
        damaged = bytearray(start + content)
        for _ in range(int(rng.integers(1, 4))):
            begin = int(rng.integers(len(damaged)))
            size = int(rng.integers(1, 2000))
            damaged[begin : begin + size] = [
                rng.bytes(size), bytes(size), b"", bytes(damaged[begin : begin + size]) * 2, b"\xff" * size,
            ][int(rng.integers(5))]  # fmt: skip
        path = tmp_path / "hostile.mcap"
        path.write_bytes(damaged)
        try:
            bag = recover(path, tmp_path / str(number))
        except InvalidInput as error:
            assert len(str(error).splitlines()) == 1  # noqa: PT017
        else:
            assert Bag(tmp_path / str(number)).summary.message_count == bag.summary.message_count


def test_a_checksum_over_all_covers_what_has_none(tmp_path):
    path = tmp_path / "loose.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=False, enable_data_crcs=True)
        writer.start(profile="ros2")
        channel = writer.register_channel("/text", "cdr", writer.register_schema(STRING, "ros2msg", b"string data"))
        writer.add_message(channel, 1, b"\0\1\0\0\5\0\0\0kept\0", 1)
        writer.finish()
    assert Bag(path).damage is None
    path.write_bytes(path.read_bytes().replace(b"kept", b"lost"))
    damage = Bag(path).damage
    assert damage.loses_messages
    assert damage.gaps[0].gap.reason == "the data section fails its checksum"
