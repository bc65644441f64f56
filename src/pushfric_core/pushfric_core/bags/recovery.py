"""Saves all that can be read of a damaged bag as a new bag."""

import os
import pathlib
import shutil
from collections import Counter

from pushfric_core.bags.bag import Bag, each
from pushfric_core.bags.bag_writer import BagWriter
from pushfric_core.bags.contents import BEFORE, Standing, Topic
from pushfric_core.bags.mcap_file import UNCONFIRMED
from pushfric_core.bags.recorded import beside
from pushfric_core.bags.rosbag2_metadata import METADATA
from pushfric_core.errors import InvalidInput
from pushfric_core.files.object_file import OBJECT_FILE, PRIOR_FILE

PathLike = str | os.PathLike[str]


def recover(path: PathLike, out: PathLike, unconfirmed: bool = True) -> Bag:
    """Write all readable messages of a bag to a new one; return the damaged bag, which says what is missing.

    Args:
        path: folder of a bag, or one of its files.
        out: folder of the new bag; object.yaml and prior.yaml are copied into it.
        unconfirmed: save those messages, too, that nothing confirms: they come in channels of their own that say so.
    Raises:
        InvalidInput: `path` is not a bag, or the new bag cannot be written.
    """
    unread = []
    try:
        damaged = Bag(path)
    except InvalidInput as error:  # perhaps only its metadata is damaged
        damaged = Bag(path, ignore_metadata=True)
        unread.append(f"{METADATA} could not be used: {error}")
    with BagWriter(out) as writer:
        for name in (OBJECT_FILE, PRIOR_FILE):
            if (kept := beside(damaged.path, name)) is not None:
                with writer.writing():
                    shutil.copyfile(kept, pathlib.Path(out) / name)
        topics = {(topic.name, topic.type_name): topic for topic in damaged.summary.topics}
        channels = {key: {"": _register(writer, topic, "")} for key, topic in topics.items()}
        for message in damaged.messages(unconfirmed=unconfirmed):
            if message.doubt and not unconfirmed:
                continue
            key = message.topic, message.type_name
            if message.doubt not in channels[key]:
                channels[key][message.doubt] = _register(writer, topics[key], message.doubt)
            writer.append(channels[key][message.doubt], message.log_time_ns, message.raw)
        if unconfirmed and (doubtful := damaged.doubtful):
            writer.note(UNCONFIRMED, each(doubtful))
        if lost := [*unread, *damaged.lost, *_lost(damaged, unconfirmed)]:
            writer.note(BEFORE, "; ".join(lost))
    return damaged


def _lost(damaged: Bag, unconfirmed: bool) -> list[str]:
    """The parts of a bag that cannot be saved, in words."""
    if damaged.damage is None:
        return []
    found = ["an unknown number of messages was lost"] if damaged.damage.missing is None else []
    salvaged = damaged.standings[Standing.SALVAGED]
    if lost := Counter(damaged.damage.missing or {}) - (salvaged if unconfirmed else Counter()):
        found.append(f"{lost.total()} messages were lost: {each(lost)}")
    if not unconfirmed and (left_out := damaged.doubtful - salvaged):
        found.append(f"{left_out.total()} messages were left out, which nothing confirmed: {each(left_out)}")
    return found


def _register(writer: BagWriter, topic: Topic, doubt: str) -> int:
    """The channel of a topic's messages about which there is this doubt."""
    text, marks = topic.definition, {UNCONFIRMED: doubt} if doubt else {}
    return writer.register(
        topic.name, topic.type_name, topic.qos_profiles, topic.type_hash, text.encoding, text.text.encode(), marks
    )
