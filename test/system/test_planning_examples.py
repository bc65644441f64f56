"""The examples that predict run as they stand in examples/; the planner with fewer strokes and candidates."""

import pathlib
import re
import runpy
import sys

import push_to_pose
import pytest
from composition import made
from rclpy.node import Node

from pushfric_ros.nodes.estimator import EstimatorNode
from pushfric_ros.nodes.planner import PlannerNode

EXAMPLES = pathlib.Path(__file__).parents[2] / "examples"


def printed(name, capsys):
    """What the example prints; it must not take pytest's arguments for its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [name])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    return capsys.readouterr().out.splitlines()


def test_an_own_constraint_moves_the_weight_away(capsys):
    without, with_it = (float(re.search(r"\d\.\d\d", line)[0]) for line in printed("own_constraint.py", capsys))
    assert with_it < 0.5 * without


def test_an_own_pusher_gets_where_it_is_sent(capsys):
    *moving, last = printed("own_pusher.py", capsys)
    assert moving[0].startswith("running at ")
    assert last == "idle at 50.0 mm"


def test_the_planner_brings_the_object_nearer(asking, ros, monkeypatch, tmp_path):
    small = {"STROKES": 4, "CANDIDATES": 40, "REFINEMENTS": (0.1, 0.03), "FARTHEST": (0.03, 0.03, 0.3), "STEP": 0.015}
    for name, value in small.items():
        monkeypatch.setattr(push_to_pose, name, value)
    ros.compose(made(EstimatorNode, object="wood_rect4", source="observations"), made(PlannerNode))
    courses = push_to_pose.run(asking("/cell"), "wood_rect4", [0])
    assert list(courses) == ["learned", "even", "true"]
    for (course,) in courses.values():
        assert course.poses[0] == courses["true"][0].poses[0]
        assert course.errors[-1] < 0.8 * course.errors[0]
    assert courses["learned"][0].poses[1] == courses["even"][0].poses[1]  # nothing has been learned yet
    assert courses["learned"][0].poses[-1] != courses["even"][0].poses[-1] != courses["true"][0].poses[-1]
    push_to_pose.draw(courses, str(tmp_path / "errors.png"))
    assert (tmp_path / "errors.png").stat().st_size > 1000


@pytest.fixture
def asking(ros):
    """A function that makes a node that others do not spin."""
    nodes = []

    def make(namespace):
        nodes.append(Node("push_to_pose", namespace=namespace))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()


def test_a_node_that_is_missing_is_named(asking, ros, monkeypatch):
    monkeypatch.setattr(push_to_pose, "PATIENCE", 0.5)
    with pytest.raises(SystemExit, match="error: no planner in /elsewhere: start the nodes as the first lines"):
        push_to_pose.LearningPlanner(asking("/elsewhere"), "wood_rect3")
    ros.compose(made(PlannerNode))
    monkeypatch.setattr(push_to_pose, "PATIENCE", 5.0)
    with pytest.raises(SystemExit, match="error: no estimator in /cell: start the nodes as the first lines"):
        push_to_pose.LearningPlanner(asking("/cell"), "wood_rect3")
