"""What a bag holds: messages, topics, and a summary of them."""

import pathlib
from dataclasses import dataclass
from typing import NamedTuple

from pushfric_ros.bags.cdr import Definition
from pushfric_ros.bags.offered_qos import OfferedQos


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
