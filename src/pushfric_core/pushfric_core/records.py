"""Equality of records that hold arrays, for which the built-in comparison of dataclasses and named tuples raises an error."""

import dataclasses
from collections.abc import Iterable
from typing import TypeVar

import numpy as np

Record = TypeVar("Record")


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
