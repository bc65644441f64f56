"""Bags: MCAP files laid out as `ros2 bag record -s mcap` lays them out, written, read and rescued."""

import contextlib
import heapq
import os
import pathlib
import shutil
import struct
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, NamedTuple

import yaml
import zstandard
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.records import Channel, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from pushfric_core.errors import InvalidInput
from pushfric_ros.files.object_file import OBJECT_FILE
from pushfric_ros.messages.types import definition, message_class, type_hash

PathLike = str | os.PathLike[str]

METADATA_VERSION = 9
INFINITE = Duration(nanoseconds=2**63 - 1)

# all that mcap and zstandard are known to raise on bytes that are not what they should be
_DAMAGE = (McapError, ValueError, KeyError, struct.error, zstandard.ZstdError)


class BagMessage(NamedTuple):
    """A message as it was recorded."""

    topic: str
    type_name: str  # package/msg/Type
    log_time_ns: int
    raw: bytes  # CDR


@dataclass(frozen=True)
class Topic:
    """A topic of a bag and what its publishers offered."""

    name: str
    type_name: str
    qos_profiles: tuple[QoSProfile, ...]
    type_hash: str  # RIHS01_...; empty in bags older than ROS 2 Jazzy
    message_count: int


@dataclass(frozen=True)
class Summary:
    """What a bag holds. Both times [ns] are 0 where it holds no message."""

    topics: tuple[Topic, ...]
    start_ns: int
    end_ns: int

    @property
    def message_count(self) -> int:
        return sum(topic.message_count for topic in self.topics)


# --- qualities of service, as rosbag2 spells them ---


def _qos_entry(qos: QoSProfile) -> dict[str, Any]:
    return {
        "history": qos.history.name.lower(),
        "depth": qos.depth,
        "reliability": qos.reliability.name.lower(),
        "durability": qos.durability.name.lower(),
        "deadline": _duration_entry(qos.deadline),
        "lifespan": _duration_entry(qos.lifespan),
        "liveliness": qos.liveliness.name.lower(),
        "liveliness_lease_duration": _duration_entry(qos.liveliness_lease_duration),
        "avoid_ros_namespace_conventions": False,
    }


def _duration_entry(duration: Duration) -> dict[str, int]:
    # a profile made in a program says 0 for "no limit", one discovered on the network says infinite
    sec, nsec = divmod(duration.nanoseconds or INFINITE.nanoseconds, 10**9)
    return {"sec": sec, "nsec": nsec}


def _qos_profile(entry: dict[str, Any]) -> QoSProfile:
    def policy(kind: Any, value: int | str) -> Any:
        return kind(value) if isinstance(value, int) else kind[value.upper()]  # numbers: before version 9

    def duration(value: dict[str, int]) -> Duration:
        return Duration(nanoseconds=min(value["sec"] * 10**9 + value["nsec"], INFINITE.nanoseconds))

    return QoSProfile(
        history=policy(HistoryPolicy, entry["history"]),
        depth=int(entry["depth"]),
        reliability=policy(ReliabilityPolicy, entry["reliability"]),
        durability=policy(DurabilityPolicy, entry["durability"]),
        deadline=duration(entry["deadline"]),
        lifespan=duration(entry["lifespan"]),
        liveliness=policy(LivelinessPolicy, entry["liveliness"]),
        liveliness_lease_duration=duration(entry["liveliness_lease_duration"]),
    )


# --- writing ---


