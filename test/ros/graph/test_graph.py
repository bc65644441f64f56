"""The whole graph in one process."""

import dataclasses
import pathlib

import pytest

from pushfric_core.bags.bag import Bag
from pushfric_core.bags.recorded import ObservationSource
from pushfric_core.cell.node_settings import PlanConfig, PlannerConfig, ViewConfig
from pushfric_core.errors import InvalidInput
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_msgs.msg import FrictionEstimate, PlanProgress
from pushfric_ros.commands.demo import demo_cell
from pushfric_ros.graph import graph
from pushfric_ros.graph.composition import compose
from pushfric_ros.node_kit.qos import LATCHED

PLAN = "pushes: [{edge: 0, offset: 0.03}, {edge: 2, offset: -0.02}]"


@pytest.fixture
def specs(tmp_path):
    (tmp_path / "plan.yaml").write_text(PLAN)
    cell = dataclasses.replace(demo_cell("wood_rect4", tmp_path), plan=PlanConfig(str(tmp_path / "plan.yaml"), distance=0.03))
    return graph.simulated_cell(cell, str(tmp_path / "bag"), seed=3, speed=8.0)


def test_the_composed_graph_carries_out_a_plan(ros, specs, tmp_path):
    node = ros.node("peer", namespace=graph.NAMESPACE)
    estimates, progress = [], []
    node.create_subscription(FrictionEstimate, "friction_estimate", estimates.append, LATCHED)
    node.create_subscription(PlanProgress, "plan_progress", progress.append, LATCHED)
    ros.compose(*compose(specs, graph.NAMESPACE))
    ros.wait_for(lambda: progress and progress[-1].completed == 2, timeout=120.0, what="the end of the plan")
    ros.wait_for(lambda: estimates and estimates[-1].pushes == 2, what="an estimate from both pushes")
    assert progress[-1].aborted == 0
    assert estimates[-1].data_points >= 4


def test_every_node_of_the_graph_is_an_executable(specs):
    source = ObservationSource("poses", "/cell", ("a", "b"))
    replay = graph.replay("bag", "object", source, 1.0, EstimatorSettings())
    shown = graph.with_view(specs, "wood_rect4", ViewConfig())
    names = {spec.executable for spec in (*graph.with_planner(shown, PlannerConfig()), *replay)}
    setup = (pathlib.Path(__file__).parents[3] / "src/pushfric_ros/setup.py").read_text()
    assert names == {
        "simulated_cell_node",
        "recorder_node",
        "estimator_node",
        "tracker_node",
        "actuator_node",
        "experiment_node",
        "player_node",
        "view_node",
        "planner_node",
    }
    for name in names:
        assert f'"{name.removesuffix("_node")}"' in setup


def test_what_leads_a_run_waits_for_the_view(specs):
    shown = {spec.name: spec for spec in graph.with_view(specs, "wood_rect4", ViewConfig(port=9000))}
    given = shown["view"].parameters
    assert pathlib.Path(given.pop("report")).parts[-2:] == ("bag", "report.html")
    assert given == {"object": "wood_rect4", "played": False, "host": "127.0.0.1", "port": 9000, "token": ""}
    assert shown["experiment"].parameters["awaits"] == ["estimator", "recorder", "view"]
    source = ObservationSource("poses", "/cell", ("a", "b"))
    replay = graph.with_view(graph.replay("bag", "object", source, 1.0, EstimatorSettings()), "object", ViewConfig())
    assert {spec.name: spec.parameters.get("awaits") for spec in replay} == {
        "estimator": None,
        "player": ["view"],
        "view": None,
    }


def test_no_run_waits_for_the_planner_which_may_die(specs):
    asked = {spec.name: spec for spec in graph.with_planner(specs, PlannerConfig(most_strokes=7))}
    assert asked["planner"].parameters == {"most_pushes": 10_000, "most_strokes": 7, "longest": 10.0}
    assert asked["planner"].respawn
    assert asked["experiment"].parameters["awaits"] == ["estimator", "recorder"]


def test_a_refused_node_leaves_no_other_node_behind(ros, specs, tmp_path):
    broken = [spec if spec.name != "experiment" else graph.NodeSpec("experiment", {"object": "brick"}) for spec in specs]
    with pytest.raises(InvalidInput, match="no object 'brick'"):
        compose(broken, graph.NAMESPACE)
    assert not (tmp_path / "pusher").is_symlink()
    assert Bag(tmp_path / "bag").damage is None  # it was finished


def test_two_simulated_cells_keep_their_own_time(ros, tmp_path):
    (tmp_path / "plan.yaml").write_text(PLAN)
    node = ros.node("peer")
    for name in ("/left", graph.NAMESPACE):
        (tmp_path / name[1:]).mkdir()
        cell = dataclasses.replace(demo_cell("wood_rect4", tmp_path / name[1:]), namespace=name)
        specs = graph.simulated_cell(cell, str(tmp_path / name[1:] / "bag"), seed=3, speed=1.0)
        ros.compose(*compose([spec for spec in specs if spec.name in ("simulated_cell", "estimator")], name))
    for clock, namespace in (("/left/clock", "/left"), ("/clock", graph.NAMESPACE)):
        ros.wait_for(lambda clock=clock: len(node.get_publishers_info_by_topic(clock)) == 1, what=f"a publisher of {clock}")
        ros.wait_for(lambda clock=clock: len(node.get_subscriptions_info_by_topic(clock)) >= 1, what=f"a listener to {clock}")
        for endpoint in (*node.get_publishers_info_by_topic(clock), *node.get_subscriptions_info_by_topic(clock)):
            assert endpoint.node_namespace == namespace
