"""A node's parameters, declared from a frozen dataclass of `pushfric_core.settings.setting` fields."""

import dataclasses
import math
import typing
from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidTopicNameException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.validate_full_topic_name import validate_full_topic_name

from pushfric_core import settings
from pushfric_core.errors import InvalidInput

REQUIRED = "required"
"""Additional constraint of a parameter without a default."""

ENDLESS = 2**62
"""An integer range without an end is given this one."""

EMPTY = {int: Parameter.Type.INTEGER_ARRAY, float: Parameter.Type.DOUBLE_ARRAY, str: Parameter.Type.STRING_ARRAY}
"""Type of an empty list of these."""


def declare(node: Node, config_class: type[Any]) -> Any:
    """Declare every field of a config dataclass as a read-only parameter of `node`; return the config with its values.

    For a field that may be None, the text auto stands for None.

    Raises:
        InvalidInput: a required parameter is not given, or `pushfric_core.settings.read` refuses the values.
    """
    fields = dataclasses.fields(config_class)
    if taken := [field.name for field in fields if node.has_parameter(field.name)]:
        raise InvalidInput(f"{node.get_fully_qualified_name()}: {config_class.__name__} repeats the setting {', '.join(taken)}")
    # Of any type at first, so that a wrong value is refused in the same words as in a cell's file.
    given = {}
    for field in fields:
        given[field.name] = node.declare_parameter(field.name, _default(field), ParameterDescriptor(dynamic_typing=True)).value
    try:
        (config,) = settings.read({name: value for name, value in given.items() if value is not None}, config_class)
    except ValueError as error:
        what = "parameter " if str(error).split()[0] in given else ""
        raise InvalidInput(f"{node.get_fully_qualified_name()}: {what}{error}") from error
    hints = typing.get_type_hints(config_class)
    plain = settings.plain(config)
    for field in fields:
        if type(plain.get(field.name)) is float and type(given[field.name]) is not float:  # 1 may be given for 1.0
            node.set_parameters([Parameter(field.name, value=plain[field.name])])
        elif field.name not in plain:
            # an empty list: a parameter left unset would hide all others from `ros2 param dump`
            kind = EMPTY[settings.written(typing.get_args(hints[field.name])[0])]
            node.set_parameters([Parameter(field.name, kind, [])])
        descriptor = _descriptor(field, hints[field.name])
        descriptor.type = node.get_parameter(field.name).type_.value
        node.set_descriptor(field.name, descriptor)
    return config


def _default(field: Any) -> Any:
    if settings.is_required(field):
        return None
    value = settings.plain_value(field.default)
    return None if value == [] else value  # ROS cannot find the type of an empty list


def topic_name(node: Node, parameter: str, text: str) -> str:
    """The full name of a topic that a parameter lists, before any remapping.

    Raises:
        InvalidInput: it is no name of a topic.
    """
    try:
        name: str = expand_topic_name(text, node.get_name(), node.get_namespace())
        validate_full_topic_name(name)
    except InvalidTopicNameException as error:
        raise InvalidInput(f"{node.get_fully_qualified_name()}: parameter {parameter}: {text!r} is not a topic") from error
    return name


def overrides(values: Mapping[str, Any]) -> list[Parameter]:
    """Values of parameters, as a node's constructor takes them."""
    return [Parameter(name, value=value) for name, value in values.items()]


def _descriptor(field: Any, hint: Any) -> ParameterDescriptor:
    constraints = [REQUIRED] * settings.is_required(field)
    constraints += [settings.expected(hint)] * (hint not in (bool, int, float, str))
    descriptor = ParameterDescriptor(
        description=field.metadata.get("description", ""), additional_constraints="; ".join(constraints), read_only=True
    )
    if hint not in (bool, int, float, str):
        # a text has no range, and an empty list no type: the dataclass checks both
        descriptor.dynamic_typing = True
        return descriptor
    low, high = field.metadata.get("low"), field.metadata.get("high")
    if low is not None or high is not None:
        kind, end, name = (
            (IntegerRange, ENDLESS, "integer_range") if hint is int else (FloatingPointRange, math.inf, "floating_point_range")
        )
        span = kind(from_value=hint(-end if low is None else low), to_value=hint(end if high is None else high))
        setattr(descriptor, name, [span])
    return descriptor
