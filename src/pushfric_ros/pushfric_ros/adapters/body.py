"""Tracked bodies in the messages of other systems, one module for each kind."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from pushfric_core.cell.mount import Body


class Source(Protocol):
    """Finds one body in the messages of some topics."""

    @property
    def topics(self) -> Mapping[str, tuple[str, str]]:
        """Name of each topic -> its type (package/msg/Type) and its quality of service, one of `messages.qos.QUALITIES`."""

    def body(self, topic: str, msg: Any) -> Body | None:
        """The body in a message of a topic; None if it says nothing new about it.

        Raises:
            ValueError: the message is not valid.
        """


class SourceDriver(Protocol):
    """The settings of one kind of source: a frozen dataclass of `pushfric_core.settings.setting` fields.

    The class is an entry point of the group `pushfric.sources`; its name there is the setting `source` of MountConfig. Its
    settings stand next to those of MountConfig: no name may occur twice.
    """

    def open_source(self) -> Source:
        """The source."""


class Single:
    """A source with a single topic.

    Args:
        topic: name of the topic.
        type_name: package/msg/Type.
        quality: one of `messages.qos.QUALITIES`.
        found: the body in a message.
    """

    def __init__(self, topic: str, type_name: str, quality: str, found: Any) -> None:
        self.topics = {topic: (type_name, quality)}
        self._found = found

    def body(self, topic: str, msg: Any) -> Body | None:
        """The body in a message."""
        found: Body | None = self._found(msg)
        return found


def chain(path: Sequence[Body]) -> Body:
    """The last of some bodies, each in the frame of the one before."""
    whole = path[0]
    for inner in path[1:]:
        whole = whole.before(inner)
    return whole
