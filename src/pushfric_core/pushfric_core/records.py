"""Records, which are frozen dataclasses or named tuples: equality where they hold arrays, their fields, plain values, JSON."""

import dataclasses
import functools
import json
import math
from collections.abc import Callable, Iterable
from enum import Enum
from typing import Any, NamedTuple, TypeVar, get_type_hints

import numpy as np

Record = TypeVar("Record")


class FieldPlace(NamedTuple):
    """Where a field stands if not under its own name: in the annotation, Annotated[float, FieldPlace("spread.radius")]."""

    message: str | None = None
    """Path in the message; "": its fields are the message's own, or it is in none; two paths: a column in each."""
    key: str | None = None
    """In JSON; "": it is not said there; the same for two fields: a list of both."""


class Field(NamedTuple):
    """A field of a record."""

    name: str
    hint: Any  # its type
    place: FieldPlace
    required: bool  # its default is not None


@functools.cache
def fields_of(record: type[Any]) -> tuple[Field, ...]:
    """The fields of a record's class."""
    hints = get_type_hints(record, include_extras=True)
    if dataclasses.is_dataclass(record):
        optional = {one.name for one in dataclasses.fields(record) if one.default is None}
    else:
        optional = {name for name, default in getattr(record, "_field_defaults", {}).items() if default is None}
    found = []
    for name in getattr(record, "__dataclass_fields__", getattr(record, "_fields", ())):
        hint, place = hints[name], FieldPlace()
        if hasattr(hint, "__metadata__"):
            hint, place = hint.__origin__, hint.__metadata__[0]
        found.append(Field(name, hint, place, name not in optional))
    return tuple(found)


def is_record(kind: Any) -> bool:
    """Whether it is the class of a record."""
    return isinstance(kind, type) and (dataclasses.is_dataclass(kind) or hasattr(kind, "_fields"))


def plain(value: Any) -> Any:
    """A value as JSON and YAML have it: records as dicts, without optional fields that are None; arrays as lists."""
    kind: Any = type(value)
    if is_record(kind):
        found: dict[str, Any] = {}
        for one in fields_of(kind):
            key, part = one.name if one.place.key is None else one.place.key, plain(getattr(value, one.name))
            if key and (one.required or part is not None):
                found[key] = [found[key], part] if key in found else part
        return found
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, tuple | list):
        return [plain(part) for part in value]
    return value.value if isinstance(value, Enum) else value


def to_json(value: Any) -> str:
    """JSON on one line, of dicts, lists and arrays; infinite numbers and NaN become the strings "inf", "-inf" and "nan"."""
    return json.dumps(mapped(value, _finite), allow_nan=False)


def mapped(value: Any, change: Callable[[Any], Any]) -> Any:
    """The same with each leaf of its dicts, lists, tuples and arrays changed; the last two become lists."""
    if isinstance(value, dict):
        return {key: mapped(part, change) for key, part in value.items()}
    return [mapped(part, change) for part in value] if isinstance(value, (list, tuple, np.ndarray)) else change(value)


def _finite(value: Any) -> Any:
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else str(float(value))
    return value.item() if isinstance(value, np.generic) else value


def comparable(record: type[Record]) -> type[Record]:
    """Decorate a frozen dataclass or named tuple so that == compares the values of two records, and arrays as a whole."""

    def equal(self: Record, other: object) -> bool:
        return type(self) is type(other) and all(map(_same, _fields(self), _fields(other)))

    def unequal(self: Record, other: object) -> bool:
        return not equal(self, other)

    record.__eq__ = equal  # type: ignore[method-assign,assignment]
    record.__ne__ = unequal  # type: ignore[method-assign,assignment]
    return record


def _fields(record: object) -> Iterable[object]:
    if dataclasses.is_dataclass(record):
        return [getattr(record, field.name) for field in dataclasses.fields(record) if field.compare]
    assert isinstance(record, tuple)
    return record


def _same(one: object, another: object) -> bool:
    if isinstance(one, np.ndarray) and isinstance(another, np.ndarray):
        return np.array_equal(one, another, equal_nan=one.dtype.kind == another.dtype.kind == "f")
    if isinstance(one, tuple | list) and type(one) is type(another) and not hasattr(one, "_fields"):
        assert isinstance(another, tuple | list)
        return len(one) == len(another) and all(map(_same, one, another))
    return bool(one == another)
