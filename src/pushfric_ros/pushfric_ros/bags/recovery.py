"""Saves all that can be read of a damaged bag as a new bag."""

import os
import pathlib
import shutil

from pushfric_core.errors import InvalidInput
from pushfric_ros.bags.bag import Bag
from pushfric_ros.bags.bag_writer import BagWriter
from pushfric_ros.bags.mcap_file import UNCONFIRMED
from pushfric_ros.files.object_file import OBJECT_FILE, PRIOR_FILE

PathLike = str | os.PathLike[str]


def recover(path: PathLike, out: PathLike, unconfirmed: bool = True) -> Bag:
    """Write all readable messages of a bag to a new one; return the damaged bag, which says what is missing.

    Args:
        path: folder of a bag, or one of its files.
        out: folder of the new bag; object.yaml and prior.yaml are copied into it.
        unconfirmed: save those messages, too, that are intact in chunks whose checksum fails; a metadata record of the new bag
            says which they are.
    Raises:
        InvalidInput: `path` is not a bag, or the new bag cannot be written.
    """
    try:
        damaged = Bag(path)
    except InvalidInput:  # perhaps only its metadata is damaged
        damaged = Bag(path, ignore_metadata=True)
    with BagWriter(out) as writer:
        for name in (OBJECT_FILE, PRIOR_FILE):
            kept = (damaged.path if damaged.path.is_dir() else damaged.path.parent) / name
            if kept.is_file():
                with writer.writing():
                    shutil.copyfile(kept, pathlib.Path(out) / name)
        channels = {}
        for topic in damaged.summary.topics:
            text = topic.definition
            channels[topic.name, topic.type_name] = writer.register(
                topic.name, topic.type_name, topic.qos_profiles, topic.type_hash, text.encoding, text.text.encode()
            )
        for message in damaged.messages(unconfirmed=unconfirmed):
            writer.append(channels[message.topic, message.type_name], message.log_time_ns, message.raw)
        if spans := damaged.unconfirmed(in_chunks=unconfirmed):
            writer.add_metadata(UNCONFIRMED, {topic: span.text() for topic, span in spans.items()})
    return damaged
