"""Damaged bags: no loss is silent, whole chunks are saved, and hostile bytes are refused in one line."""

import json
import pathlib
import re
import shutil
import struct
import subprocess
import sys

import numpy as np
import pytest
import rearranged
import zstandard
from calls import invoked
from mcap.opcode import Opcode
from mcap.writer import CompressionType, IndexType
from semantic_damage import Recording

from pushfric_core.bags.bag import Bag, DamagedBag
from pushfric_core.bags.contents import BagMessage, Definition
from pushfric_core.bags.mcap_file import MAGIC, RECORD_LIMIT, McapFile
from pushfric_core.bags.message_types import ARRAY_LIMIT, DEFINITION_LIMIT, decoder
from pushfric_core.bags.recovery import recover
from pushfric_core.errors import InvalidInput

ROOT = pathlib.Path(__file__).resolve().parents[3]
DEMO = ROOT / "bags/rubber_rect4"
SECTOR = 4096


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
    for number in (0, 1, *sectors[2:-3:12], *sectors[-3:]):
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
                for gap in bag.damage.gaps
            )
        out = tmp_path / f"saved {number}"
        recover(copy, out)
        assert Bag(out).damage is None
        assert messages_of(out) == read
        saved.append(len(read) / len(original))
    assert np.mean(saved) >= 0.97


def estimated(bag, *options):
    """The number of observations, and what is said of the bag."""
    run = invoked("estimate", bag, *options, "--json")
    assert run.exit_code == 0
    return json.loads(run.stdout)["data_points"], run.stderr


def test_estimate_refuses_what_is_missing_unless_told_otherwise(copy):
    whole, _ = estimated(copy)
    content = mcap_of(copy).read_bytes()
    zero_sector(copy, 20, content)
    expected = r"messages are missing: \d+ of /cell/.* from \d+\.\d+ s to \d+\.\d+ s"
    for command in (["estimate"], ["region"], ["replay", "--headless"]):
        run = invoked(*command, copy)
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
def test_verify_says_whether_a_bag_is_whole(copy, damage, code, call):
    recorded = len(list(Bag(copy).messages()))
    if damage is not None:
        mcap_of(copy).write_bytes(damage(mcap_of(copy).read_bytes()))
    run = call("bag", "verify", copy, "--json")
    assert run.returncode == code
    if code < 2:
        said = json.loads(run.stdout)
        assert said["whole"] == (code == 0)
        assert said["messages"] + sum(said["missing"].values()) == recorded
        assert bool(said["gaps"]) == (code == 1)


# --- single bytes ---


def recorded_elsewhere(
    messages: list[BagMessage], compression: CompressionType, checked: bool = False, **options: object
) -> bytes:
    """As `ros2 bag record` does it: no numbers, and by default checksums of the chunks and of the summary alone."""
    layout = rearranged.Layout(1, compression, 2**13, False, "libmcap 1.2", checked, True, False)
    return rearranged.files_of(messages, 0, layout, **options)[0]


ELSEWHERE = {
    "zstd": (CompressionType.ZSTD, {}),
    "lz4": (CompressionType.LZ4, {}),
    "uncompressed": (CompressionType.NONE, {}),
    "checked as a whole": (CompressionType.ZSTD, {"checked": True}),
    "without message indexes": (CompressionType.NONE, {"index_types": IndexType.NONE}),
    "without chunks, checked as a whole": (CompressionType.NONE, {"use_chunking": False, "checked": True}),
}


def places_of_each_kind(content: bytes, rng: np.random.Generator, count: int) -> dict[str, list[int]]:
    """Bytes to damage: of each kind of record, of its head and its content, and of the magic at both ends."""
    found = {"magic": [*range(8), *range(len(content) - 8, len(content))]}
    for code, begin, end in rearranged.records_of(content):
        kind = Opcode(code).name
        found.setdefault(f"head of {kind}", []).extend(range(begin, begin + 9))
        found.setdefault(kind, []).extend(range(begin + 9, end))
    filled = {kind: places for kind, places in found.items() if places}
    return {kind: rng.choice(places, min(count, len(places)), replace=False).tolist() for kind, places in filled.items()}


