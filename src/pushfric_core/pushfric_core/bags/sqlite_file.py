"""The older storage of rosbag2: an SQLite database, read through rosbags."""

import pathlib
import urllib.parse
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import contextmanager

import apsw
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from pushfric_core.bags.contents import UNKNOWN_TOPIC, BagMessage, Definition, Gap, Topic
from pushfric_core.bags.offered_qos import SECOND_NS, OfferedQos
from pushfric_core.bags.rosbag2_metadata import BagMetadata
from pushfric_core.errors import InvalidInput

_SUMMARY = "SELECT ifnull(min(timestamp), 0), ifnull(max(timestamp), 0), count(*) FROM messages"
_COUNTS = "SELECT topic_id, count(*) FROM messages WHERE topic_id IN (SELECT id FROM topics) GROUP BY topic_id"

ENCODINGS = {MessageDefinitionFormat.MSG: "ros2msg", MessageDefinitionFormat.IDL: "ros2idl", MessageDefinitionFormat.NONE: ""}


class SqliteFile:
    """A database of a bag. It has no checksums, but SQLite checks its structure, and metadata.yaml has the counts.

    Raises:
        InvalidInput: the file is not the database of a bag.
    """

    embedded: BagMetadata | None = None

    def __init__(self, path: pathlib.Path) -> None:
        self.path = path
        self.gaps: list[Gap] = []
        self.doubts: list[str] = []
        self.expected: Counter[str] | None = None
        self.first_numbers: dict[str, int] = {}
        with self._opened() as reader:
            assert reader.dbconn is not None
            (finding,) = next(iter(reader.dbconn.execute("PRAGMA quick_check(1)")))
            ((self.start_ns, self.end_ns, total),) = reader.dbconn.execute(_SUMMARY)
            counts = dict(reader.dbconn.execute(_COUNTS))
            self.topics = {one.id: _topic(path, one, counts.get(one.id, 0)) for one in reader.connections}
        self.counts: Counter[str] = Counter()
        for topic in self.topics.values():
            self.counts[topic.name] += topic.message_count
        self.missing = +Counter({UNKNOWN_TOPIC: total - self.counts.total()})
        log = path.with_name(f"{path.name}-wal")
        if finding != "ok":
            self.gaps.append(Gap(0, path.stat().st_size, f"SQLite says: {' '.join(finding.split())[:160]}", None, None))
            self.doubts.append("messages may be missing, or differ from what was recorded")
        if log.is_file() and log.stat().st_size:
            self.doubts.append(f"the recording was cut short, part of it is in {log.name}: messages may be missing")

    def messages(self, topics: Collection[str] | None) -> Iterator[BagMessage]:
        """The messages of these topics, or of all, in order of log time."""
        with self._opened() as reader:
            wanted = [one for one in reader.connections if topics is None or one.topic in topics]
            for connection, stamp, raw in reader.messages(wanted) if wanted else ():
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


def _topic(path: pathlib.Path, connection: Connection, count: int) -> Topic:
    ext = connection.ext
    if not isinstance(ext, ConnectionExtRosbag2) or ext.serialization_format != "cdr":
        raise InvalidInput(f"{path}: {connection.topic[:80]} does not hold ROS 2 messages (cdr)")
    profiles = tuple(
        OfferedQos.of_policies(qos, lambda time: time.sec * SECOND_NS + time.nsec) for qos in ext.offered_qos_profiles
    )
    text = Definition(ENCODINGS[connection.msgdef.format], connection.msgdef.data)
    return Topic(connection.topic, connection.msgtype, profiles, connection.digest, count, text)
