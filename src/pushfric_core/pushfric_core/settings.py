"""Settings: fields of frozen dataclasses that say what they are, once, for Python, nodes, files, command line and docs alike.

A setting is a bool, an int, a float, a text, an enum with texts as values, or a tuple of one of these. It may also be None, and
is then written `auto`: the program finds the value.
"""

import dataclasses
import enum
import math
import numbers
import re
import types
import typing
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pushfric_core.plausible import other_unit
from pushfric_core.wording import shortened

AUTO = "auto"
"""Spelling of a setting that is None: the program finds its value."""

REQUIRED: Any = dataclasses.MISSING
"""Takes the place of the default of a setting without one."""


def setting(
    default: Any,
    description: str,
    low: float | None = None,
    high: float | None = None,
    key: str | None = None,
    path: bool = False,
    names: str = "",
) -> Any:
    """A dataclass field with its description.

    Args:
        default: its value if none is given, or REQUIRED.
        description: what it does, with its unit in brackets.
        low, high: its inclusive range. A float may be infinite only if `high` is.
        key: its name in a cell's file, if that differs from the field's.
        path: it may name a file; in a cell's file, a relative path starts at that file's folder.
        names: what the text names, so that it must not be empty.
    """
    metadata = {"description": description, "low": low, "high": high, "key": key, "path": path, "names": names}
    return dataclasses.field(default=default, metadata=metadata)


def check_ranges(config: Any) -> None:
    """Refuse a config whose values are of other types than its fields, or leave their ranges.

    Numbers become those of the field's type, lists tuples, and texts the enum's members.

    Raises:
        ValueError: names the field, what it takes and its value, or what an empty text must name.
    """
    hints = typing.get_type_hints(type(config))
    for field in dataclasses.fields(config):
        value = _converted(field, field.name, hints[field.name], getattr(config, field.name), exact=True)
        object.__setattr__(config, field.name, value)


class Ranged:
    """Settings that are in their ranges, however they are made: a base of their dataclass."""

    def __post_init__(self) -> None:
        check_ranges(self)


def _check_value(field: Any, name: str, value: Any) -> None:
    if value == "" and (names := field.metadata.get("names")):
        raise ValueError(f"{name} must name {names}, got ''")
    low, high = field.metadata.get("low"), field.metadata.get("high")
    least, most = -math.inf if low is None else low, math.inf if high is None else high
    for number in value if isinstance(value, tuple) else (value,) if (low, high) != (None, None) else ():
        # `not <=` also catches NaN
        if isinstance(number, int | float) and not least <= number <= most:
            raise ValueError(f"{name} must lie in [{least}, {most}], got {value}{_other_unit(field, number, least, most)}")


def _other_unit(field: Any, number: float, least: float, most: float) -> str:
    """The question whether a number out of its range was written in another unit; empty if none would bring it into it."""
    unit = unit_in(field.metadata["description"])
    return other_unit(unit, lambda factor: least <= number * factor <= most) if abs(number) > abs(most) else ""


def unit_in(description: str) -> str:
    """The first unit that stands in brackets in a description; empty if there is none."""
    found = re.search(r"\[([^]\s]+)", description)
    return found[1] if found else ""


def read(values: Mapping[str, Any], *configs: type, keys: bool = False) -> tuple[Any, ...]:
    """Configs of these classes from what was written for them: in a file, as a node's parameters, or on a command line.

    Args:
        values: by name of the field; no others. Numbers are converted to the field's type, lists to tuples.
        configs: dataclasses of settings, whose names differ.
        keys: the names are those of a cell's file.
    Raises:
        ValueError: an unknown name, one that lacks, a value of another type or out of range, or what a class refuses.
    """
    known = [key_of(field) if keys else field.name for config in configs for field in dataclasses.fields(config)]
    if repeated := sorted({name for name in known if known.count(name) > 1}):
        raise ValueError(f"{', '.join(config.__name__ for config in configs)} repeat the setting {', '.join(repeated)}")
    if unknown := [str(name) for name in values if name not in known]:
        raise ValueError(f"expected any of {', '.join(known)}, got {', '.join(unknown)}")
    return tuple(_read(config, values, keys) for config in configs)


def _read(config: type[Any], values: Mapping[str, Any], keys: bool) -> Any:
    hints = typing.get_type_hints(config)
    given = {}
    for field in dataclasses.fields(config):
        name = key_of(field) if keys else field.name
        if name in values:
            given[field.name] = _converted(field, name, hints[field.name], values[name])
        elif is_required(field):
            raise ValueError(f"{name} must be given: {field.metadata['description']}")
    return config(**given)