class BagWriter:
    """A new bag in a folder of its own; a context manager that finishes the bag on the way out.

    Args:
        path: the folder, new or empty.
    Raises:
        InvalidInput: the folder holds something, cannot be made, or another writer has it; later, from every method: the
            disk is full or gone. What was flushed before can then be recovered.
    """

    def __init__(self, path: PathLike) -> None:
        self._folder = pathlib.Path(path).resolve()
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            if any(self._folder.iterdir()):
                raise InvalidInput(f"{self._folder}: already holds files, expected a new or empty folder")
            # exclusively: of two writers that both saw an empty folder one must lose
            self._file = (self._folder / f"{self._folder.name}_0.mcap").open("xb")
        except OSError as error:
            raise InvalidInput(f"{self._folder}: cannot record there ({error.strerror}), expected a new folder") from error
        self._writer = Writer(self._file, compression=CompressionType.ZSTD)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._metadata: dict[int, dict[str, Any]] = {}  # of topics, by channel
        self._counts: dict[int, int] = {}
        self._span: tuple[int, int] | None = None
        with self._writing():
            self._writer.start(profile="ros2", library="pushfric")

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    @property
    def topics(self) -> Collection[str]:
        """Names of the topics added so far."""
        return self._channels.keys()

    @property
    def message_count(self) -> int:
        """Messages written so far."""
        return sum(self._counts.values())

    def add_topic(self, name: str, type_name: str, qos_profiles: Sequence[QoSProfile], hash_text: str | None = None) -> None:
        """Add a topic before its first message.

        Args:
            name: full name, as /cell/object_pose.
            type_name: package/msg/Type, an installed one.
            qos_profiles: what its publishers offer.
            hash_text: RIHS01 hash that the publishers announce; by default that of the installed type.
        Raises:
            ValueError: the topic was added before.
            InvalidInput: the type is not installed.
        """
        if name in self._channels:
            raise ValueError(f"topic {name} was added before")
        topic = Topic(name, type_name, tuple(qos_profiles), hash_text or type_hash(type_name), 0)
        self._channels[name] = self._register(topic, "ros2msg", definition(type_name).encode())

    def write(self, topic: str, stamp_ns: int, raw: bytes) -> None:
        """Append a message: its topic, when it was received [ns], its CDR bytes.

        Raises:
            ValueError: the topic was not added, or the bag is closed.
        """
        if topic not in self._channels:
            raise ValueError(f"topic {topic} was not added to the bag")
        self._append(self._channels[topic], stamp_ns, raw)

    def flush(self) -> None:
        """Hand all that was written to the operating system: it survives the end of this process, however it ends."""
        with self._writing():
            self._writer.flush()

    def close(self) -> None:
        """Finish the MCAP file and write metadata.yaml; idempotent."""
        if self._file.closed:
            return
        information = self._information()
        with self._writing():
            # what is in the file makes a bare .mcap a whole bag
            self._writer.add_metadata("rosbag2", {"serialized_metadata": yaml.safe_dump(information, sort_keys=False)})
            self._writer.finish()
            self._file.close()
            text = yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False)
            (self._folder / "metadata.yaml").write_text(text, encoding="utf-8")

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        if self._file.closed:
            raise ValueError(f"{self._folder}: the bag is closed")
        try:
            yield
        except OSError as error:
            with contextlib.suppress(OSError):  # closing flushes, into the same full disk
                self._file.close()
            raise InvalidInput(f"{self._folder}: cannot write the bag: {error.strerror}") from error

    def _register(self, topic: Topic, encoding: str, schema: bytes) -> int:
        """Channel of a new topic."""
        qos = [_qos_entry(profile) for profile in topic.qos_profiles]
        with self._writing():
            if topic.type_name not in self._schemas:
                self._schemas[topic.type_name] = self._writer.register_schema(topic.type_name, encoding, schema)
            metadata = {"offered_qos_profiles": yaml.safe_dump(qos, sort_keys=False), "topic_type_hash": topic.type_hash}
            channel = self._writer.register_channel(topic.name, "cdr", self._schemas[topic.type_name], metadata)
        self._metadata[channel] = {
            "name": topic.name,
            "type": topic.type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": qos,
            "type_description_hash": topic.type_hash,
        }
        self._counts[channel] = 0
        return channel

    def _append(self, channel: int, stamp_ns: int, raw: bytes) -> None:
        with self._writing():
            self._writer.add_message(channel, log_time=stamp_ns, data=raw, publish_time=stamp_ns)
        self._counts[channel] += 1
        start, end = self._span or (stamp_ns, stamp_ns)
        self._span = min(start, stamp_ns), max(end, stamp_ns)

    def _information(self) -> dict[str, Any]:
        """The bag's rosbag2_bagfile_information."""
        file = pathlib.Path(self._file.name).name

        def span() -> dict[str, Any]:  # made twice: YAML would write the second mention of one object as an alias
            start, end = self._span or (0, 0)
            return {
                "starting_time": {"nanoseconds_since_epoch": start},
                "duration": {"nanoseconds": end - start},
                "message_count": self.message_count,
            }

        counts = [
            {"topic_metadata": metadata, "message_count": self._counts[channel]} for channel, metadata in self._metadata.items()
        ]
        return {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            **span(),
            "topics_with_message_count": counts,
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [file],
            "files": [{"path": file, **span()}],
            "custom_data": None,
            "ros_distro": os.environ.get("ROS_DISTRO", ""),
        }


