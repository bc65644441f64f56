"""Message types without ROS: definitions, hashes and plain records of the cell's, and decoders for the messages of any bag.

The definitions of pushfric_msgs are its own files; those of the packages that it refers to come with rosbags. The messages of
a bag are decoded by the definitions in the bag, whatever is installed.
"""

import functools
import re
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from pushfric_core.bags.constants import FOLDER
from pushfric_core.bags.contents import Definition
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


TYPE_NAME = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Za-z][A-Za-z0-9_]*")

DEFINITION_LIMIT = 2**18
"""Largest number of characters of the definition of a type."""

ARRAY_LIMIT = 1024
"""Largest number of elements of an array of fixed size; the library writes a line of code for each element."""

SEQUENCE_LIMIT = 2**26
"""Largest number of elements of any other array."""


@functools.lru_cache(maxsize=100)  # to make one takes as long as to decode 1000 messages
def decoder(type_name: str, embedded: Definition) -> Callable[[bytes], Any]:
    """A function that decodes messages of one type: from CDR bytes, to an object with an attribute for each field.

    It raises ValueError if the bytes are not such a message.

    Args:
        type_name: package/msg/Type.
        embedded: the definition in the bag; if it has no text, the installed definition is used.
    Raises:
        InvalidInput: the definition is missing, exceeds a limit or cannot be understood.
    """
    if not TYPE_NAME.fullmatch(type_name):
        raise InvalidInput(f"message type {type_name[:80]!r} is not one of ROS 2, expected package/msg/Type")
    text = embedded.text or definition(type_name)
    if len(text) > DEFINITION_LIMIT:
        raise InvalidInput(f"{type_name}: its definition has {len(text)} characters, expected at most {DEFINITION_LIMIT}")
    try:
        if embedded.text and embedded.encoding == "ros2idl":
            # several files in one text, each after a line that names it
            parts = re.split(r"^=+\nIDL: .*\n", text, flags=re.MULTILINE)
            parsed = {name: each for part in parts if part.strip() for name, each in get_types_from_idl(part).items()}
        else:
            parsed = get_types_from_msg(text, type_name)
        # constants are dropped: they are not needed, and only they would reach the generated code as text
        types: Any = {name: ([], fields) for name, (_, fields) in parsed.items()}
        for _, fields in types.values():
            for _, described in fields:
                _check_size(described)
        store = get_typestore(Stores.EMPTY)
        store.max_sequence_length = SEQUENCE_LIMIT
        store.register(types)
        store.get_msgdef(type_name)
    except (TypesysError, SyntaxError, LookupError, ValueError, TypeError, AssertionError, RecursionError) as error:
        raise InvalidInput(f"{type_name}: the bag's definition of it is not understood: {_first_line(error)}") from error

    def decoded(raw: bytes) -> Any:
        try:
            return store.deserialize_cdr(raw, type_name)
        except (SerdeError, LookupError, TypeError, AssertionError, OverflowError, RecursionError, MemoryError) as error:
            raise ValueError(f"not a {type_name}: {_first_line(error)}") from error

    return decoded


def encoder(type_name: str) -> Callable[[Any], bytes]:
    """A function that turns messages of a type of the cell into CDR bytes.

    Raises:
        InvalidInput: the type is not known.
    """
    store = types_with(type_name)
    return lambda message: bytes(store.serialize_cdr(message, type_name))


def _check_size(described: Any) -> None:
    kind, detail = described
    if kind == Nodetype.ARRAY:
        inner, length = detail
        if length > ARRAY_LIMIT:
            raise ValueError(f"an array of {length} elements, expected at most {ARRAY_LIMIT}")
        _check_size(inner)


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [""])[0][:160] or type(error).__name__
