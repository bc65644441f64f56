"""The contents of a bag: messages, topics, and a summary of them."""

import heapq
import os
import pathlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from pushfric_core.errors import InvalidInput

if TYPE_CHECKING:
    from rosbags.interfaces import Qos  # not otherwise: what reads CSVs alone needs no rosbags

PathLike = str | os.PathLike[str]

FIRST_NUMBER = "pushfric_first_number"
"""In the metadata of a channel: the number of its topic's first message; the others follow. It is drawn for each recording, so
that the messages of another one stand out."""

BEFORE, UNKNOWN_BEFORE = "pushfric_before_recovery", "pushfric_unknown_before_recovery"
"""Keys of a bag's custom data: losses before the bag was recovered, and what could not be known then."""


UNKNOWN_TOPIC = "a topic that is no longer known"
"""Stands for the topic of messages whose channel is not defined, or whose type is lost."""


def check_free(folder: pathlib.Path) -> None:
    """Refuse to record where something is. Raises InvalidInput unless this is a new or empty folder."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InvalidInput(f"{folder}: already holds files, expected a new or empty folder for the bag")


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


class Gap(NamedTuple):
    """Bytes of a file that cannot be trusted."""

    file: str  # its name
    begin: int
    end: int
    reason: str
    after_ns: int | None  # log time of the last message before it, in the order of the file; None: no such message
    before_ns: int | None  # log time of the first message after it


def in_order(parts: Iterable[tuple[int, Callable[[], Iterable[BagMessage]]]]) -> Iterator[BagMessage]:
    """The messages of several parts, by log time, and where that is equal by part. A part is opened when its time comes.

    Args:
        parts: the least log time of each [ns], and what opens it: then it returns its messages in order.
    """
    merged = heapq.merge(*(_opened(rank, *part) for rank, part in enumerate(parts)), key=lambda one: one[:2])
    return (message for _, _, message in merged if message is not None)


def _opened(
    rank: int, start_ns: int, open_part: Callable[[], Iterable[BagMessage]]
) -> Iterator[tuple[int, int, BagMessage | None]]:
    yield start_ns, rank, None  # until this is taken, the part stays closed
    for message in open_part():
        yield message.log_time_ns, rank, message


@dataclass(frozen=True)
class Topic:
    """A topic of a bag and what its publishers offered."""

    name: str
    type_name: str
    qos_profiles: "tuple[Qos, ...]"
    type_hash: str  # RIHS01_...; empty in bags older than ROS 2 Jazzy
    message_count: int  # of those that can be read
    definition: Definition


@dataclass(frozen=True)
class Summary:
    """Summary of what can be read of a bag. Both times [ns] are 0 if it has no message."""

    topics: tuple[Topic, ...]
    start_ns: int
    end_ns: int

    @property
    def message_count(self) -> int:
        return sum(topic.message_count for topic in self.topics)

    def names(self, namespace: str | None, types: Mapping[str, str]) -> dict[str, str]:
        """The names of a cell's topics of these types, given by name, by the full name; without those that are not there."""
        there = {(topic.name, topic.type_name) for topic in self.topics}
        return {f"{namespace}/{name}": name for name, kind in types.items() if (f"{namespace}/{name}", kind) in there}


def mcap_file(folder: pathlib.Path) -> pathlib.Path:
    """The file that is recorded in a bag's folder."""
    resolved = folder.resolve()
    return resolved / f"{resolved.name}_0.mcap"