# --- reading ---


def recorded_class(topic: Topic) -> type:
    """The installed class of a recorded topic.

    Raises:
        InvalidInput: it is not installed, or not with the definition the bag was recorded with.
    """
    installed = message_class(topic.type_name)
    if topic.type_hash and topic.type_hash != type_hash(topic.type_name):
        raise InvalidInput(f"{topic.name}: was recorded with another definition of {topic.type_name} than the one installed")
    return installed


def read(
    path: PathLike, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
) -> Iterator[BagMessage]:
    """The messages of a bag in the order of their log times; equal ones in the order they were written.

    Args:
        path: folder with metadata.yaml and .mcap files, or a bare .mcap.
        topics: full names of those wanted; None for all.
        start_ns: the first log time wanted.
        end_ns: the first one no longer wanted.
    Raises:
        InvalidInput: not a bag, cut short or, while reading, damaged.
    """
    files = [_messages(file, topics, start_ns, end_ns) for file in _finished_files(path)]
    return heapq.merge(*files, key=lambda message: message.log_time_ns)


def deserialize(message: BagMessage) -> Any:
    """The ROS message of a recorded one.

    Raises:
        InvalidInput: its type is not installed.
    """
    return deserialize_message(message.raw, message_class(message.type_name))


def describe(path: PathLike) -> Summary:
    """What a bag holds, without reading its messages.

    Raises:
        InvalidInput: not a bag, cut short, damaged, or written without a summary.
    """
    topics: dict[tuple[str, str], Topic] = {}
    spans: list[tuple[int, int]] = []
    for file in _finished_files(path):
        with _reader(file) as reader:
            summary = reader.get_summary()
            if summary is None or summary.statistics is None:
                raise InvalidInput(f"{file}: has no summary, expected one at the end; `pushfric bag recover` writes it anew")
            statistics = summary.statistics
            if statistics.message_count:
                spans.append((statistics.message_start_time, statistics.message_end_time))
            for channel in summary.channels.values():
                count = statistics.channel_message_counts.get(channel.id, 0)
                topic = _topic(summary.schemas.get(channel.schema_id), channel, count, file)
                known = topics.get((topic.name, topic.type_name))
                if known is not None:  # in an earlier file of the bag, or from another publisher
                    profiles = known.qos_profiles + tuple(qos for qos in topic.qos_profiles if qos not in known.qos_profiles)
                    topic = Topic(topic.name, topic.type_name, profiles, topic.type_hash, known.message_count + count)
                topics[topic.name, topic.type_name] = topic
    start, end = (min(start for start, _ in spans), max(end for _, end in spans)) if spans else (0, 0)
    return Summary(tuple(topics.values()), start, end)


def recover(path: PathLike, out: PathLike) -> int:
    """Rewrite all that is whole of a bag that was cut short, or lost its summary, into a new bag; returns how many messages.

    Args:
        path: folder of .mcap files or a bare .mcap.
        out: folder of the new bag; object.yaml goes along.
    Raises:
        InvalidInput: there is no MCAP file, or the new bag cannot be written.
    """
    files = _mcap_files(pathlib.Path(path))
    for file in files:
        _check_begin(file)
    with BagWriter(out) as writer:
        beside = files[0].with_name(OBJECT_FILE)
        if beside.is_file():
            with writer._writing():
                shutil.copyfile(beside, pathlib.Path(out) / OBJECT_FILE)
        for file in files:
            schemas: dict[int, Schema] = {}
            channels: dict[int, int] = {}
            for record in _whole_records(file):
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel) and record.id not in channels:
                    topic, schema = _topic(schemas.get(record.schema_id), record, 0, file), schemas[record.schema_id]
                    channels[record.id] = writer._register(topic, schema.encoding, schema.data)
                elif isinstance(record, Message) and record.channel_id in channels:
                    writer._append(channels[record.channel_id], record.log_time, record.data)
        return writer.message_count


