"""Bags: what is written is read back, by pushfric and by other readers; a broken bag is refused in one line or rescued."""

import contextlib
import os
import pathlib
import resource
import subprocess
import sys
from collections.abc import Iterator

import pytest
import rearranged
import yaml
from mcap.reader import make_reader
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import String

from pushfric_core.bags.bag import Bag, DamagedBag
from pushfric_core.bags.bag_writer import BagWriter, offered
from pushfric_core.bags.contents import BagMessage
from pushfric_core.bags.recovery import recover
from pushfric_core.errors import InvalidInput
from pushfric_msgs.msg import FrictionEstimate, Hypothesis, Observation, Recognition
from pushfric_ros.messages import types as message_types
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_DATA

OBSERVATION = "pushfric_msgs/msg/Observation"
STRING = "std_msgs/msg/String"


def observation(number: int) -> Observation:
    """An observation whose bounded list is alternately empty and full."""
    msg = Observation(object="rubber_rect4", push_id=number, half_width=0.001 * number)
    msg.header.stamp.sec = number
    msg.header.frame_id = "object"
    msg.contact_point.x = 0.01 * number
    msg.force.x = 1.0 * number
    return msg


def content(message: BagMessage) -> object:
    """What a message says to a reader with the installed types."""
    return deserialize_message(message.raw, message_types.message_class(message.type_name))


def text(data: str) -> bytes:
    return serialize_message(String(data=data))


