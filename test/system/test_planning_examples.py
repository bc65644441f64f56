"""The examples that predict run as they stand in examples/; the planner with fewer strokes and candidates."""

import pathlib
import runpy
import sys

import pytest

EXAMPLES = pathlib.Path(__file__).parents[2] / "examples"


@pytest.fixture
def push_to_pose(monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)
    import push_to_pose

    yield push_to_pose
    del sys.modules["push_to_pose"]


def test_plain_python(capsys):
    runpy.run_path(str(EXAMPLES / "plain_python.py"), run_name="__main__")
    first, second, third = capsys.readouterr().out.splitlines()
    assert first.startswith("centre of friction (")
    assert second.startswith(("sticking: vx 0.0", "sliding: vx 0.0"))
    assert third.startswith("within ")


def test_the_planner_brings_the_object_nearer(push_to_pose, monkeypatch, tmp_path):
    small = {"STROKES": 2, "CANDIDATES": 16, "ROUNDS": 2, "STEP": 0.015, "REFINEMENTS": (0.05,), "FEWEST": 1}
    for name, value in small.items():
        monkeypatch.setattr(push_to_pose, name, value)
    courses = push_to_pose.run([0])
    assert list(courses) == ["learned", "uniform", "wrong"]
    for (course,) in courses.values():
        assert course.poses[0] == courses["wrong"][0].poses[0]
        assert course.errors[-1] < 0.8 * course.errors[0]
    push_to_pose.draw(courses, str(tmp_path / "errors.png"))
    assert (tmp_path / "errors.png").stat().st_size > 1000