def key_of(field: Any) -> str:
    """A setting's name in a cell's file."""
    return field.metadata.get("key") or str(field.name)


def is_required(field: Any) -> bool:
    """Whether a setting has no default."""
    return bool(field.default is REQUIRED)


def plain(config: Any) -> dict[str, Any]:
    """A config's values as node parameters have them: lists for tuples, texts for enums, and AUTO for None.

    An empty list is left out, because ROS cannot find its type.
    """
    values = {field.name: plain_value(getattr(config, field.name)) for field in dataclasses.fields(config)}
    return {name: value for name, value in values.items() if value != []}


def plain_value(value: Any) -> Any:
    """A value as a node's parameter has it."""
    if isinstance(value, tuple):
        return [plain_value(item) for item in value]
    if isinstance(value, enum.Enum):
        return value.value
    return AUTO if value is None else value


def expected(hint: Any) -> str:
    """The values that a field of this type takes, in words."""
    if is_optional(hint):
        return f"{AUTO} or {expected(written(hint))}"
    if typing.get_origin(hint) is tuple:
        items = typing.get_args(hint)
        count = "" if items[-1] is Ellipsis else f"{len(items)} "
        return f"a list of {count}{_PLURAL[written(items[0])]}"
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return f"one of {', '.join(str(member.value) for member in hint)}"
    return _SINGULAR[hint]


_SINGULAR = {
    bool: "true or false",
    int: "a whole number",
    float: "a finite number",
    str: "a text, in quotes if it looks like a number",
}
_PLURAL = {bool: "true or false", int: "whole numbers", float: "finite numbers", str: "texts"}


def _converted(field: Any, name: str, hint: Any, value: Any, exact: bool = False) -> Any:
    """A value of a field; if `exact`, texts are no numbers."""
    infinite = field.metadata.get("high") == math.inf
    try:
        converted = _convert(hint, value, infinite)
        if exact and plain_value(converted) != plain_value(value):
            raise ValueError
    except (ValueError, OverflowError):
        shown = list(value) if isinstance(value, Sequence) and not isinstance(value, str | bytes) else value
        got = "nothing" if value is None else shortened(shown)
        raise ValueError(f"{name} must be {expected(hint)}, got {got}") from None
    if converted is not None:
        _check_value(field, name, converted)
    return converted


def _convert(hint: Any, value: Any, infinite: bool) -> Any:
    """A value converted to the type of a field; raises ValueError or OverflowError if that is not possible."""
    if is_optional(hint):
        return None if value is None or value == AUTO else _convert(written(hint), value, infinite)
    if typing.get_origin(hint) is tuple:
        return _convert_items(typing.get_args(hint), value, infinite)
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return hint(value)
    if isinstance(hint, types.UnionType):  # with a class of own objects: who has the setting checks them
        return value
    if hint in (bool, str):
        if not isinstance(value, hint):
            raise ValueError
        return value
    # YAML takes 1e-3 for a text
    if isinstance(value, bool) or not isinstance(value, numbers.Real | str):
        raise ValueError
    number = float(value)
    if hint is int:
        if not number.is_integer():
            raise ValueError
        return value if isinstance(value, int) else int(number)
    if not (math.isfinite(number) or (infinite and number == math.inf)):
        raise ValueError
    return number


def _convert_items(hints: tuple[Any, ...], value: Any, infinite: bool) -> tuple[Any, ...]:
    if isinstance(value, str | bytes) or not isinstance(value, Sequence):
        raise ValueError
    if hints[-1] is Ellipsis:
        return tuple(_convert(hints[0], item, infinite) for item in value)
    if len(value) != len(hints):
        raise ValueError
    return tuple(_convert(hint, item, infinite) for hint, item in zip(hints, value, strict=True))


def is_optional(hint: Any) -> bool:
    """Whether a setting of this type may be AUTO."""
    return type(None) in typing.get_args(hint)


def written(hint: Any) -> Any:
    """The type in a union that can be written in a file: neither None nor a class of own objects."""
    return next((kind for kind in typing.get_args(hint) if kind in _SINGULAR), hint)


def merged(configs: Iterable[Any]) -> dict[str, Any]:
    """The values of several configs as node parameters have them."""
    return {name: value for config in configs for name, value in plain(config).items()}
