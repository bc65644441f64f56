"""A node's parameters, declared from a frozen dataclass of `pushfric_core.settings.setting` fields."""

import dataclasses
import math
import typing
from collections.abc import Sequence
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from pushfric_core.errors import InvalidInput
from pushfric_core.settings import AUTO

Config = TypeVar("Config")


def declare(node: Node, config_class: type[Config]) -> Config:
    """Declare every field of a config dataclass as a read-only parameter of `node`; return the config with its values.

    A field that may be None takes the text auto for it; a tuple of integers that is empty by default has no value by default.

    Raises:
        InvalidInput: an override has the wrong type, is out of range or not finite, or the dataclass refuses the values.
    """
    values = {}
    hints = typing.get_type_hints(config_class)
    for field in dataclasses.fields(config_class):  # type: ignore[arg-type]
        default = list(field.default) if isinstance(field.default, tuple) else field.default
        optional = type(None) in typing.get_args(hints[field.name])
        default = AUTO if default is None else default
        # of what an empty list is one, ROS cannot tell
        unset = default == []
        default = Parameter.Type.INTEGER_ARRAY if unset else default
        where = f"{node.get_fully_qualified_name()}: parameter {field.name}"
        try:
            value = node.declare_parameter(field.name, default, _descriptor(field, hints[field.name])).value
        except InvalidParameterTypeException as error:
            raise InvalidInput(f"{where} must be {_type_name(default)}, got {error}") from error
        except InvalidParameterValueException as error:
            low, high = field.metadata.get("low"), field.metadata.get("high")
            raise InvalidInput(f"{where} must lie in [{low}, {high}], got {error}") from error
        if value is None and unset:
            value = ()
        if value is None:
            raise InvalidInput(f"{where} must be {_type_name(default)}, got nothing")
        if optional:
            if value != AUTO and not isinstance(value, float):
                raise InvalidInput(f"{where} must be {AUTO} or a number with a point, got {value}")
            value = None if value == AUTO else value
        numbers = value if isinstance(value, Sequence) and not isinstance(value, str) else [value]
        largest = [math.inf] if field.metadata.get("high") == math.inf else []
        if not all(math.isfinite(number) or number in largest for number in numbers if isinstance(number, float)):
            raise InvalidInput(f"{where} must be finite, got {value}")
        values[field.name] = tuple(value) if typing.get_origin(hints[field.name]) is tuple else value
    try:
        return config_class(**values)
    except ValueError as error:
        raise InvalidInput(f"{node.get_fully_qualified_name()}: {error}") from error


def _descriptor(field: Any, hint: Any) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(description=field.metadata.get("description", ""), read_only=True)
    if type(None) in typing.get_args(hint):
        descriptor.dynamic_typing = True  # its range is the dataclass's to enforce: a text has none
        return descriptor
    low, high = field.metadata.get("low"), field.metadata.get("high")
    if low is not None or high is not None:
        if hint is int:
            span = IntegerRange(from_value=int(-(2**62) if low is None else low), to_value=int(2**62 if high is None else high))
            descriptor.integer_range = [span]
        else:
            infinity = math.inf
            span = FloatingPointRange(from_value=-infinity if low is None else low, to_value=infinity if high is None else high)
            descriptor.floating_point_range = [span]
    return descriptor


def _type_name(default: Any) -> str:
    names = {bool: "true or false", int: "an integer", float: "a number with a point", str: "a text"}
    return next((name for kind, name in names.items() if isinstance(default, kind)), "a list")
