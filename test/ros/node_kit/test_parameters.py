"""A node's parameters from a dataclass of settings."""

import dataclasses
import math
from enum import Enum

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter

from pushfric_core.errors import InvalidInput
from pushfric_core.settings import REQUIRED, check_ranges, setting
from pushfric_ros.node_kit.parameters import declare


class Color(Enum):
    RED = "red"
    GREEN = "green"


@dataclasses.dataclass(frozen=True)
class Config:
    """One setting of each kind."""

    name: str = setting(REQUIRED, "what it is called")
    size: float = setting(1.0, "[m]", 0.5, 2.0)
    count: int = setting(3, "of something", 0, 10)
    flag: bool = setting(False, "whether")
    place: tuple[float, float] = setting((0.0, 1.0), "[m]")
    words: tuple[str, ...] = setting(("a", "b"), "some")
    pushes: tuple[int, ...] = setting((), "left out")
    radius: float | None = setting(None, "[m]", 0.0, 1.0)
    penalty: float = setting(math.inf, "cost", 0.0, math.inf)
    color: Color = setting(Color.RED, "of it")

    def __post_init__(self) -> None:
        check_ranges(self)


def declared(called, /, **values) -> tuple[Node, Config]:
    overrides = [Parameter(key, value=value) for key, value in values.items()]
    node = Node(called, parameter_overrides=overrides)
    try:
        return node, declare(node, Config)
    except InvalidInput:
        node.destroy_node()
        raise


def test_every_parameter_has_a_type_and_stays_as_it_is(ros):
    node, _ = declared("typed", name="x")
    for field in dataclasses.fields(Config):
        # a parameter without a type makes `ros2 param dump` print nothing at all
        assert node.get_parameter(field.name).type_ is not Parameter.Type.NOT_SET, field.name
        descriptor = node.describe_parameter(field.name)
        assert descriptor.read_only
        assert descriptor.description == field.metadata["description"]
    assert node.get_parameter("pushes").type_ is Parameter.Type.INTEGER_ARRAY
    assert node.describe_parameter("name").additional_constraints == "required"
    (span,) = node.describe_parameter("size").floating_point_range
    assert (span.from_value, span.to_value) == (0.5, 2.0)
    assert not node.set_parameters([Parameter("count", value=4)])[0].successful
    node.destroy_node()


def test_values_given_are_converted(ros):
    given = {"size": 2, "place": [1.0, 2.0], "pushes": [4, 5], "radius": 0.25, "penalty": 3, "color": "green"}
    node, config = declared("given", name="x", **given)
    assert config == Config("x", 2.0, 3, False, (1.0, 2.0), ("a", "b"), (4, 5), 0.25, 3.0, Color.GREEN)
    assert node.get_parameter("size").type_ is Parameter.Type.DOUBLE
    node.destroy_node()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({}, "parameter name must be given: what it is called"),
        ({"name": "x", "size": 3.0}, "parameter size must lie in [0.5, 2.0], got 3.0"),
        ({"name": "x", "pushes": ["a"]}, "parameter pushes must be a list of whole numbers, got ['a']"),
        ({"name": "x", "radius": 2.0}, "parameter radius must lie in [0.0, 1.0], got 2.0: are these millimetres?"),
        ({"name": "x", "color": "blue"}, "parameter color must be one of red, green, got 'blue'"),
    ],
)
def test_what_does_not_fit_is_refused(ros, values, words):
    with pytest.raises(InvalidInput) as refusal:
        declared("refusing", **values)
    assert str(refusal.value) == f"/refusing: {words}"
