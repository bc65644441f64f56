"""Writing bags in the layout of `ros2 bag record -s mcap`, so that what was flushed survives a crash."""

import contextlib
import copy
import os
import pathlib
import secrets
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from types import TracebackType
from typing import Any

import yaml
from mcap.writer import CompressionType, Writer
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.metadata import dump_qos_v9

from pushfric_core.bags.contents import FIRST_NUMBER, PathLike, check_free, mcap_file
from pushfric_core.bags.message_types import definition, type_hash
from pushfric_core.bags.rosbag2_metadata import METADATA, VERSION
from pushfric_core.errors import InvalidInput
from pushfric_core.files.disk import write_whole

INFINITE_NS = 2**63 - 1
"""A duration without limit, as the middleware represents it [ns]."""

CHUNK_SIZE = 2**13
"""Size of the pieces that share a checksum and are lost together [bytes]. With the usual 1 MiB, a bag of poses is 15 % smaller,
but a damaged sector of a disk loses twice as many messages (3.7 % instead of 2.0 % of the demo's)."""


class BagWriter:
    """A new bag in a folder of its own; a context manager that finishes the bag on exit.

    Args:
        path: the folder, new or empty.
        numbered: write the messages' numbers, which prove that none is missing.
    Attributes:
        folder: the folder.
        custom: texts for the bag's custom data, by key.
    Raises:
        InvalidInput: the folder is not empty, cannot be made, or belongs to another writer. Later, from every method: the
            disk is full, or the folder was removed. What was flushed before can be recovered from a full disk.
    """

    def __init__(self, path: PathLike, numbered: bool = True) -> None:
        self.folder = pathlib.Path(path).resolve()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            check_free(self.folder)
            # exclusively: if two writers both saw an empty folder, one of them must fail
            self._file = mcap_file(self.folder).open("xb")
        except OSError as error:
            raise InvalidInput(f"{self.folder}: cannot record there ({error.strerror}), expected a new folder") from error
        self._writer = Writer(self._file, CHUNK_SIZE, CompressionType.ZSTD, enable_data_crcs=True)
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str], int] = {}  # by topic and type; "" as type: the last one of a topic
        self._topics: dict[int, dict[str, Any]] = {}  # as metadata.yaml has them, by channel
        self._numbers: Counter[str] = Counter()  # of messages, by topic
        self._first_number = secrets.randbelow(2**31) if numbered else None
        self.custom: dict[str, str] = {}
        self._span: tuple[int, int] | None = None
        with self.writing():
            self._writer.start(profile="ros2", library="pushfric")

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    @property
    def topics(self) -> Collection[str]:
        """Names of the topics added so far."""
        return {name for name, _ in self._channels}

    @property
    def closed(self) -> bool:
        """Whether the bag is finished, or could not be written."""
        return self._file.closed

    @property
    def message_count(self) -> int:
        """Messages written so far."""
        return sum(topic["message_count"] for topic in self._topics.values())

    @property
    def start_ns(self) -> int | None:
        """The earliest time of a message written so far [ns]."""
        return None if self._span is None else self._span[0]

    def add_topic(
        self,
        name: str,
        type_name: str,
        qos_profiles: Sequence[Qos],
        hash_text: str | None = None,
        text: str | None = None,
        encoding: str = "ros2msg",
    ) -> None:
        """Add a topic before its first message.

        Args:
            name: full name, as /cell/object_pose.
            type_name: package/msg/Type.
            qos_profiles: what its publishers offer.
            hash_text: RIHS01 hash that the publishers announce, empty if it is not known; by default that of `message_types`.
            text: the definition of the type; by default that of `message_types`.
            encoding: of the definition.
        Raises:
            ValueError: the topic was added before with this type, or the bag is closed.
            InvalidInput: the type is not one of the cell, and hash or text are missing.
        """
        if (name, type_name) in self._channels:
            raise ValueError(f"topic {name} was added before")
        hash_text = type_hash(type_name) if hash_text is None else hash_text
        text = definition(type_name) if text is None else text
        qos = dump_qos_v9([*qos_profiles])
        with self.writing():
            if type_name not in self._schemas:
                self._schemas[type_name] = self._writer.register_schema(type_name, encoding, text.encode())
            metadata = {
                "offered_qos_profiles": yaml.safe_dump(qos, sort_keys=False),
                "topic_type_hash": hash_text,
                **({} if self._first_number is None else {FIRST_NUMBER: str(self._first_number)}),
            }
            channel: int = self._writer.register_channel(name, "cdr", self._schemas[type_name], metadata)
        topic = {
            "name": name,
            "type": type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": qos,
            "type_description_hash": hash_text,
        }
        self._topics[channel] = {"topic_metadata": topic, "message_count": 0}
        self._channels[name, type_name] = self._channels[name, ""] = channel

    def write(self, topic: str, stamp_ns: int, raw: bytes, type_name: str = "") -> None:
        """Append a message: its topic, the time of its receipt [ns], its CDR bytes, and its type if the topic has several.

        Raises:
            ValueError: the topic was not added, or the bag is closed.
        """
        if (topic, type_name) not in self._channels:
            raise ValueError(f"topic {topic} was not added to the bag")
        channel = self._channels[topic, type_name]
        number = 0 if self._first_number is None else (self._first_number + self._numbers[topic]) % 2**32
        self._numbers[topic] += 1  # a message that cannot be written leaves a gap
        with self.writing():
            self._writer.add_message(channel, log_time=stamp_ns, data=raw, publish_time=stamp_ns, sequence=number)
        self._topics[channel]["message_count"] += 1
        start, end = self._span or (stamp_ns, stamp_ns)
        self._span = min(start, stamp_ns), max(end, stamp_ns)

    def flush(self) -> None:
        """Hand everything written to the operating system, so that it survives the end of this process, however it ends."""
        with self.writing():
            self._writer.flush()
            self._check_place()

    def _check_place(self) -> None:
        """Check that the file is still there: writing to one that was removed or moved would succeed, and be lost."""
        try:
            there = os.path.samestat(os.stat(self._file.name), os.fstat(self._file.fileno()))
        except FileNotFoundError:
            there = False
        if not there:
            self._file.close()
            raise InvalidInput(f"{self._file.name}: was removed or moved while it was recorded; the recording ends here")

    def close(self) -> None:
        """Finish the MCAP file and write metadata.yaml, both to the disk; idempotent."""
        if self.closed:
            return
        information = self._information()
        with self.writing():
            # with this in the file, a single .mcap is a complete bag
            self._writer.add_metadata("rosbag2", {"serialized_metadata": yaml.safe_dump(information, sort_keys=False)})
            self._writer.finish()
            self._check_place()
            self._file.flush()
            os.fdatasync(self._file.fileno())
            self._file.close()
        # a bag without this can be read, one with a part of it cannot
        write_whole(self.folder / METADATA, yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False))

    @contextlib.contextmanager
    def writing(self) -> Iterator[None]:
        if self.closed:
            raise ValueError(f"{self.folder}: the bag is closed")
        try:
            yield
        except OSError as error:
            with contextlib.suppress(OSError):  # closing flushes to the same full disk
                self._file.close()
            raise InvalidInput(f"{self.folder}: cannot write the bag: {error.strerror}") from error

    def _information(self) -> dict[str, Any]:
        """The bag's rosbag2_bagfile_information."""
        file = pathlib.Path(self._file.name).name
        start, end = self._span or (0, 0)
        span = {
            "starting_time": {"nanoseconds_since_epoch": start},
            "duration": {"nanoseconds": end - start},
            "message_count": self.message_count,
        }
        return {
            "version": VERSION,
            "storage_identifier": "mcap",
            **span,
            "topics_with_message_count": list(self._topics.values()),
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [file],
            "files": [{"path": file, **copy.deepcopy(span)}],  # YAML would write the second mention of one object as an alias
            "custom_data": self.custom or None,
            "ros_distro": os.environ.get("ROS_DISTRO", ""),
        }


def offered(found: Any) -> Qos:
    """The offer of a publisher, given as rclpy's QoSProfile."""
    return Qos(
        QosHistory[found.history.name],
        found.depth,
        QosReliability[found.reliability.name],
        QosDurability[found.durability.name],
        _time(found.deadline),
        _time(found.lifespan),
        QosLiveliness[found.liveliness.name],
        _time(found.liveliness_lease_duration),
        found.avoid_ros_namespace_conventions,
    )


def _time(duration: Any) -> QosTime:
    """A duration; for "no limit", a profile made in a program has 0, and one discovered on the network has infinity."""
    return QosTime(*divmod(max(0, duration.nanoseconds) or INFINITE_NS, 10**9))
