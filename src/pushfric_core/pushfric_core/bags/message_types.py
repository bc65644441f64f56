"""The message types of the cell, without ROS: their definitions, hashes, and plain records with their fields.

The definitions of pushfric_msgs are its own files; those of the packages that it refers to come with rosbags.
"""

import functools
from types import SimpleNamespace
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from pushfric_core.bags.constants import FOLDER
from pushfric_core.errors import InvalidInput


def definition(type_name: str) -> str:
    """Definition of a type of the cell in the format ros2msg, followed by those of all types that it refers to.

    Raises:
        InvalidInput: the type is not known.
    """
    return types_with(type_name).generate_msgdef(type_name, ros_version=2)[0]


def type_hash(type_name: str) -> str:
    """RIHS01 hash of a type of the cell.

    Raises:
        InvalidInput: the type is not known.
    """
    return types_with(type_name).hash_rihs01(type_name)


def types_with(type_name: str) -> Typestore:
    """The known types, of which this is one.

    Raises:
        InvalidInput: the type is not known.
    """
    store = known_types()
    if type_name not in store.fielddefs:
        raise InvalidInput(f"message type {type_name[:80]!r} is not known here, expected package/msg/Type")
    return store


def record(type_name: str, **fields: Any) -> SimpleNamespace:
    """A message of a type of the cell as a plain record; the fields that are not given are empty or 0."""
    values = {name: _empty(described) for name, described in known_types().get_msgdef(type_name).fields}
    return SimpleNamespace(**{**values, **fields})


@functools.cache
def known_types() -> Typestore:
    """The types of the cell and of the packages that they refer to."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for path in sorted(FOLDER.glob("*.msg")):
        store.register(get_types_from_msg(path.read_text(encoding="utf-8"), f"pushfric_msgs/msg/{path.stem}"))
    return store


def _empty(described: Any) -> Any:
    kind, detail = described
    if kind == Nodetype.NAME:
        return record(detail)
    if kind == Nodetype.BASE:
        return {"string": "", "bool": False}.get(detail[0], 0)
    if kind == Nodetype.ARRAY:
        inner, length = detail
        return [_empty(inner) for _ in range(length)]
    return []