@contextlib.contextmanager
def too_large_beyond(size: int) -> Iterator[None]:
    """A bag whose file would be larger than this [bytes] cannot be written in here, which is what is expected."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        with pytest.raises(InvalidInput, match="cannot write the bag: File too large"):
            yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def write_texts(folder: pathlib.Path, count: int, flush_every: int = 0) -> list[tuple[int, bytes]]:
    """A bag of strings a microsecond apart; returns their times and bytes."""
    written = [(1000 * number, text(f"message {number}")) for number in range(1, count + 1)]
    with BagWriter(folder) as writer:
        writer.add_topic("/cell/text", STRING, [offered(RELIABLE)])
        for number, (stamp, raw) in enumerate(written, 1):
            writer.write("/cell/text", stamp, raw)
            if flush_every and number % flush_every == 0:
                writer.flush()
    return written


def mcap_of(folder: pathlib.Path) -> pathlib.Path:
    return folder / f"{folder.name}_0.mcap"


@pytest.fixture
def cell_bag(tmp_path):
    """A bag of several types; returns its folder and what was written to it."""
    estimate = FrictionEstimate(object="rubber_rect4", status=FrictionEstimate.STATUS_OPTIMAL, confidence=0.002)
    estimate.support_friction.weights = [0.25, 0.75]
    # unlike a publisher, serialize_message adds a few bytes after empty lists, which rosbags refuses
    estimate.spread.middle = estimate.spread.low = estimate.spread.high = [0.25, 0.75]
    ranking = Recognition(best="as is", hypotheses=[Hypothesis(name="as is", ratio=1.0, feasible=True)])
    image = CompressedImage(format="jpeg", data=bytes(range(256)) * 40)
    topics = {
        "/cell/observation": (OBSERVATION, RELIABLE, [observation(number) for number in range(5)]),
        "/cell/friction_estimate": ("pushfric_msgs/msg/FrictionEstimate", LATCHED, [estimate]),
        "/cell/recognition": ("pushfric_msgs/msg/Recognition", LATCHED, [ranking]),
        "/cell/overlay/compressed": ("sensor_msgs/msg/CompressedImage", SENSOR_DATA, [image] * 3),
        "/cell/wrench": ("geometry_msgs/msg/WrenchStamped", SENSOR_DATA, []),
    }
    written = []
    with BagWriter(tmp_path / "cell") as writer:
        for name, (type_name, qos, messages) in topics.items():
            writer.add_topic(name, type_name, [offered(qos)])
            written += [(name, type_name, message) for message in messages]
        for stamp, (name, _, message) in enumerate(written, start=1_700_000_000_000_000_000):
            writer.write(name, stamp, serialize_message(message))
    return tmp_path / "cell", written


# --- what is written is read ---


def test_what_is_written_is_read_back(cell_bag):
    folder, written = cell_bag
    messages = list(Bag(folder).messages())
    assert [(m.topic, m.type_name, content(m)) for m in messages] == written
    assert [m.log_time_ns - messages[0].log_time_ns for m in messages] == list(range(10))
    assert list(Bag(folder / "cell_0.mcap").messages()) == messages


def test_messages_come_in_log_time_order_and_equal_times_as_written(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/a", STRING, [offered(RELIABLE)])
        writer.add_topic("/b", STRING, [offered(RELIABLE)])
        for topic, stamp, data in [("/a", 20, "third"), ("/b", 10, "first"), ("/a", 10, "second"), ("/b", 20, "fourth")]:
            writer.write(topic, stamp, text(data))
            writer.flush()
    assert [content(m).data for m in Bag(tmp_path / "bag").messages()] == ["first", "second", "third", "fourth"]


# --- the layout of rosbag2 ---


def test_rosbags_reads_the_whole_bag_by_its_embedded_definitions(cell_bag):
    folder, written = cell_bag
    with AnyReader([folder]) as reader:
        assert {connection.topic: connection.msgtype for connection in reader.connections} == {
            "/cell/wrench": "geometry_msgs/msg/WrenchStamped"
        } | {name: type_name for name, type_name, _ in written}
        for connection in reader.connections:  # RIHS01 computed by rosbags from the text we embedded
            assert reader.typestore.hash_rihs01(connection.msgtype) == connection.digest
        messages = [(c.topic, reader.deserialize(raw, c.msgtype)) for c, _, raw in reader.messages()]
    assert [topic for topic, _ in messages] == [name for name, _, _ in written]
    observations = [message for topic, message in messages if topic == "/cell/observation"]
    assert [message.force.x for message in observations] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert [message.contact_point.x for message in observations] == [0.01 * number for number in range(5)]
    (estimate,) = [message for topic, message in messages if topic == "/cell/friction_estimate"]
    assert (estimate.confidence, list(estimate.support_friction.weights)) == (0.002, [0.25, 0.75])
    (ranking,) = [message for topic, message in messages if topic == "/cell/recognition"]
    assert ranking.hypotheses[0].name == "as is"


def test_the_mcap_file_is_laid_out_as_rosbag2_does(cell_bag):
    folder, written = cell_bag
    with (folder / "cell_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        messages = list(reader.iter_messages())
        (record,) = reader.iter_metadata()
    assert [channel.topic for _, channel, _ in messages] == [name for name, _, _ in written]
    for (_, _, message), (_, _, expected) in zip(messages, written, strict=True):
        assert deserialize_message(message.data, type(expected)) == expected
    assert {schema.encoding for schema, _, _ in messages} == {"ros2msg"}
    assert {channel.message_encoding for _, channel, _ in messages} == {"cdr"}
    schema, channel, _ = messages[0]
    assert schema.name == OBSERVATION
    parts = schema.data.decode().split("\n" + "=" * 80 + "\n")
    assert "geometry_msgs/Vector3 force" in parts[0]
    assert {part.splitlines()[0] for part in parts[1:]} == {
        "MSG: builtin_interfaces/Time",
        "MSG: std_msgs/Header",
        *(f"MSG: geometry_msgs/{name}" for name in ("Point", "Pose", "Quaternion", "Twist", "Vector3")),
    }
    assert channel.metadata["topic_type_hash"] == message_types.type_hash(OBSERVATION)
    assert yaml.safe_load(channel.metadata["offered_qos_profiles"])[0]["reliability"] == "reliable"
    information = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert record.name == "rosbag2"
    assert yaml.safe_load(record.metadata["serialized_metadata"]) == information


def foreign(folder: pathlib.Path, compression: CompressionMode | None = None, storage: StoragePlugin = StoragePlugin.MCAP):
    """A bag as ROS 2 before Iron, or `ros2 bag record --compression-mode`, writes it; returns its only file."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    writer = RosbagsWriter(folder, version=8, storage_plugin=storage)
    if compression is not None:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/text", STRING, typestore=store)
        for stamp in (7, 5):
            raw = store.serialize_cdr(store.types[STRING](data=f"from elsewhere at {stamp}"), STRING)
            writer.write(connection, stamp, raw)
    (file,) = set(folder.iterdir()) - {folder / "metadata.yaml"}
    return file


