"""The contents of a bag: messages, topics, and a summary of them."""

import enum
import heapq
import pathlib
from array import array
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from hashlib import blake2b
from typing import NamedTuple, Protocol, TypeVar

from pushfric_core.bags.offered_qos import OfferedQos

FIRST_NUMBER = "pushfric_first_number"
"""In the metadata of a channel: the number of its topic's first message; the others follow. It is drawn for each recording, so
that the messages of another one stand out."""

BEFORE = "pushfric_before_recovery"
"""Key of a bag's custom data: losses before the bag was recovered."""


class Definition(NamedTuple):
    """The text that defines a type and all types that it refers to."""

    encoding: str  # ros2msg or ros2idl; empty if the bag has no definition
    text: str


class BagMessage(NamedTuple):
    """A message as it was recorded."""

    topic: str
    type_name: str  # package/msg/Type
    log_time_ns: int
    raw: bytes  # CDR
    doubt: str = ""  # why it may not be what was recorded; empty if there is no reason to think so


class Standing(enum.IntEnum):
    """What speaks against a message that a bag's files hold. Each message has one of these."""

    SOUND = 0
    MARKED = 1  # `bag recover` marked it as unconfirmed
    UNCHECKED = 2  # its file is damaged, and neither a checksum nor a count confirms it
    SALVAGED = 3  # it is intact in a chunk that fails its checksum
    FOREIGN = 4  # it does not belong to the recording around it
    DOUBLED = 5  # it is a copy of another one
    UNKNOWN = 6  # its topic is not known

    @property
    def doubt(self) -> str:
        """Why such a message may not be what was recorded."""
        return _DOUBTS.get(self, "")


_DOUBTS = {
    Standing.MARKED: "`bag recover` marked it as unconfirmed",
    Standing.UNCHECKED: "nothing confirms it in a damaged file",
    Standing.SALVAGED: "it was saved from a chunk that failed its checksum",
    Standing.FOREIGN: "it does not belong to the recording around it",
}

LAST_READ, LAST_SAVED = Standing.UNCHECKED, Standing.FOREIGN
"""Messages up to these standings are read, or read on demand and saved by `bag recover`."""


LONG_PAUSE_NS, LONG_PAUSE_RATIO = 60 * 10**9, 20
"""In a damaged bag, a longer pause that is so many times as long as any other one separates two recordings [ns]."""


class Entries:
    """A few figures of each message in a file, in the order of the file; their content stays where it is."""

    SIZE = 22
    """Memory for one message [bytes]."""

    def __init__(self) -> None:
        self.log_times = array("q")  # [ns]
        self.digests = array("Q")  # of everything but the topic
        self.sequences = array("I")
        self.channels = array("H")

    def __len__(self) -> int:
        return len(self.channels)

    def append(self, channel: int, sequence: int, log_time_ns: int, content: bytes | memoryview) -> None:
        """Note a message; `content` is its bytes, its times and its sequence."""
        self.log_times.append(log_time_ns)
        self.digests.append(digest(content))
        self.sequences.append(sequence)
        self.channels.append(channel)

    def pop(self) -> None:
        """Forget the last message."""
        for column in (self.log_times, self.digests, self.sequences, self.channels):
            column.pop()

    def extend(self, other: "Entries") -> None:
        """Note the messages of another object."""
        self.log_times.extend(other.log_times)
        self.digests.extend(other.digests)
        self.sequences.extend(other.sequences)
        self.channels.extend(other.channels)


def digest(content: bytes | memoryview) -> int:
    """Two different contents have the same digest once in 2**64 pairs."""
    return int.from_bytes(blake2b(content, digest_size=8).digest(), "little")


class Logged(Protocol):
    """Something that was logged at a time."""

    @property
    def log_time_ns(self) -> int:
        """The time [ns]."""
        ...


Item = TypeVar("Item", bound=Logged)


def in_order(parts: Iterable[tuple[int, int, Callable[[], Iterator[Item]]]]) -> Iterator[Item]:
    """What several parts hold, in order of log time. A part is opened only when its time comes.

    Args:
        parts: the first log time of each [ns], its rank among those of the same time, and what opens it: then it returns its
            items in order.
    """
    waiting = sorted(parts, key=lambda part: part[:2], reverse=True)
    opened: list[tuple[int, int, int, Item, Iterator[Item]]] = []
    while waiting or opened:
        while waiting and (not opened or waiting[-1][:2] <= opened[0][:2]):
            _, rank, open_part = waiting.pop()
            items = open_part()
            for item in items:
                heapq.heappush(opened, (item.log_time_ns, rank, len(waiting), item, items))
                break
        if opened:
            _, rank, number, item, items = opened[0]
            yield item
            if len(opened) == 1 and not waiting:
                yield from items
                return
            for following in items:
                heapq.heapreplace(opened, (following.log_time_ns, rank, number, following, items))
                break
            else:
                heapq.heappop(opened)


@dataclass(frozen=True)
class Topic:
    """A topic of a bag and what its publishers offered."""

    name: str
    type_name: str
    qos_profiles: tuple[OfferedQos, ...]
    type_hash: str  # RIHS01_...; empty in bags older than ROS 2 Jazzy
    message_count: int  # of those that can be read
    definition: Definition


@dataclass(frozen=True)
class Summary:
    """What can be read of a bag. Both times [ns] are 0 if it has no message."""

    topics: tuple[Topic, ...]
    start_ns: int
    end_ns: int

    @property
    def message_count(self) -> int:
        return sum(topic.message_count for topic in self.topics)


def mcap_file(folder: pathlib.Path) -> pathlib.Path:
    """The file that is recorded in a bag's folder."""
    resolved = folder.resolve()
    return resolved / f"{resolved.name}_0.mcap"
