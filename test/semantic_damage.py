"""Bags that are whole in every byte, but tell something else than what happened: clocks, streams and stretches are changed."""

import copy
import pathlib
import shutil
from collections.abc import Callable, Sequence

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer

from pushfric_core.bags.bag import Bag
from pushfric_core.bags.bag_writer import BagWriter
from pushfric_core.bags.contents import BagMessage
from pushfric_core.bags.message_types import encoder, known_types
from pushfric_core.bags.samples import stamp_from_msg
from pushfric_ros.messages.conversions import stamp_to_msg

SECOND = 10**9
STREAMS = ("/cell/object_pose", "/cell/pusher_state")

Messages = list[BagMessage]
Damage = Callable[["Recording", np.random.Generator], tuple[str, Messages]]


class Recording:
    """A bag's messages, with what it takes to change them and to write them as a new bag."""

    def __init__(self, path: pathlib.Path) -> None:
        self.path, self._bag = path, Bag(path)
        self.messages = list(self._bag.messages())
        self.start, self.end = self._bag.summary.start_ns, self._bag.summary.end_ns
        self._encoders = {name: encoder(name) for name in {message.type_name for message in self.messages}}

    def stamped(self, message: BagMessage, offset: int) -> BagMessage:
        """The message with its header's stamp moved by an offset [ns]."""

        def change(msg: object) -> None:
            stamp = stamp_to_msg(max(0, stamp_from_msg(msg.header.stamp) + offset))
            msg.header.stamp.sec, msg.header.stamp.nanosec = stamp.sec, stamp.nanosec

        return self.changed(message, change)

    def changed(self, message: BagMessage, change: Callable[[object], None]) -> BagMessage:
        """The message after a change of its content."""
        content = copy.deepcopy(self._bag.deserialize(message))
        change(content)
        return message._replace(raw=self._encoders[message.type_name](content))

    def restamped(self, topic: str, which: slice | list[int], offset: int) -> Messages:
        """The messages, with those of a topic at these places stamped otherwise, by an offset [ns]."""
        messages = list(self.messages)
        for number in np.array(self.numbers(topic))[which]:
            messages[number] = self.stamped(messages[number], offset)
        return messages

    def numbers(self, topic: str) -> list[int]:
        """Indices of the messages of a topic."""
        return [number for number, message in enumerate(self.messages) if message.topic == topic]

    def write(self, folder: pathlib.Path, messages: Messages) -> pathlib.Path:
        """A new bag, whole in every byte, with these messages and the object of the old one."""
        with BagWriter(folder) as writer:
            for topic in self._bag.summary.topics:
                encoding, text = topic.definition
                writer.add_topic(topic.name, topic.type_name, topic.qos_profiles, topic.type_hash, text, encoding)
            for message in messages:
                writer.write(message.topic, message.log_time_ns, message.raw, message.type_name)
        shutil.copy(self.path / "object.yaml", folder)
        return folder

    def write_elsewhere(self, folder: pathlib.Path, messages: Messages) -> pathlib.Path:
        """A new bag as another recorder writes it, with poses and pusher states alone, and without numbers."""
        with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            types = {message.topic: message.type_name for message in self.messages if message.topic in STREAMS}
            connections = {topic: writer.add_connection(topic, name, typestore=known_types()) for topic, name in types.items()}
            for message in messages:
                if message.topic in STREAMS:
                    writer.write(connections[message.topic], message.log_time_ns, message.raw)
        shutil.copy(self.path / "object.yaml", folder)
        return folder

    def span_of(self, push_id: int) -> tuple[int, int]:
        """The log times of the first and the last pusher state of a push [ns]."""
        states = (message for message in self.messages if message.topic == STREAMS[1])
        times = [state.log_time_ns for state in states if self._bag.deserialize(state).push_id == push_id]
        return times[0], times[-1]

    def without_push(self, push_id: int, topic: str = "", around: int = 0) -> Messages:
        """The messages but those, of a topic or of all, that were recorded during a push and this time around it [ns]."""
        begin, end = self.span_of(push_id)
        begin, end = begin - around, end + around
        return [m for m in self.messages if topic not in ("", m.topic) or not begin <= m.log_time_ns <= end]


def _stream(rng: np.random.Generator) -> str:
    return STREAMS[int(rng.integers(2))]