@pytest.mark.parametrize("compression", [None, CompressionMode.STORAGE])
def test_bags_of_others_are_read(tmp_path, compression):
    foreign(tmp_path / "bag", compression)
    bag = Bag(tmp_path / "bag")
    assert bag.damage is None
    assert (bag.summary.message_count, bag.summary.start_ns, bag.summary.end_ns) == (2, 5, 7)
    texts = [(m.log_time_ns, bag.deserialize(m).data) for m in bag.messages()]
    assert texts == [(5, "from elsewhere at 5"), (7, "from elsewhere at 7")]
    assert recover(tmp_path / "bag", tmp_path / "out").summary.message_count == 2
    assert [(m.log_time_ns, content(m).data) for m in Bag(tmp_path / "out").messages()] == texts


@pytest.mark.parametrize(
    ("compression", "storage"),
    [
        (None, StoragePlugin.SQLITE3),
        (CompressionMode.FILE, StoragePlugin.MCAP),
        (CompressionMode.MESSAGE, StoragePlugin.MCAP),
    ],
)
def test_bags_that_are_not_read_are_converted_as_the_line_says(tmp_path, compression, storage):
    file = foreign(tmp_path / "bag", compression, storage)
    for use in (Bag, lambda path: recover(path, tmp_path / "out")):
        with pytest.raises(InvalidInput, match="rosbags-convert --src BAG --dst NEW --dst-storage mcap makes") as refused:
            use(tmp_path / "bag")
    if compression != CompressionMode.MESSAGE:  # its file alone does not say so
        with pytest.raises(InvalidInput, match="rosbags-convert --src BAG"):
            Bag(file)
    line = str(refused.value)
    words = line[line.index("rosbags-convert") : line.index(" makes")].split()
    words[words.index("BAG")], words[words.index("NEW")] = str(tmp_path / "bag"), str(tmp_path / "new")
    subprocess.run([pathlib.Path(sys.executable).parent / words[0], *words[1:]], check=True)
    assert [content(m).data for m in Bag(tmp_path / "new").messages()] == ["from elsewhere at 5", "from elsewhere at 7"]


@pytest.mark.parametrize(
    "type_name", ["std_msgs/msg/String", "rcl_interfaces/msg/ParameterDescriptor", "visualization_msgs/msg/MarkerArray"]
)
def test_type_hash_is_that_of_the_specification(type_name):
    assert message_types.type_hash(type_name) == get_typestore(Stores.ROS2_JAZZY).hash_rihs01(type_name)


# --- cut short ---


@pytest.fixture(scope="module")
def flushed(tmp_path_factory):
    """A bag of 12 messages in 4 chunks: the bytes of its file and its messages."""
    folder = tmp_path_factory.mktemp("flushed") / "bag"
    written = write_texts(folder, 12, flush_every=3)
    return mcap_of(folder).read_bytes(), written


@pytest.mark.parametrize("kept", [0.0, 0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95, 0.999])
def test_recovery_saves_the_whole_chunks(tmp_path, flushed, kept):
    content, written = flushed
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[: max(8, int(kept * len(content)))])
    damage = Bag(cut).damage
    assert damage.gaps[-1].reason == "the recording was cut short"
    assert damage.loses_messages == (kept < 0.8)  # later, the checksum over all proves that all are there
    count = recover(cut, tmp_path / "out").summary.message_count
    saved = [(m.log_time_ns, m.raw) for m in Bag(tmp_path / "out").messages()]
    assert saved == written[:count]
    assert count % 3 == 0
    if kept == 0.999:
        assert count == 12
    with AnyReader([tmp_path / "out"]) as reader:
        assert reader.message_count == count
        assert {c.digest for c in reader.connections} <= {message_types.type_hash(STRING)}


def test_what_was_flushed_survives_a_killed_process(tmp_path):
    script = f"""
import os, signal, test_bag
from pushfric_core.bags.bag_writer import BagWriter, offered
writer = BagWriter({str(tmp_path / "bag")!r})
writer.add_topic("/text", test_bag.STRING, [test_bag.offered(test_bag.RELIABLE)])
for number in range(3):
    writer.write("/text", number, test_bag.text(str(number)))
writer.flush()
writer.write("/text", 3, test_bag.text("lost"))
os.kill(os.getpid(), signal.SIGKILL)
"""
    paths = {"PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", script], env=os.environ | paths, check=False, timeout=60)
    with pytest.raises(DamagedBag, match=r"bag_0\.mcap: the recording was cut short"):
        Bag(tmp_path / "bag").require_whole()
    assert recover(tmp_path / "bag", tmp_path / "out").summary.message_count == 3
    assert [content(m).data for m in Bag(tmp_path / "out").messages()] == ["0", "1", "2"]