def _messages(
    file: pathlib.Path, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None
) -> Iterator[BagMessage]:
    with _reader(file) as reader:
        for schema, channel, message in reader.iter_messages(topics, starting_at=start_ns, ending_before=end_ns):
            yield BagMessage(channel.topic, _type_name(schema, channel, file), message.log_time, message.data)


@contextlib.contextmanager
def _reader(file: pathlib.Path) -> Iterator[SeekingReader]:
    try:
        with file.open("rb") as stream:
            yield SeekingReader(stream, validate_crcs=True, record_size_limit=file.stat().st_size)
    except _DAMAGE as error:
        raise InvalidInput(f"{file}: the file is damaged: {error!r}") from error
    except OSError as error:
        raise InvalidInput(f"{file}: cannot be read: {error.strerror}") from error


def _whole_records(file: pathlib.Path) -> Iterator[McapRecord]:
    """Records from the beginning of a file to where it is cut or damaged."""
    with file.open("rb") as stream, contextlib.suppress(*_DAMAGE):
        yield from StreamReader(stream, validate_crcs=True, record_size_limit=file.stat().st_size).records


def _topic(schema: Schema | None, channel: Channel, message_count: int, file: pathlib.Path) -> Topic:
    type_name = _type_name(schema, channel, file)
    try:
        entries = yaml.safe_load(channel.metadata.get("offered_qos_profiles", "")) or []
        profiles = tuple(_qos_profile(entry) for entry in entries)
    except (yaml.YAMLError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InvalidInput(f"{file}: {channel.topic} has QoS profiles that are not those of rosbag2") from error
    return Topic(channel.topic, type_name, profiles, channel.metadata.get("topic_type_hash", ""), message_count)


def _type_name(schema: Schema | None, channel: Channel, file: pathlib.Path) -> str:
    if schema is None or channel.message_encoding != "cdr":
        raise InvalidInput(f"{file}: {channel.topic} is encoded as {channel.message_encoding!r}, expected ROS 2 messages (cdr)")
    return schema.name


def _finished_files(path: PathLike) -> list[pathlib.Path]:
    """The MCAP files of a bag, each known to have a beginning and an end."""
    path = pathlib.Path(path)
    metadata = path / "metadata.yaml"
    files = _listed_files(metadata) if metadata.is_file() else _mcap_files(path)
    for file in files:
        _check_begin(file)
        with file.open("rb") as stream:
            stream.seek(max(len(MCAP0_MAGIC), file.stat().st_size - len(MCAP0_MAGIC)))
            if stream.read() != MCAP0_MAGIC:
                raise InvalidInput(f"{file}: the recording was cut short, expected a finished file; see pushfric bag recover")
    return files


def _listed_files(metadata: pathlib.Path) -> list[pathlib.Path]:
    try:
        information = yaml.safe_load(metadata.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
        storage, mode = information["storage_identifier"], information.get("compression_mode", "")
        files = [metadata.parent / pathlib.PurePath(name).name for name in information["relative_file_paths"]]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, yaml.YAMLError) as error:
        raise InvalidInput(f"{metadata}: is not the metadata of a bag, expected that of rosbag2") from error
    if storage != "mcap":
        raise InvalidInput(f"{metadata}: the bag is stored as {storage!r}, expected 'mcap' (see `ros2 bag convert`)")
    if mode.lower() not in ("", "none"):
        raise InvalidInput(f"{metadata}: the bag is compressed by {mode.lower()}, expected MCAP's own compression or none")
    return files


def _mcap_files(path: pathlib.Path) -> list[pathlib.Path]:
    """A bare .mcap, or those in a folder whose metadata.yaml was never written."""
    files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    if not files:
        raise InvalidInput(f"{path}: is not a bag, expected metadata.yaml or an .mcap file in it")
    return files


def _check_begin(file: pathlib.Path) -> None:
    try:
        with file.open("rb") as stream:
            begin = stream.read(len(MCAP0_MAGIC))
    except OSError as error:
        raise InvalidInput(f"{file}: cannot be read: {error.strerror}, expected a bag") from error
    if begin != MCAP0_MAGIC:
        raise InvalidInput(f"{file}: is not an MCAP file, expected a bag's folder or an .mcap")