@pytest.mark.parametrize("layout", ["pushfric", *ELSEWHERE])
@pytest.mark.parametrize("finished", [True, False])
def test_no_damaged_byte_of_any_record_is_silent(tmp_path, rng, layout, finished):
    """A bag with a wrong byte is read to the same messages, or is said to be damaged; what it then holds and misses is all."""
    messages = messages_of(DEMO)[:300]
    if layout == "pushfric":
        content = mcap_of(Recording(DEMO).write(tmp_path / "whole", messages)).read_bytes()
    else:
        compression, options = ELSEWHERE[layout]
        content = recorded_elsewhere(messages, compression, **options)
    if not finished:
        content = content[: len(content) * 2 // 3]
    path = tmp_path / "hurt_0.mcap"
    path.write_bytes(content)
    whole = Bag(path)
    topics, original = whole.summary.topics, list(whole.messages())
    assert (whole.damage is None) == finished
    end = len(content) if finished else content.rindex(b"\x06", 0, len(content))
    sampled = places_of_each_kind(content[:end], rng, 8) if finished else {"any": rng.choice(len(content), 80).tolist()}
    assert len(sampled) > (13 if finished else 0)
    for kind, places in sampled.items():
        for place in places:
            hurt = bytearray(content)
            hurt[place] ^= int(rng.integers(1, 256))
            path.write_bytes(hurt)
            what = f"byte {place}, {kind}"
            try:
                bag = Bag(path)
            except InvalidInput:
                continue
            read = list(bag.messages())
            same = read == original and bag.summary.topics == topics
            if not same:
                assert bag.damage is not None, what
                assert bag.damage.loses_messages, what
            if finished and bag.damage is not None and bag.damage.missing is not None and not bag.damage.contradictions:
                assert len(read) + sum(bag.damage.missing.values()) == len(original), what


# --- hostile bytes ---


def record(code: int, content: bytes) -> bytes:
    return struct.pack("<BQ", code, len(content)) + content


def chunk(compression: str, stored: bytes, size: int, checksum: int = 0) -> bytes:
    name = compression.encode()
    head = struct.pack("<QQQII", 1, 1, size, checksum, len(name)) + name + struct.pack("<Q", len(stored))
    return record(Opcode.CHUNK, head + stored)


HEADER = MAGIC + record(Opcode.HEADER, struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0))


@pytest.mark.parametrize(
    ("stored", "compression", "size", "reason"),
    [
        (zstandard.compress(b"x" * 1000), "zstd", 20 * 2**30, "larger than the limit"),
        (b"\x04\x22\x4d\x18nonsense", "lz4", 100, "cannot be decompressed"),
        (b"nonsense", "zstd", 100, "cannot be decompressed"),
        (record(Opcode.MESSAGE, b"x" * 21), "", 30, "cannot be decompressed"),
        (record(Opcode.MESSAGE, struct.pack("<HIQQ", 1, 0, 2**63, 0) + b"x"), "", 32, "beyond those of ROS"),
    ],
)
def test_a_chunk_that_lies_is_left_out(tmp_path, stored, compression, size, reason):
    path = tmp_path / "hostile.mcap"
    path.write_bytes(HEADER + chunk(compression, stored, size))
    gaps = McapFile(path).gaps
    assert reason in gaps[0].reason
    assert recover(path, tmp_path / "out").summary.message_count == 0


QOS = """
- {history: keep_last, depth: 1, reliability: reliable, durability: volatile, liveliness: automatic,
   deadline: {sec: 1, nsec: 0}, lifespan: {sec: 1, nsec: 0}, liveliness_lease_duration: {sec: %s, nsec: 0},
   avoid_ros_namespace_conventions: false}
"""


@pytest.mark.parametrize("seconds", ["aaaaaaaaaa", "-1", "1.5", "[]", "null", "'9'", "0x" + "f" * 5000, "!!int ''", "*a"])
def test_a_duration_that_is_none_is_refused(tmp_path, seconds):
    rearranged.save_mcap(tmp_path / "hostile.mcap", [(1, b"")], metadata={"offered_qos_profiles": QOS % seconds})
    with pytest.raises(InvalidInput, match="/text has QoS profiles that are not those of rosbag2: "):
        Bag(tmp_path / "hostile.mcap")


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
    rearranged.save_mcap(tmp_path / "hostile.mcap", [(1, raw)], (rearranged.STRING, "ros2msg", definition))
    bag = Bag(tmp_path / "hostile.mcap")
    (message,) = bag.messages()
    with pytest.raises(error, match=expected):
        bag.deserialize(message)


@pytest.mark.parametrize("name", ["String", "a/b", "a/msg/B\nMSG: c", "../x/msg/Y", "a/msg/B'"])
def test_a_type_name_that_is_none_is_refused(name):
    with pytest.raises(InvalidInput, match="is not one of ROS 2, expected package/msg/Type"):
        decoder(name, Definition("ros2msg", "string data"))


# --- what belongs together ---


@pytest.mark.parametrize("what", rearranged.DAMAGES)
def test_nothing_vanishes_or_comes_in_without_a_word(tmp_path, what):
    """A sample; `--fuzz MINUTES` of the tests of hostile input tries more. Of a whole bag, nothing is said."""
    for seed in range(3):
        rearranged.try_one(seed, tmp_path, what)


