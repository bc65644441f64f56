"""Records as messages and back, field by field: by the record's annotations (pushfric_core.records) and the message's fields.

What is None in a record is NaN in a message; where no number can be, it is what the message has by itself. A word, also that of
an enum, is the constant of that name.
"""

import functools
import math
import operator
from collections.abc import Callable
from enum import Enum
from typing import Any, NamedTuple, get_args, get_origin

import numpy as np

from pushfric_core.bags.samples import stamp_from_msg
from pushfric_core.records import fields_of, is_record
from pushfric_ros.messages.types import message_class


class _Part(NamedTuple):
    """A field of a record, in a message."""

    name: str
    holder: Callable[[Any], Any]  # gives the part of the message that has it
    names: tuple[str, ...]  # there: of its columns, if it has some
    kind: Any  # class of the value, or of each of several records
    is_record: bool  # it is one
    needed: bool  # it cannot be None


@functools.cache
def _parts(record: type) -> tuple[_Part, ...]:
    found = []
    for field in fields_of(record):
        path = field.name if field.place.message is None else field.place.message
        holders, names = zip(*(one.rpartition(".")[::2] for one in path.split()), strict=True) if path else (("",), ())
        kind, *none = [one for one in get_args(field.hint) if type(None) in get_args(field.hint)] or [field.hint]
        many = get_origin(kind) is tuple and get_args(kind)[-1] is Ellipsis
        holder = operator.attrgetter(holders[0]) if holders[0] else _itself
        if names or is_record(kind):
            found.append(_Part(field.name, holder, names, get_args(kind)[0] if many else kind, is_record(kind), not none))
    return tuple(found)


def _itself(msg: Any) -> Any:
    return msg


@functools.cache
def _numbers(message: type, name: str) -> dict[str, int]:
    """The constants of a message, without the field's name in front of theirs."""
    prefix = f"{name.upper()}_"
    return {one.removeprefix(prefix).lower(): getattr(message, one) for one in dir(message) if one.isupper()}


def _word(value: str | Enum) -> str:
    """The word of a constant."""
    return value.name.lower() if isinstance(value, Enum) else value


@functools.cache
def _element(message: type[Any], name: str) -> type[Any]:
    """The class of the messages in a field."""
    package, element = message.get_fields_and_field_types()[name].removeprefix("sequence<").rstrip(">").split("/")
    return message_class(f"{package}/msg/{element}")


def write(value: Any, record: type, msg: Any) -> None:
    """Set the fields of a message.

    Args:
        value: the record; None: nothing is known.
        record: its class.
        msg: as it is made, or a part of it.
    """
    for part in _parts(record):
        one, holder = getattr(value, part.name, None), part.holder(msg)
        if part.is_record:
            write(one, part.kind, getattr(holder, part.names[0]) if part.names else holder)
        elif len(part.names) == 1:
            _set(holder, part.names[0], one, part.kind)
        else:
            columns = part.names if one is None else np.asarray(one).T
            for name, column in zip(part.names, columns, strict=True):
                _set(holder, name, None if one is None else column, part.kind)


def _set(msg: Any, name: str, value: Any, kind: Any) -> None:
    message: Any = type(msg)
    there = getattr(msg, name)
    if type(value) is type(there) is not np.ndarray:
        setattr(msg, name, value)
    elif hasattr(there, "x"):
        there.x, there.y = (math.nan, math.nan) if value is None else map(float, value)
    elif hasattr(there, "sec"):
        there.sec, there.nanosec = divmod(value or 0, 10**9)
    elif value is None:
        if isinstance(there, float | np.ndarray):
            setattr(msg, name, math.nan if isinstance(there, float) else np.full_like(there, math.nan))
    elif isinstance(value, str | Enum):
        setattr(msg, name, _numbers(message, name)[_word(value)])
    elif isinstance(there, list) and isinstance(value, np.ndarray):
        point = _element(message, name)
        setattr(msg, name, [point(x=x, y=y) for x, y in value.tolist()])
    elif isinstance(there, list) and is_record(kind):
        there.extend(_element(message, name)() for _ in value)
        for one, entry in zip(value, there, strict=True):
            write(one, kind, entry)
    else:
        setattr(msg, name, value.ravel() if isinstance(value, np.ndarray) else value)


def read(record: type, msg: Any, **given: Any) -> Any:
    """The record in a message, apart from the fields that are given; None: one that it needs is not known."""
    found = given
    for part in _parts(record):
        if part.name in given:
            continue
        holder = part.holder(msg)
        if part.is_record:
            value = read(part.kind, getattr(holder, part.names[0]) if part.names else holder)
        else:
            columns = [_get(holder, name, part.kind) for name in part.names]
            value = columns[0]
            if len(columns) > 1 and value is not None:
                value = tuple(columns) if isinstance(value, float) else np.column_stack(columns)
        if value is None and part.needed:
            return None
        found[part.name] = None if not part.needed and isinstance(value, np.ndarray) and not value.size else value
    return record(**found)


def _get(msg: Any, name: str, kind: Any) -> Any:
    message: Any = type(msg)
    there = getattr(msg, name)
    if isinstance(there, float):
        return None if math.isnan(there) else there
    if hasattr(there, "x"):
        at = there.x, there.y
        return None if math.isnan(there.x) else np.array(at) if get_origin(kind) is np.ndarray else at
    if hasattr(there, "sec"):
        return stamp_from_msg(there)
    if isinstance(kind, type) and issubclass(kind, str | Enum) and isinstance(there, int):
        numbers = _numbers(message, name)
        words: Any = kind if issubclass(kind, Enum) else numbers
        return next((one for one in words if numbers.get(_word(one)) == there), None)
    if isinstance(there, np.ndarray):  # the rows of a square matrix
        return None if not np.isfinite(there).all() else there.reshape(2 * (math.isqrt(len(there)),))
    if isinstance(there, list):
        return np.array([(one.x, one.y) for one in there]) if not is_record(kind) else tuple(read(kind, one) for one in there)
    if get_origin(kind) is np.ndarray:
        return np.array(there)
    if get_origin(kind) is tuple:
        return tuple(there) or None
    return there if isinstance(there, int | str) else list(there)