def test_whichever_byte_is_the_last_that_the_disk_takes_what_was_flushed_is_saved(tmp_path):
    """The write that reaches the limit is cut short, the next one fails: in the head, a chunk, the index, the summary."""

    def record(folder: pathlib.Path) -> None:
        with BagWriter(folder) as writer:
            writer.add_topic("/text", STRING, [offered(RELIABLE)])
            for number in range(3):
                writer.write("/text", number, text(str(number)))
                writer.flush()
                flushed.append(number)

    flushed: list[int] = []
    record(tmp_path / "whole")
    for limit in range(1, mcap_of(tmp_path / "whole").stat().st_size, 53):
        bag = tmp_path / f"bag {limit}"
        flushed.clear()
        with too_large_beyond(limit):
            record(bag)
        assert [file.name for file in bag.iterdir()] == [f"{bag.name}_0.mcap"]
        if flushed:
            recover(bag, tmp_path / f"saved {limit}")
            saved = [m.log_time_ns for m in Bag(tmp_path / f"saved {limit}").messages()]
            assert saved == list(range(len(saved)))
            assert len(saved) >= len(flushed)


def test_counts_that_no_checksum_vouches_for_are_not_believed(tmp_path, rng):
    """The end of the file is lost: a part of the record of counts, and the checksum of the summary, but no message."""
    written = write_texts(tmp_path / "bag", 20)
    file = mcap_of(tmp_path / "bag")
    content = file.read_bytes()
    head = b"\x0b" + (56).to_bytes(8, "little")  # of one channel
    kept = content[: content.rindex(head) + len(head) + 48]  # up to the number of its messages
    file.write_bytes(kept + rng.bytes(len(content) - len(kept)))
    bag = Bag(tmp_path / "bag")
    assert [m.raw for m in bag.messages()] == [raw for _, raw in written]
    assert sum(bag.damage.missing.values()) == 0


def test_recovery_takes_the_object_along(tmp_path):
    write_texts(tmp_path / "bag", 1)
    (tmp_path / "bag/object.yaml").write_text("name: plate")
    (tmp_path / "bag/camera.yaml").touch()
    for path, out in ((tmp_path / "bag", tmp_path / "a"), (mcap_of(tmp_path / "bag"), tmp_path / "b")):
        assert recover(path, out).summary.message_count == 1
        assert (out / "object.yaml").read_text() == "name: plate"
        assert (out / "camera.yaml").exists()


@pytest.mark.parametrize("size", [0, 20_000])
def test_a_recovery_that_cannot_be_written_leaves_no_folder(tmp_path, rng, size):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/text", STRING, [offered(RELIABLE)])
        for number in range(20):
            writer.write("/text", number, text(rng.bytes(2000).hex()))
    with too_large_beyond(size):
        recover(tmp_path / "bag", tmp_path / "out")
    assert [one.name for one in tmp_path.iterdir()] == ["bag"]


# --- refused ---


def test_a_second_writer_is_refused(tmp_path):
    expected = pytest.raises(InvalidInput, match="bag: already holds files, expected a new or empty folder")
    with BagWriter(tmp_path / "bag"), expected:
        BagWriter(tmp_path / "bag")


def test_a_file_in_the_way_is_refused(tmp_path):
    (tmp_path / "file").write_text("mine")
    for path in (tmp_path / "file", tmp_path / "file/bag"):
        with pytest.raises(InvalidInput, match=r"cannot record there \((File exists|Not a directory)\), expected a new folder"):
            BagWriter(path)
    assert (tmp_path / "file").read_text() == "mine"


def test_an_empty_folder_is_used(tmp_path):
    write_texts(tmp_path, 2)
    assert len(list(Bag(tmp_path).messages())) == 2


