"""Settings, read from what people write."""

import dataclasses
import math

import pytest

from pushfric_core.settings import REQUIRED, is_required, key_of, merged, plain, read, setting


@dataclasses.dataclass(frozen=True)
class Stage:
    stroke: float = setting(REQUIRED, "how far it goes [m]", 0.001, 10.0)
    axes: tuple[str, ...] = setting(("X",), "its axes")
    steps: int = setting(200, "of the motor", 1, 10_000)


@dataclasses.dataclass(frozen=True)
class Plan:
    plan: str = setting("", "a path", key="file", path=True)
    speed: float | None = setting(None, "[m/s]", 0.0, 1.0)
    penalty: float = setting(math.inf, "of something", 0.0, math.inf)


def test_several_classes_share_what_is_written():
    stage, plan = read({"stroke": 1, "speed": 0.5, "steps": 400.0}, Stage, Plan)
    assert (stage, plan) == (Stage(1.0, ("X",), 400), Plan("", 0.5))
    assert isinstance(stage.stroke, float)
    assert isinstance(stage.steps, int)


def test_numbers_that_yaml_takes_for_texts_are_numbers():
    assert read({"stroke": "1e-2"}, Stage) == (Stage(0.01),)
    assert read({"penalty": "inf"}, Plan) == (Plan(),)


def test_auto_and_nothing_are_none():
    assert read({"speed": "auto"}, Plan) == read({"speed": None}, Plan) == (Plan(),)


def test_a_setting_may_have_another_name_in_a_file():
    assert read({"file": "a.yaml"}, Plan, keys=True) == (Plan("a.yaml"),)
    assert [key_of(field) for field in dataclasses.fields(Plan)] == ["file", "speed", "penalty"]
    assert [is_required(field) for field in dataclasses.fields(Stage)] == [True, False, False]


def test_plain_values_are_read_again():
    configs = Stage(0.5, ("X", "Y")), Plan("a.yaml", 0.25)
    assert merged(configs) == {
        "stroke": 0.5, "axes": ["X", "Y"], "steps": 200, "plan": "a.yaml", "speed": 0.25, "penalty": math.inf
    }  # fmt: skip
    assert read(merged(configs), Stage, Plan) == configs
    assert plain(Stage(0.5, ())) == {"stroke": 0.5, "steps": 200}  # ROS cannot tell the type of an empty list


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({}, "stroke must be given: how far it goes [m]"),
        ({"stroke": 11}, "stroke must lie in [0.001, 10.0], got 11.0: are these millimetres?"),
        ({"stroke": math.nan}, "stroke must be a finite number, got nan"),
        ({"stroke": 1, "steps": 1.5}, "steps must be a whole number, got 1.5"),
        ({"stroke": 1, "axes": "X"}, "axes must be a list of texts, got 'X'"),
        ({"stroke": 1, "axis": "X", 5: 6}, "expected any of stroke, axes, steps, got axis, 5"),
    ],
)
def test_what_does_not_fit_is_refused(values, words):
    with pytest.raises(ValueError) as refusal:
        read(values, Stage)
    assert str(refusal.value) == words


def test_classes_may_not_share_a_name():
    with pytest.raises(ValueError, match=r"^Stage, Stage repeat the setting axes, steps, stroke$"):
        read({"stroke": 1}, Stage, Stage)
