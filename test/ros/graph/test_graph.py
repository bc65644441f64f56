"""The whole graph in one process."""

import dataclasses
import pathlib

import pytest
import yaml
from composition import compose

from pushfric_core.bags.recorded import ObservationSource
from pushfric_core.cell.cell_file import load_cell
from pushfric_core.cell.node_settings import PlanConfig, ViewConfig
from pushfric_core.errors import InvalidInput
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.pushers.serial_line import open_port
from pushfric_msgs.msg import FrictionEstimate, PlanProgress
from pushfric_ros.commands.demo import demo_cell
from pushfric_ros.graph import graph
from pushfric_ros.node_kit.qos import LATCHED

PLAN = "pushes: [{edge: 0, offset: 0.03}, {edge: 2, offset: -0.02}]"


@pytest.fixture
def specs(tmp_path):
    (tmp_path / "plan.yaml").write_text(PLAN)
    cell = dataclasses.replace(demo_cell("wood_rect4", tmp_path), plan=PlanConfig(str(tmp_path / "plan.yaml"), distance=0.03))
    return graph.simulated_cell(cell, str(tmp_path / "bag"), seed=3, speed=8.0)


def test_the_composed_graph_carries_out_a_plan(ros, specs, tmp_path):
    node = ros.node("peer", namespace=graph.NAMESPACE)
    estimates = ros.heard(node, FrictionEstimate, "friction_estimate", LATCHED)
    progress = ros.heard(node, PlanProgress, "plan_progress", LATCHED)
    ros.compose(*compose(specs, graph.NAMESPACE))
    ros.wait_for(lambda: progress and progress[-1].completed == 2, timeout=120.0, what="the end of the plan")
    ros.wait_for(lambda: estimates and estimates[-1].pushes == 2, what="an estimate from both pushes")
    assert progress[-1].aborted == 0
    assert estimates[-1].data_points >= 4


OTHERS = """
object: wood_rect4
camera: {source: "0", calibration: camera.yaml, tracker: fiducial, fiducials: markers.yaml, threshold: 90,
  time_offset: -0.15}
pusher: {driver: marlin, port: /dev/ttyACM0, line_origin: [0, 0], line_direction: [0, 1], tip_radius: 0.003, stroke: 0.06,
  max_speed: 0.1}
plan: {file: plan.yaml, distance: 0.03}
estimator: {pose_lag: 0.1}
"""


@pytest.fixture
def others(tmp_path, install):
    """The path of a cell's file with a driver of another package and markers."""
    install("[pushfric.pushers]\nmarlin = examples.marlin:MarlinConfig\n", pathlib.Path(__file__).parents[3])
    (tmp_path / "plan.yaml").write_text(PLAN)
    demo_cell("wood_rect4", tmp_path)  # writes the camera's calibration
    (tmp_path / "cell.yaml").write_text(OTHERS)
    return tmp_path / "cell.yaml"


def simulated(file, folder, said):
    return graph.simulated_cell(graph.rendered(load_cell(file), str(folder), said.append), str(folder / "bag"), 3, 8.0)


def test_parts_without_a_simulation_are_replaced_with_a_sentence_each(others, tmp_path):
    said = []
    specs = {spec.name: spec.parameters for spec in simulated(others, tmp_path, said)}
    assert said == [
        "the rendered camera shows an outline, not what camera.tracker fiducial needs: contour takes its place",
        "pusher.driver marlin has no simulation: a GRBL controller takes its place",
    ]
    assert (specs["actuator"]["driver"], specs["simulated_cell"]["controller"]) == ("grbl", "grbl")
    assert (specs["tracker"]["tracker"], specs["tracker"]["threshold"]) == ("contour", 0)
    assert (specs["tracker"]["time_offset"], specs["estimator"]["pose_lag"]) == (0, 0)  # rendered images have exact stamps
    content = yaml.safe_load(OTHERS)
    del content["camera"]
    others.write_text(yaml.safe_dump(content | {"poses": {"source": "pose_stamped", "topic": "/tag"}}))
    said.clear()
    assert "tracker" in {spec.name for spec in simulated(others, tmp_path, said)}
    assert said[0] == "no simulation has the poses of other trackers: a rendered camera over the pushing line takes their place"
    seen = (tmp_path / "camera.yaml").read_text()
    others.write_text(others.read_text().replace("- 0\n  - 1\n", "- 0\n  - 2\n"))  # a direction may have any length
    simulated(others, tmp_path, said)
    assert (tmp_path / "camera.yaml").read_text() == seen
    del content["pusher"]
    others.write_text(yaml.safe_dump(content | {"poses": {"topic": "/tag"}, "tip": {"topic": "/hand", "tip_radius": 0.003}}))
    with pytest.raises(InvalidInput, match="others move this cell's robot, which cannot be simulated"):
        simulated(others, tmp_path, said)


def test_a_driver_of_another_package_brings_its_simulation(ros, others, tmp_path):
    installed = tmp_path / "installed/from_outside-1.0.dist-info/entry_points.txt"
    entry = "marlin = pushfric_core.simulated.grbl_firmware:SimulatedGrbl"
    installed.write_text(f"{installed.read_text()}[pushfric.simulations]\n{entry}\n")
    said = []
    specs = [spec for spec in simulated(others, tmp_path, said) if spec.name == "simulated_cell"]
    assert [sentence for sentence in said if "pusher" in sentence] == []
    assert specs[0].parameters["controller"] == "marlin"
    ros.compose(*compose(specs, graph.NAMESPACE))
    with open_port(specs[0].parameters["port_link"], 115200) as port:
        heard = bytearray()
        ros.wait_for(lambda: b"Grbl" in heard or heard.extend(port.read(port.in_waiting)), what="its greeting")


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
