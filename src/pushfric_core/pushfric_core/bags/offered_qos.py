"""The qualities of service that a publisher offered, as bags store them."""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pushfric_core.files.yaml_text import load_yaml

INFINITE_NS = 2**63 - 1
"""A duration without limit, as the middleware represents it [ns]."""

SECOND_NS = 10**9

POLICIES = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown", "best_available"),
    "durability": ("system_default", "transient_local", "volatile", "unknown", "best_available"),
    "liveliness": ("system_default", "automatic", "manual_by_node", "manual_by_topic", "unknown", "best_available"),
}
"""The policies of rmw in the order of their numbers; rosbag2 writes names since version 9 of its metadata, earlier numbers."""

DURATIONS = ("deadline", "lifespan", "liveliness_lease_duration")


@dataclass(frozen=True)
class OfferedQos:
    """The qualities of service of a publisher; policies are spelled as in rosbag2."""

    depth: int
    reliability: str
    durability: str
    history: str = "keep_last"
    liveliness: str = "system_default"
    deadline: int = INFINITE_NS  # [ns], as the next two
    lifespan: int = INFINITE_NS
    liveliness_lease_duration: int = INFINITE_NS

    @classmethod
    def of_policies(cls, found: Any, nanoseconds: Callable[[Any], int]) -> "OfferedQos":
        """The offer in a library's record with the same fields, which has enumerations for policies and its own durations.

        Args:
            found: the record.
            nanoseconds: converts one of its durations.
        """
        policies = {name: getattr(found, name).name.lower() for name in POLICIES}
        durations: dict[str, Any] = {name: min(max(0, nanoseconds(getattr(found, name))), INFINITE_NS) for name in DURATIONS}
        return cls(depth=found.depth, **policies, **durations)

    def entry(self) -> dict[str, Any]:
        """The profile as rosbag2 writes it."""
        names = ("history", "depth", "reliability", "durability", *DURATIONS[:2], "liveliness", DURATIONS[2])  # in its order
        entry: dict[str, Any] = {name: getattr(self, name) for name in names}
        for name in DURATIONS:
            entry[name] = dict(zip(("sec", "nsec"), divmod(entry[name], SECOND_NS), strict=True))
        return entry | {"avoid_ros_namespace_conventions": False}

    @classmethod
    def from_entry(cls, entry: Mapping[str, Any]) -> "OfferedQos":
        """The offer that rosbag2 wrote.

        Raises:
            ValueError: rosbag2 did not write this.
        """
        try:
            values: dict[str, Any] = {name: _policy(name, entry[name]) for name in POLICIES}
            values |= {name: _duration(entry[name]) for name in DURATIONS}
            depth = entry["depth"]
        except (KeyError, TypeError, IndexError) as error:
            raise ValueError(f"expected a QoS profile as rosbag2 writes it, got {str(entry)[:80]}") from error
        if type(depth) is not int or not 0 <= depth < 2**63:
            raise ValueError(f"expected a depth of 0 or more, got {depth!r}")
        return cls(depth=depth, **values)


@functools.lru_cache(maxsize=100)
def profiles_from(text: str) -> tuple[OfferedQos, ...]:
    """The profiles of a topic, in YAML; raises ValueError as `OfferedQos.from_entry` does. Most topics have the same ones."""
    entries: Any = load_yaml(text)
    if not isinstance(entries, list | None):
        raise ValueError(f"expected a list of QoS profiles, got {str(entries)[:80]}")
    return tuple(OfferedQos.from_entry(entry) for entry in entries or ())


def _policy(name: str, value: Any) -> str:
    known = POLICIES[name]
    if type(value) is int and 0 <= value < len(known):
        return known[value]
    if isinstance(value, str) and value.lower() in known:
        return value.lower()
    raise ValueError(f"expected {name} to be one of {', '.join(known)}, got {value!r}")


def _duration(value: Mapping[str, Any]) -> int:
    seconds, rest = value["sec"], value["nsec"]
    if type(seconds) is not int or type(rest) is not int or seconds < 0 or rest < 0:
        raise ValueError(f"expected a duration in whole sec and nsec, got {str(value)[:80]}")
    return min(seconds * SECOND_NS + rest, INFINITE_NS)
