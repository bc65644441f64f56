"""Saves all that can be read of a damaged bag as a new bag."""

import pathlib
import shutil

from pushfric_core.bags.bag import Bag
from pushfric_core.bags.bag_writer import BagWriter
from pushfric_core.bags.contents import BEFORE, UNKNOWN_BEFORE, PathLike
from pushfric_core.bags.recorded import beside
from pushfric_core.bags.rosbag2_metadata import METADATA, Compressed
from pushfric_core.errors import InvalidInput
from pushfric_core.files.object_file import CAMERA_FILE, OBJECT_FILE, PRIOR_FILE


def recover(path: PathLike, out: PathLike) -> Bag:
    """Write all readable messages of a bag to a new one, which notes what is missing; return the damaged bag.

    Args:
        path: folder of a bag, or one of its files.
        out: folder of the new bag; object.yaml, prior.yaml and camera.yaml are copied into it.
    Raises:
        InvalidInput: `path` is not a bag, or the new bag cannot be written.
    """
    unknown = []
    try:
        damaged = Bag(path)
    except Compressed:
        raise
    except InvalidInput as error:  # perhaps only its metadata is damaged
        damaged = Bag(path, ignore_metadata=True)
        unknown.append(f"{METADATA} could not be used: {error}")
    lost, damage = [*damaged.lost], damaged.damage
    if damage is not None and damage.loses_messages:
        lost += [damaged.said, *damage.contradictions]
    new = BagWriter(out, damaged.numbered)
    try:
        with new as writer:
            for name in (OBJECT_FILE, PRIOR_FILE, CAMERA_FILE):
                if (kept := beside(damaged.path, name)) is not None:
                    with writer.writing():
                        shutil.copyfile(kept, pathlib.Path(out) / name)
            for topic in damaged.summary.topics:
                encoding, text = topic.definition
                writer.add_topic(topic.name, topic.type_name, topic.qos_profiles, topic.type_hash, text, encoding)
            for message in damaged.messages():
                writer.write(message.topic, message.log_time_ns, message.raw, message.type_name)
            for key, texts in ((BEFORE, lost), (UNKNOWN_BEFORE, [*unknown, *damaged.notes])):
                if texts:
                    writer.custom[key] = "; ".join(texts)
    except BaseException:
        shutil.rmtree(new.folder, ignore_errors=True)  # a part of what can be saved is of no use
        raise
    return damaged
