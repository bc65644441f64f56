"""Reading bags: every byte is checked once before the first message is returned, so that what is missing is known."""

import pathlib
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from pushfric_core.bags.contents import BEFORE, UNKNOWN_BEFORE, BagMessage, Definition, Gap, PathLike, Summary, Topic, in_order
from pushfric_core.bags.mcap_file import STRANGE, McapFile
from pushfric_core.bags.message_types import decoder
from pushfric_core.bags.rosbag2_metadata import METADATA, BagMetadata, parts_of, read_metadata
from pushfric_core.errors import InvalidInput, PushfricError


class DamagedBag(PushfricError):
    """Messages are missing from a bag."""


@dataclass(frozen=True)
class Damage:
    """The damage of a bag."""

    gaps: tuple[Gap, ...]  # bytes that cannot be trusted
    missing: dict[str, int] | None  # messages that cannot be read, by topic; None: the bag does not say how many it had
    contradictions: tuple[str, ...]  # between what the bag says and what it holds

    @property
    def loses_messages(self) -> bool:
        """Whether a message is missing, or may be, or may not be what was recorded."""
        return bool(self.missing or self.contradictions) or self.missing is None


class Bag:
    """A bag, read through once to find what it contains and what is lost.

    Args:
        path: a folder as rosbag2 writes it, or one of its files.
        ignore_metadata: take the files in the folder, whatever its metadata.yaml says.
    Attributes:
        path: the argument.
        files: that it consists of.
        summary: what can be read.
        damage: what is wrong; None if the bag is whole.
        numbered: whether its recorder numbered the messages of every topic.
        proven: whether the bag shows that it holds every message that its recorder took: nothing is damaged, all are counted
            and numbered, and nothing was lost before.
        notes: what cannot be known; not damage.
        lost: losses before the bag was recovered, in words.
    Raises:
        InvalidInput: `path` is not a bag, cannot be read, or contains messages that are not of ROS 2.
    """

    def __init__(self, path: PathLike, ignore_metadata: bool = False) -> None:
        self.path = pathlib.Path(path)
        metadata = None if ignore_metadata else read_metadata(self.path)
        found = parts_of(self.path, metadata)
        self.files = found.files
        self._files = [McapFile(file) for file in found.files]
        self.summary = self._summary()
        self.damage = self._damage(metadata, list(found.doubts))
        said = [one.custom for one in (metadata, *(file.embedded for file in self._files)) if one is not None]
        self.lost, unknown = (
            tuple(sorted({" ".join(custom[key].split())[:500] for custom in said if key in custom}))
            for key in (BEFORE, UNKNOWN_BEFORE)
        )
        self.notes = (*found.notes, *(f"was recovered; before that, {text}" for text in unknown))
        self.numbered = all(file.counts.keys() <= file.first_numbers.keys() for file in self._files)
        self.proven = self.numbered and metadata is not None and not (self.damage or self.notes or self.lost)
        self._definitions = {topic.type_name: topic.definition for topic in self.summary.topics}

    def require_whole(self) -> None:
        """Refuse a bag from which messages are missing.

        Raises:
            DamagedBag: messages are missing; one line says which.
        """
        if self.damage is not None and self.damage.loses_messages:
            raise DamagedBag(f"{self.what_is_missing()}; --partial goes on with what there is, `pushfric bag verify` says more")

    def what_is_missing(self, with_places: bool = True) -> str:
        """A line that says how many messages of which topics are missing and, with places, when."""
        assert self.damage is not None
        gaps, contradictions = self.damage.gaps, self.damage.contradictions
        said = self.said
        if contradictions and with_places:
            said += f"; {contradictions[0]}" + (f" (and {len(contradictions) - 1} more doubts)" if contradictions[1:] else "")
        spans = "; ".join(f"{one.file}: {one.reason}, {self.when(one)}" for one in gaps[:3])
        more = f" and {len(gaps) - 3} more places" if len(gaps) > 3 else ""
        places = f" ({spans}{more})" if gaps and with_places else ""
        return f"{self.path}: the bag is damaged, {said}{places}"

    @property
    def said(self) -> str:
        """How many messages are missing from the damaged bag, in words."""
        assert self.damage is not None
        missing = self.damage.missing
        if missing:
            count = sum(missing.values())
            return f"{count} of {count + self.summary.message_count} messages are missing: {each(missing)}"
        if missing is None:
            return f"an unknown number of messages is missing, {self.summary.message_count} can be read"
        return "what it says contradicts what it holds" if self.damage.contradictions else "no message is missing"

    def when(self, gap: Gap) -> str:
        """The time that a gap covers, counted from the beginning of the bag."""
        start = self.summary.start_ns
        after = "from the beginning" if gap.after_ns is None else f"from {(gap.after_ns - start) * 1e-9:.3f} s"
        before = "to the end" if gap.before_ns is None else f"to {(gap.before_ns - start) * 1e-9:.3f} s"
        return f"{after} {before}"

    def messages(self, topics: Collection[str] | None = None) -> Iterator[BagMessage]:
        """All messages that can be read, in order of log time; those of the same time in the order they were written.

        Args:
            topics: full names of the topics to read; None: all.
        Raises:
            InvalidInput: a file can no longer be read.
        """
        return in_order((file.start_ns, partial(file.messages, topics)) for file in self._files if file.counts.total())

    def deserialize(self, message: BagMessage) -> Any:
        """The content of a message: an object with an attribute for each field of its type.

        Raises:
            InvalidInput: the definition of its type cannot be used.
            ValueError: its bytes are not such a message.
        """
        return decoder(message.type_name, self._definitions.get(message.type_name, Definition("", "")))(message.raw)

    def _summary(self) -> Summary:
        topics: dict[tuple[str, str], Topic] = {}
        for file in self._files:
            for topic in file.topics.values():
                known = topics.get((topic.name, topic.type_name))
                if known is not None:  # known from an earlier file of the bag, or from another publisher
                    if known.definition.text != topic.definition.text:
                        raise InvalidInput(f"{file.path}: {topic.name} has two definitions of {topic.type_name}, expected one")
                    profiles = known.qos_profiles + tuple(qos for qos in topic.qos_profiles if qos not in known.qos_profiles)
                    count = known.message_count + topic.message_count
                    topic = replace(topic, qos_profiles=profiles, message_count=count)
                topics[topic.name, topic.type_name] = topic
        filled = [file for file in self._files if file.counts.total()]
        start = min((file.start_ns for file in filled), default=0)
        return Summary(tuple(topics.values()), start, max((file.end_ns for file in filled), default=0))

    def _damage(self, metadata: BagMetadata | None, contradictions: list[str]) -> Damage | None:
        """The damage, besides the contradictions that are known so far."""
        gaps = tuple(gap for file in self._files for gap in file.gaps)
        contradictions += [f"{file.path.name}: {doubt}" for file in self._files for doubt in file.doubts]
        for name in {name for file in self._files for name in file.first_numbers}:
            firsts = [file.first_numbers.get(name, 0) for file in self._files if file.counts[name]]
            if firsts and max(firsts) - min(firsts) > STRANGE:
                contradictions.append(f"the messages of {name[:80]} were numbered by another recorder in some of its files")
        found = sum((file.counts for file in self._files), Counter[str]())
        numbered = sum((file.missing for file in self._files), Counter[str]())
        expected = [file.expected for file in self._files if file.expected is not None]
        missing = None
        if len(expected) == len(self._files):
            missing = _compared(sum(expected, Counter()), found, "the files say they hold", contradictions)
        if metadata is not None:
            of_metadata = _compared(Counter(metadata.by_topic), found, f"{METADATA} says the bag holds", contradictions)
            missing = of_metadata if missing is None else missing | of_metadata
            held = (found + missing).total()
            if metadata.message_count != held:
                contradictions.append(f"{METADATA} says the bag holds {metadata.message_count} messages, but it held {held}")
        if missing is None and not gaps:
            missing = Counter()  # nothing in the bag says how many there were, and nothing is damaged
        if missing is not None:
            missing |= numbered
        if not (gaps or missing or contradictions):
            return None
        return Damage(gaps, None if missing is None else dict(missing), tuple(contradictions))


def each(counts: dict[str, int]) -> str:
    """Numbers of messages by topic, in words."""
    return ", ".join(f"{count} of {' '.join(topic.split())[:80]}" for topic, count in counts.items())


def _compared(expected: Counter[str], found: Counter[str], said: str, contradictions: list[str]) -> Counter[str]:
    """Number of missing messages by topic; more messages than expected are a contradiction."""
    for name, count in (found - expected).items():
        contradictions.append(f"{said} {expected[name]} messages of {name}, but there are {expected[name] + count}")
    return expected - found
