"""The recorder node: writes the bytes of every message on the chosen topics to a bag."""

import pathlib
import shutil
import sys
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from pushfric_core.bags.bag_writer import BagWriter, offered
from pushfric_core.cell.node_settings import KnownTopic, RecorderConfig, RecordingConfig
from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.files.object_file import CAMERA_FILE, OBJECT_FILE, PRIOR_FILE, load_object, save_object
from pushfric_core.wording import counted
from pushfric_ros.messages.types import definition, message_class, type_hash
from pushfric_ros.node_kit.diagnostics import Diagnostics, Health, Level, without_publisher
from pushfric_ros.node_kit.losses import Losses, Reception
from pushfric_ros.node_kit.parameters import declare, topic_name
from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.qos import NAMED, RELIABLE, deepened
from pushfric_ros.node_kit.timers import wall_timer

QUEUE_DEPTH = RELIABLE.depth
FLUSH_PERIOD = 0.5  # of wall time [s]; a crash costs at most the last second, even if a flush is late


class MessagesLost(PushfricError):
    """A bag lacks messages that were published while it was recorded, of topics of which every message counts."""


class RecorderNode(Node):
    """Records raw messages, stamped with the node's clock on arrival; the bag is finished when the node is destroyed.

    Under use_sim_time, messages that come before the first /clock wait for it and get that time.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("recorder", **kwargs)
        recording, config = declare(self, RecordingConfig), declare(self, RecorderConfig)
        known = [self._resolved(topic) for topic in config.known_topics]
        if not (known or config.discover):
            raise InvalidInput(
                f"{self.get_fully_qualified_name()}: topics must name what to record unless discover is true, got none"
            )
        for topic in known:  # before a file is made
            message_class(topic.type_name)
        model = load_object(recording.object) if recording.object else None
        self._bag = BagWriter(recording.bag)
        folder = pathlib.Path(recording.bag)
        if model is not None:
            save_object(model, folder / OBJECT_FILE)
        for source, name in ((recording.model, PRIOR_FILE), (recording.calibration, CAMERA_FILE)):
            try:
                if source:
                    shutil.copyfile(source, folder / name)
            except OSError as error:
                raise InvalidInput(f"{source}: cannot be copied to {folder / name}: {error.strerror}") from error
        self._bytes = 0
        self._reported = (time.monotonic(), 0)  # (time of the last diagnostics [s], messages until then)
        self._receptions: dict[str, Reception] = {}  # by topic
        self._waiting: list[tuple[str, bytes]] = []  # messages that wait for the first /clock
        self._refused: set[str] = set()
        for topic in known:
            wanted = NAMED[topic.quality]
            self._record(topic.name, topic.type_name, [wanted], wanted)
        if config.discover:
            wall_timer(self, 0.1, self._discover)
        wall_timer(self, FLUSH_PERIOD, self._flush)
        self._diagnostics = Diagnostics(self, self._health)

    def destroy_node(self) -> None:
        """Record what has arrived, finish the bag and destroy the node; a bag that could not be written stays as it is.

        Raises:
            InvalidInput: the bag could not be finished, for example because the disk is full.
            MessagesLost: the bag is whole, but some messages published on a reliable topic never reached it.
        """
        receptions, now = self._receptions, self.get_clock().now().nanoseconds
        try:
            if self._bag.closed:  # for a reason that was reported
                return
            for received in receptions.values():
                received.drain()
            self._write_waiting(now)
            self._bag.close()
        finally:  # the bag is finished before the middleware, which may hang at its end
            self._receptions = {}
            super().destroy_node()
        if lost := {name: received.losses for name, received in receptions.items() if received.losses.messages}:
            where = ", ".join(f"{losses.messages} of {name}{self._when(losses)}" for name, losses in lost.items())
            what = f"{self._bag.folder}: messages were lost before they could be recorded: {where}"
            if any(losses.promised for losses in lost.values()):
                raise MessagesLost(what)
            print(f"warning: {what}", file=sys.stderr)

    def _when(self, losses: Losses) -> str:
        start = self._bag.start_ns
        if losses.first_ns is None or start is None:
            return ""
        return f" (from {(losses.first_ns - start) * 1e-9:.3f} s to {(losses.until_ns - start) * 1e-9:.3f} s)"

    def _resolved(self, topic: KnownTopic) -> KnownTopic:
        topic_name(self, "topics", topic.name)  # refuses what is none
        return topic._replace(name=self.resolve_topic_name(topic.name))

    def _record(self, name: str, type_name: str, found: Sequence[QoSProfile], wanted: QoSProfile, told: Any = None) -> None:
        offers = [offered(profile) for profile in found]
        hash_text = type_hash(type_name) if told is None else f"{told}".replace("INVALID", "")  # of ROS 2 Humble there is none
        self._bag.add_topic(name, type_name, offers, hash_text, definition(type_name))
        deep = deepened(wanted, QUEUE_DEPTH)
        kind, record = message_class(type_name), partial(self._on_message, name)
        self._receptions[name] = Reception(self, kind, name, record, deep, raw=True)

    def _on_message(self, name: str, raw: bytes) -> None:
        self._bytes += len(raw)
        now = self._receptions[name].came
        if now == 0:
            self._waiting.append((name, raw))
        else:
            self._write_waiting(now)
            self._bag.write(name, now, raw)

    def _write_waiting(self, stamp_ns: int) -> None:
        waiting, self._waiting = self._waiting, []
        for name, raw in waiting:
            self._bag.write(name, stamp_ns, raw)

    def _flush(self) -> None:
        now = self.get_clock().now().nanoseconds
        if now > 0:
            self._write_waiting(now)
        self._bag.flush()

    def _discover(self) -> None:
        """Record the topics that other nodes publish, except hidden ones, whose names begin with an underscore."""
        for name, type_names in self.get_topic_names_and_types():
            if name in self._bag.topics or name in self._refused or "/_" in name:
                continue
            if not (publishers := self.get_publishers_info_by_topic(name)):
                continue
            found = [publisher.qos_profile for publisher in publishers]
            try:
                self._record(name, type_names[0], found, _met_by_all(found), publishers[0].topic_type_hash)
            except InvalidInput as error:
                self._refused.add(name)
                self.get_logger().error(f"{name} is not recorded: {error}")

    def _health(self) -> Health:
        count = self._bag.message_count + len(self._waiting)
        # a loss is warned of once and stays in the count, because what is recorded after it is complete again
        lost = {name: received.losses.new() for name, received in self._receptions.items()}
        values: dict[str, Any] = {
            "messages": count,
            "bytes": self._bytes,
            "lost": sum(received.losses.messages for received in self._receptions.values()),
            "topics": len(self._bag.topics),
        }
        (then, before), self._reported = self._reported, (time.monotonic(), count)
        values["messages/s"] = round((count - before) / max(self._reported[0] - then, 1e-9), 1)
        if silent := without_publisher(self):
            return Health(Level.WARN, f"no publisher of {', '.join(silent)}", values)
        if any(lost.values()):
            where = ", ".join(f"{number} of {name}" for name, number in lost.items() if number)
            return Health(Level.WARN, f"messages were lost before they could be recorded: {where}", values)
        if self._waiting:
            return Health(Level.WARN, f"{counted(len(self._waiting), 'message')} waiting for a first /clock", values)
        return Health(Level.OK, f"{counted(count, 'message')} recorded", values)


def _met_by_all(found: Sequence[QoSProfile]) -> QoSProfile:
    """The strongest request that all of the publishers meet."""
    reliable = all(qos.reliability == ReliabilityPolicy.RELIABLE for qos in found)
    latched = all(qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in found)
    return QoSProfile(
        depth=QUEUE_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def main() -> None:
    run_node(RecorderNode)