def _stretch(bag: Recording, rng: np.random.Generator, longest: float = 15.0) -> tuple[int, int]:
    """Two times in a bag [ns]."""
    length = round(10 ** rng.uniform(-0.5, np.log10(longest)) * SECOND)
    begin = int(rng.integers(bag.start + 8 * SECOND, bag.end - length))
    return begin, begin + length


def _span(begin: int, end: int, bag: Recording) -> str:
    return f"from {(begin - bag.start) / SECOND:.2f} s to {(end - bag.start) / SECOND:.2f} s"


def wild_stamps(bag: Recording, rng: np.random.Generator) -> tuple[str, Messages]:
    """One to three single messages of a stream with other stamps, far ahead or behind."""
    topic, messages = _stream(rng), list(bag.messages)
    numbers = rng.choice(bag.numbers(topic)[5:], size=int(rng.integers(1, 4)), replace=False)
    offsets = [int(rng.choice((-1, 1)) * 10 ** rng.uniform(9.5, 14.5)) for _ in numbers]
    for number, offset in zip(numbers, offsets, strict=True):
        messages[number] = bag.stamped(messages[number], offset)
    return f"{topic} {numbers} stamped {offsets} ns off", messages


def another_clock(bag: Recording, rng: np.random.Generator) -> tuple[str, Messages]:
    """All stamps of a stream from some message on are moved by 0.05 s to 3 h."""
    return _another_clock_from(bag, rng, 10, lambda: 10 ** rng.uniform(7.7, 13))


