"""The older storage of rosbag2: an SQLite database, read through rosbags."""

import pathlib
import urllib.parse
from collections.abc import Collection, Iterator
from contextlib import contextmanager

import apsw
import numpy as np
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from pushfric_core.bags.agreement import UNKNOWN_TOPIC
from pushfric_core.bags.contents import LAST_READ, LAST_SAVED, BagMessage, Definition, Entries, Standing, Topic
from pushfric_core.bags.mcap_file import Gap
from pushfric_core.bags.mcap_records import HELD_LIMIT
from pushfric_core.bags.offered_qos import SECOND_NS, OfferedQos
from pushfric_core.bags.rosbag2_metadata import BagMetadata
from pushfric_core.errors import InvalidInput

_COUNTS = """SELECT count(*), sum(topic_id IN (SELECT id FROM topics)), max(length(data)) FROM messages"""

ENCODINGS = {MessageDefinitionFormat.MSG: "ros2msg", MessageDefinitionFormat.IDL: "ros2idl", MessageDefinitionFormat.NONE: ""}


class SqliteFile:
    """A database of a bag. It has no checksums, but SQLite checks its structure, and metadata.yaml has the counts.

    Raises:
        InvalidInput: the file is not the database of a bag.
    """

    embedded: BagMetadata | None = None
    library = ""

    def __init__(self, path: pathlib.Path) -> None:
        self.path = path
        self.gaps: list[Gap] = []
        self.doubts: list[str] = []
        self.first_numbers: dict[str, int] = {}
        self.entries = Entries()
        with self._opened() as reader:
            self.topics = {n: _topic(path, connection) for n, connection in enumerate(reader.connections)}
            self._numbers = {connection.id: n for n, connection in enumerate(reader.connections)}
            assert reader.dbconn is not None
            (finding,) = next(iter(reader.dbconn.execute("PRAGMA quick_check(1)")))
            ((count, of_topics, largest),) = reader.dbconn.execute(_COUNTS)
            if max(count * Entries.SIZE, largest or 0) > HELD_LIMIT:
                what = f"{count} messages of up to {largest} bytes"
                raise InvalidInput(f"{path}: holds {what}, more than the limit of {HELD_LIMIT} bytes allows")
            for connection, stamp, raw in reader.messages(reader.connections) if reader.connections else ():
                stamps = stamp.to_bytes(8, "little") * 2
                self.entries.append(self._numbers[connection.id], 0, stamp, b"\0\0\0\0" + stamps + raw)
        self.standings = np.full(len(self.entries), Standing.SOUND if finding == "ok" else Standing.UNCHECKED, np.uint8)
        self.expected = {UNKNOWN_TOPIC: count - of_topics} if count > of_topics else None
        log = path.with_name(f"{path.name}-wal")
        times = self.entries.log_times
        self.held = [(min(times), max(times), largest)] if times else []
        last = max(times, default=0)
        if finding != "ok":
            self.gaps.append(Gap(0, path.stat().st_size, f"SQLite says: {' '.join(finding.split())[:160]}", None, None))
        if log.is_file() and log.stat().st_size:
            self.doubts.append("messages may be missing")
            self.gaps.append(Gap(0, 0, f"the recording was cut short, part of it is in {log.name}", last, None))

    def read(self, topics: Collection[str] | None, unconfirmed: bool) -> Iterator[BagMessage]:
        """Messages in order of log time."""
        last = LAST_SAVED if unconfirmed else LAST_READ
        with self._opened() as reader:
            every = reader.messages(reader.connections) if reader.connections else ()  # counted as before
            for number, (connection, stamp, raw) in enumerate(every):
                standing = Standing(self.standings[number])
                if standing <= last and (topics is None or connection.topic in topics):
                    yield BagMessage(connection.topic, connection.msgtype, stamp, bytes(raw), standing.doubt)

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
    return Topic(connection.topic, connection.msgtype, profiles, connection.digest, 0, text)