def test_what_is_no_bag_is_refused(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.txt").write_text("no bag at all")
    (tmp_path / "nothing.mcap").touch()
    for use in (Bag, lambda path: recover(path, tmp_path / "out")):
        with pytest.raises(InvalidInput, match="missing: cannot be read: No such file or directory, expected a bag"):
            use(tmp_path / "missing")
        with pytest.raises(InvalidInput, match=r"empty: is not a bag, expected metadata\.yaml, or an \.mcap"):
            use(tmp_path / "empty")
        for said in ("notes.txt: is not an MCAP file, expected a bag's folder", "nothing.mcap: is empty: its recorder ended"):
            with pytest.raises(InvalidInput, match=said):
                use(tmp_path / said.partition(":")[0])
    assert not (tmp_path / "out").exists()


def test_metadata_that_cannot_be_used_is_refused(tmp_path):
    write_texts(tmp_path / "bag", 1)
    metadata = tmp_path / "bag/metadata.yaml"
    original = metadata.read_text()
    cases = [
        ("]", "is not the metadata of a bag"),
        (
            original.replace("storage_identifier: mcap", "storage_identifier: tape"),
            "is a bag of the storage 'tape', expected mcap; rosbags-convert",
        ),
        (original.replace("compression_mode: ''", "compression_mode: [null]"), "expected compression_mode to be one of"),
        (original.replace("- bag_0.mcap", "- bag_0.mcap\n  - ../bag/bag_0.mcap"), r"lists bag_0\.mcap more than once"),
        (original.replace("- bag_0.mcap", '- "bag_0\\0.mcap"'), "expected relative_file_paths to list names of files"),
        (original.replace("message_count: 1", "message_count: -1"), "expected message_count to be a whole number"),
    ]
    for number, (broken, expected) in enumerate(cases):
        assert broken != original
        metadata.write_text(broken)
        with pytest.raises(InvalidInput, match=expected):
            Bag(tmp_path / "bag")
        assert recover(tmp_path / "bag", tmp_path / str(number)).summary.message_count == 1
    metadata.write_text(original.replace("compression_mode: ''", "compression_mode: null"))
    assert Bag(tmp_path / "bag").damage is None


def test_a_false_count_is_damage(tmp_path):
    write_texts(tmp_path / "bag", 3)
    metadata = tmp_path / "bag/metadata.yaml"
    information = yaml.safe_load(metadata.read_text())
    inner = information["rosbag2_bagfile_information"]
    for total, of_topic, expected in [
        (4, 4, "1 of 4 messages are missing: 1 of /cell/text"),
        (2, 2, "says the bag holds 2 messages of /cell/text, but there are 3"),
        (5, 3, "says the bag holds 5 messages, but it held 3"),
    ]:
        inner["message_count"], inner["topics_with_message_count"][0]["message_count"] = total, of_topic
        metadata.write_text(yaml.safe_dump(information))
        with pytest.raises(DamagedBag, match=expected):
            Bag(tmp_path / "bag").require_whole()


def test_a_file_that_vanishes_while_read_is_reported(tmp_path):
    write_texts(tmp_path / "bag", 1)
    messages = Bag(tmp_path / "bag").messages()
    mcap_of(tmp_path / "bag").unlink()
    with pytest.raises(InvalidInput, match=r"bag_0\.mcap: cannot be read: No such file or directory"):
        next(messages)


def test_messages_that_are_not_of_ros_2_are_refused(tmp_path):
    path = tmp_path / "foreign.mcap"
    rearranged.save_mcap(path, [(0, b"{}")], ("Any", "jsonschema", b"{}"), "json", profile="")
    for use in (Bag, lambda path: recover(path, tmp_path / "out")):
        with pytest.raises(InvalidInput, match=r"foreign\.mcap: /text is encoded as 'json', expected ROS 2 messages \(cdr\)"):
            use(path)


def test_a_file_without_summary_is_whole_and_recovered(tmp_path):
    """As `ros2 bag record --storage-preset-profile fastwrite` writes it."""
    path = tmp_path / "fast.mcap"
    left_out = dict.fromkeys(("use_statistics", "use_summary_offsets", "repeat_channels", "repeat_schemas"), False)
    schema = (STRING, "ros2msg", message_types.definition(STRING).encode())
    rearranged.save_mcap(path, [(stamp, text(str(stamp))) for stamp in (2, 1)], schema, use_chunking=False, **left_out)
    assert [content(m).data for m in Bag(path).messages()] == ["1", "2"]
    assert Bag(path).damage is None
    assert recover(path, tmp_path / "out").summary.message_count == 2
    assert Bag(tmp_path / "out").summary.message_count == 2