def _another_clock_from(
    bag: Recording, rng: np.random.Generator, margin: int, size: Callable[[], float]
) -> tuple[str, Messages]:
    """The stamps of a stream are moved by a size [ns] from a message on, which is not in its first or last part of so many."""
    topic = _stream(rng)
    numbers = bag.numbers(topic)
    first = int(rng.choice(numbers[len(numbers) // margin : -len(numbers) // margin]))
    offset = int(rng.choice((-1, 1)) * size())
    return f"{topic} off by {offset} ns from {first} on", bag.restamped(topic, slice(numbers.index(first), None), offset)


def stopped_stream(bag: Recording, rng: np.random.Generator) -> tuple[str, Messages]:
    """A stream ends early, or begins late."""
    topic, at, late = _stream(rng), _stretch(bag, rng, 3.0)[0], bool(rng.integers(2))
    kept = [m for m in bag.messages if m.topic != topic or (m.log_time_ns < at) != late]
    return f"{topic} {'begins' if late else 'ends'} at {(at - bag.start) / SECOND:.2f} s", kept


def missing_stretch(bag: Recording, rng: np.random.Generator) -> tuple[str, Messages]:
    """All messages of some time, or those of one stream, are missing."""
    begin, end = _stretch(bag, rng)
    topic = rng.choice((*STREAMS, "", ""))
    kept = [m for m in bag.messages if not (begin <= m.log_time_ns < end and topic in ("", m.topic))]
    return f"{topic or 'everything'} missing {_span(begin, end, bag)}", kept


def missing_pushes(bag: Recording, rng: np.random.Generator) -> tuple[str, Messages]:
    """All messages of one to four pushes are missing, and up to a second around them."""
    first, count = int(rng.integers(9)), int(rng.integers(1, 5))
    begin, end = bag.span_of(first)[0], bag.span_of(first + count - 1)[1]
    around = [int(side * SECOND) for side in rng.uniform(0, 0.8, 2)]
    kept = [m for m in bag.messages if not begin - around[0] <= m.log_time_ns <= end + around[1]]
    return f"pushes {first} to {first + count - 1} missing, and {around} ns around them", kept


def cut_short(bag: Recording, rng: np.random.Generator) -> tuple[str, Messages]:
    """The recording ends or begins within a push."""
    push, late = int(rng.integers(1, 13)), bool(rng.integers(2))
    begin, end = bag.span_of(push)
    at = int(rng.integers(begin + SECOND // 2, end - SECOND // 4))
    kept = [m for m in bag.messages if (m.log_time_ns < at) != late]
    return f"{'begins' if late else 'ends'} within push {push}", kept


def clock_step(bag: Recording, rng: np.random.Generator) -> tuple[str, Messages]:
    """The stamps of a stream from some message on are moved by 45 to 400 ms."""
    return _another_clock_from(bag, rng, 8, lambda: rng.uniform(0.045, 0.4) * SECOND)


def missing_messages(bag: Recording, rng: np.random.Generator) -> tuple[str, Messages]:
    """Some single messages of the streams are missing."""
    topic = _stream(rng)
    out = set(rng.choice(bag.numbers(topic), size=int(rng.integers(3, 60)), replace=False).tolist())
    return f"{len(out)} of {topic} missing", [m for number, m in enumerate(bag.messages) if number not in out]


def doubled_stretch(bag: Recording, rng: np.random.Generator) -> tuple[str, Messages]:
    """All messages of some time, or those of one stream, come twice: at once, or again at the end of that time."""
    begin, end = _stretch(bag, rng, 5.0)
    topic, late = rng.choice((*STREAMS, "", "")), bool(rng.integers(2))
    again = [m for m in bag.messages if begin <= m.log_time_ns < end and topic in ("", m.topic)]
    if late:
        again = [m._replace(log_time_ns=end) for m in again]
    doubled = sorted([*bag.messages, *again], key=lambda m: m.log_time_ns)
    return f"{topic or 'everything'} doubled {_span(begin, end, bag)}, {'later' if late else 'at once'}", doubled


def other_values(bag: Recording, rng: np.random.Generator) -> tuple[str, Messages]:
    """Some poses in a row lie 1 to 5 mm off."""
    numbers = bag.numbers(STREAMS[0])
    first, count = int(rng.integers(100, len(numbers) - 40)), int(rng.integers(1, 20))
    off = float(rng.choice((-1, 1)) * rng.uniform(1e-3, 5e-3))
    messages = list(bag.messages)

    def change(msg: object) -> None:
        msg.pose.pose.position.x += off

    for number in numbers[first : first + count]:
        messages[number] = bag.changed(messages[number], change)
    return f"{count} poses from {first} on {off * 1e3:.1f} mm off", messages


def coarse_stamps(bag: Recording, rng: np.random.Generator) -> tuple[str, Messages]:
    """The stamps of the poses are those of a clock that ticks every .07 to .25 s."""
    tick = int(rng.uniform(0.07, 0.25) * SECOND)

    def change(msg: object) -> None:
        msg.header.stamp = stamp_to_msg(stamp_from_msg(msg.header.stamp) // tick * tick)

    messages = [bag.changed(message, change) if message.topic == STREAMS[0] else message for message in bag.messages]
    return f"poses stamped every {tick} ns", messages


def tip_elsewhere(bag: Recording, rng: np.random.Generator) -> tuple[str, Messages]:
    """In one to four pushes, the tip passes the object at 100 to 200 mm from where it was, or rests where it began."""
    first, count, rests = int(rng.integers(1, 9)), int(rng.integers(1, 5)), bool(rng.integers(2))
    aside, began = float(rng.choice((-1, 1)) * rng.uniform(0.1, 0.2)), {}

    def change(msg: object) -> None:
        if first <= msg.push_id < first + count and rests:
            msg.position, msg.tip.x, msg.tip.y = began.setdefault(msg.push_id, (msg.position, msg.tip.x, msg.tip.y))
        elif first <= msg.push_id < first + count:
            msg.tip.x, msg.tip.y = msg.tip.x - aside * msg.direction.y, msg.tip.y + aside * msg.direction.x

    messages = [bag.changed(message, change) if message.topic == STREAMS[1] else message for message in bag.messages]
    return f"tip in pushes {first} to {first + count - 1} {'at rest' if rests else f'{aside} m aside'}", messages


STREAM_DAMAGES: tuple[Damage, ...] = (
    wild_stamps,
    another_clock,
    stopped_stream,
    missing_stretch,
    doubled_stretch,
    missing_pushes,
    cut_short,
    clock_step,
    coarse_stamps,
    tip_elsewhere,
)
"""Damages that the streams themselves show, whatever recorded them."""

DAMAGES: tuple[Damage, ...] = (*STREAM_DAMAGES, missing_messages, other_values)


def damaged(bag: Recording, seed: int, kinds: Sequence[Damage] = DAMAGES) -> tuple[str, Messages]:
    """What was done to the bag, in words, and its messages: each kind of damage in turn, with other numbers for each seed."""
    kind = kinds[seed % len(kinds)]
    said, messages = kind(bag, np.random.default_rng(seed))
    return f"{seed}: {kind.__name__}: {said}", messages
