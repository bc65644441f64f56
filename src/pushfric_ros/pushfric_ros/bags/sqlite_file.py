"""The older storage of rosbag2: an SQLite database, read through rosbags."""

import pathlib
import urllib.parse
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager

import apsw
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from pushfric_core.errors import InvalidInput
from pushfric_ros.bags.cdr import Definition
from pushfric_ros.bags.contents import BagMessage, Topic
from pushfric_ros.bags.mcap_file import Gap, Span
from pushfric_ros.bags.offered_qos import SECOND_NS, OfferedQos

ENCODINGS = {MessageDefinitionFormat.MSG: "ros2msg", MessageDefinitionFormat.IDL: "ros2idl", MessageDefinitionFormat.NONE: ""}


class SqliteFile:
    """A database of a bag. It has no checksums, but SQLite checks its structure, and metadata.yaml has the counts.

    Raises:
        InvalidInput: the file is not the database of a bag.
    """

    expected: dict[str, int] | None = None

    def __init__(self, path: pathlib.Path) -> None:
        self.path = path
        self.gaps: list[Gap] = []
        self.unconfirmed: Mapping[str, Span] = {}  # there is no checksum that could fail
        self.marked: Mapping[str, Span] = {}
        with self._opened() as reader:
            self.topics = [_topic(path, connection) for connection in reader.connections]
            has_messages = bool(reader.metadata.message_count)
            self.start_ns = reader.metadata.start_time if has_messages else 0
            self.end_ns = reader.metadata.end_time - 1 if has_messages else 0
            assert reader.dbconn is not None
            (finding,) = next(iter(reader.dbconn.execute("PRAGMA quick_check(1)")))
        log = path.with_name(f"{path.name}-wal")
        self.doubts: list[str] = []
        if finding != "ok":
            self.doubts.append("messages may not be what was recorded")
            self.gaps.append(Gap(0, path.stat().st_size, f"SQLite says: {' '.join(finding.split())[:160]}", None, None))
        if log.is_file() and log.stat().st_size:
            self.doubts.append("messages may be missing")
            self.gaps.append(Gap(0, 0, f"the recording was cut short, part of it is in {log.name}", self.end_ns, None))

    def read(self, topics: Collection[str] | None, unconfirmed: bool) -> Iterator[BagMessage]:
        """Messages in order of log time."""
        with self._opened() as reader:
            wanted = [each for each in reader.connections if topics is None or each.topic in topics]
            if wanted:
                for connection, stamp, raw in reader.messages(wanted):
                    yield BagMessage(connection.topic, connection.msgtype, stamp, bytes(raw))

    @contextmanager
    def _opened(self) -> Iterator[Sqlite3Reader]:
        reader = Sqlite3Reader(pathlib.Path(urllib.parse.quote(str(self.path))))  # the reader makes a URI from it
        try:
            reader.open()
            try:
                yield reader
            finally:
                reader.close()
        except (ReaderError, apsw.Error, LookupError, TypeError, ValueError, AttributeError) as error:
            raise InvalidInput(f"{self.path}: the database cannot be read: {' '.join(str(error).split())[:160]}") from error


def _topic(path: pathlib.Path, connection: Connection) -> Topic:
    ext = connection.ext
    if not isinstance(ext, ConnectionExtRosbag2) or ext.serialization_format != "cdr":
        raise InvalidInput(f"{path}: {connection.topic[:80]} does not hold ROS 2 messages (cdr)")
    profiles = tuple(
        OfferedQos.of_policies(qos, lambda time: time.sec * SECOND_NS + time.nsec) for qos in ext.offered_qos_profiles
    )
    text = Definition(ENCODINGS[connection.msgdef.format], connection.msgdef.data)
    return Topic(connection.topic, connection.msgtype, profiles, connection.digest, connection.msgcount, text)