def split(folder: pathlib.Path, metadata: bool = True) -> pathlib.Path:
    """The demo's bag in three files, as `ros2 bag record --max-bag-size` writes them."""
    messages = list(Bag(DEMO).messages())
    folder.mkdir()
    layout = rearranged.Layout(3, CompressionType.ZSTD, 2**16, False, "libmcap 1.2", False, True, metadata)
    for number, content in enumerate(rearranged.files_of(messages, 0, layout)):
        (folder / f"bag_{number}.mcap").write_bytes(content)
    if metadata:
        (folder / "metadata.yaml").write_text(rearranged.metadata_of(messages, 3))
    shutil.copy(DEMO / "object.yaml", folder)
    return folder


def verified(path: pathlib.Path) -> tuple[int, str]:
    """Exit code of `bag verify`, and what it says."""
    run = invoked("bag", "verify", path)
    return run.exit_code, " ".join(run.output.split())


def test_parts_that_do_not_add_up_are_named_and_refused(tmp_path):
    def without_1(folder):
        (folder / "bag_1.mcap").unlink()

    def doubled(folder):
        shutil.copy(folder / "bag_1.mcap", folder / "again.mcap")

    def numbered_twice(folder):
        (folder / "bag_2.mcap").rename(folder / "bag_01.mcap")

    cases = [
        (without_1, True, ["lists bag_1.mcap, which is not there", "messages are missing: "]),
        (doubled, True, ["does not list again.mcap, which lies in the folder and is not read"]),
        (numbered_twice, False, ["not those of one bag, with the numbers 0 to 2: bag_0.mcap, bag_01.mcap, bag_1.mcap"]),
    ]
    for number, (damage, metadata, expected) in enumerate(cases):
        folder = split(tmp_path / str(number), metadata)
        assert verified(folder)[0] == 0
        damage(folder)
        code, said = verified(folder)
        assert code == 1, damage
        for each in expected:
            assert re.search(each, said), (damage, said)
        assert isinstance(invoked("estimate", folder).exception, DamagedBag)


def test_what_cannot_be_known_of_the_last_part_is_said(tmp_path):
    folder = split(tmp_path / "split", metadata=False)
    (folder / "bag_2.mcap").unlink()
    code, said = verified(folder)
    assert (code, Bag(folder).damage) == (1, None)
    assert "the plan is not finished" in said
    assert "without metadata.yaml, nothing says whether a part 2 was recorded" in said
    _, said = estimated(folder, "--partial")
    assert "nothing says whether a part 2 was recorded" in " ".join(said.split())
    recover(folder, tmp_path / "out")
    assert "nothing says whether a part 2 was recorded" in verified(tmp_path / "out")[1]


def test_whole_chunks_are_saved_before_and_after_a_damaged_length(tmp_path):
    """The index shows where the next chunk begins."""
    messages = messages_of(DEMO)
    path = tmp_path / "hurt_0.mcap"
    content = recorded_elsewhere(messages, CompressionType.NONE)
    begins = [begin for code, begin, _ in rearranged.records_of(content) if code == Opcode.CHUNK]
    hurt = bytearray(content)
    hurt[begins[5] + 3] ^= 1  # 64 KiB more
    path.write_bytes(hurt)
    bag = recover(path, tmp_path / "out")
    saved = messages_of(tmp_path / "out")
    lost = sum(bag.damage.missing.values())
    assert 0 < lost < 60
    first = next(number for number, (one, other) in enumerate(zip(messages, saved, strict=False)) if one != other)
    assert saved == messages[:first] + messages[first + lost :]


# --- memory ---


MEASURED = """
import resource, sys
from pushfric_core.bags.bag import Bag
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(sum(1 for _ in Bag(sys.argv[1]).messages()))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def test_large_chunks_of_one_time_are_read_one_after_the_other(tmp_path):
    path = tmp_path / "heavy.mcap"
    messages = ((10**18, bytes(10 * 2**20), number + 1) for number in range(40))  # in chunks of 100 MiB
    rearranged.save_mcap(path, messages, chunk_size=100 * 2**20, compression=CompressionType.LZ4)
    run = subprocess.run([sys.executable, "-c", MEASURED, str(path)], capture_output=True, text=True, check=True, timeout=300)
    messages, kilobytes = map(int, run.stdout.split())
    assert messages == 40
    assert kilobytes < 3 * 100 * 2**10


def test_a_chunk_beyond_the_limit_is_not_read(tmp_path):
    """Whatever is stored is not read before its size is known: here it would be a file of 40 GiB."""
    path = tmp_path / "sparse.mcap"
    size = 40 * 2**30
    head = struct.pack("<QQQII", 1, 1, size, 0, 0) + struct.pack("<Q", size)
    with path.open("wb") as stream:
        stream.write(HEADER + struct.pack("<BQ", Opcode.CHUNK, len(head) + size) + head)
        stream.truncate(len(HEADER) + 9 + len(head) + size)
        stream.seek(0, 2)
        stream.write(record(Opcode.DATA_END, bytes(4)) + record(Opcode.FOOTER, bytes(20)) + MAGIC)
    assert f"bytes is larger than the limit of {RECORD_LIMIT}" in McapFile(path).gaps[0].reason
