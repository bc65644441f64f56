"""The policy for SROS 2: every node may do what it does, and only the experiment may push."""

import dataclasses
import pathlib
import shutil
import xml.etree.ElementTree as ElementTree
from functools import partial

import pytest

from pushfric_core.cell.cell_file import load_cell
from pushfric_core.vision.camera import Camera, save_camera
from pushfric_ros.commands import security
from pushfric_ros.commands.security import Permission
from pushfric_ros.node_kit.person import Person
from pushfric_ros.node_kit.visit import Visit
from pushfric_ros.nodes.monitor import MonitorNode

EXAMPLE = pathlib.Path(__file__).parents[3] / "docs/example_cell"

ATTRIBUTES = {"topics": {"publish", "subscribe"}, "services": {"reply", "request"}, "actions": {"execute", "call"}}
ENTRIES = {"topics": "topic", "services": "service", "actions": "action"}
"""The elements of a profile in sros2's policy.xsd, version 0.2.0, with their attributes and entries."""


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    folder = tmp_path_factory.mktemp("security") / "cell"
    shutil.copytree(EXAMPLE, folder)
    save_camera(Camera.looking_down(640, 480, (0.0, 0.06), 0.000625), folder / "camera.yaml")
    return folder / "cell.yaml"


@pytest.fixture(scope="module")
def allowed(cell):
    file = load_cell(cell)
    return security.permissions(
        dataclasses.replace(file, namespace="/left", pusher=dataclasses.replace(file.pusher, enable_timeout=1.0))
    )


def holders(allowed, *permission):
    return {path for path, wanted in allowed.items() if Permission(*permission) in wanted}


def test_only_the_experiment_may_push(allowed):
    assert set(allowed) == {
        f"/left/{name}"
        for name in ("recorder", "estimator", "tracker", "actuator", "experiment", "view", "planner", "command_line")
    }
    assert holders(allowed, "calls", "action", "/left/push") == {"/left/experiment"}
    assert holders(allowed, "serves", "action", "/left/push") == {"/left/actuator"}
    assert {one for wanted in allowed.values() for one in wanted if "/_action/" in one.name} == set()


def test_a_planner_serves_clients_by_names_of_their_own(allowed):
    for name in ("/left/planner/predict_push", "/left/planner/predict_push/*"):
        assert holders(allowed, "serves", "service", name) == {"/left/planner"}


def test_a_person_may_stop_and_reset(allowed):
    by_hand = {"/left/command_line", "/left/view"}
    assert holders(allowed, "publishes", "topic", "/left/stop") == by_hand
    assert holders(allowed, "subscribes", "topic", "/left/stop") == {"/left/actuator"}
    assert holders(allowed, "calls", "service", "/left/actuator/reset") == by_hand
    assert holders(allowed, "serves", "service", "/left/actuator/reset") == {"/left/actuator"}
    offered = {one.name for wanted in allowed.values() for one in wanted if (one.role, one.kind) == ("serves", "service")}
    assert {
        one.name for wanted in allowed.values() for one in wanted if (one.role, one.kind) == ("calls", "service")
    } <= offered


def test_what_a_node_does_with_the_settings_of_the_cell_is_allowed(allowed):
    assert holders(allowed, "subscribes", "topic", "/left/enable") == {"/left/actuator"}
    assert holders(allowed, "subscribes", "topic", "/left/image_raw") == set()  # the camera is a device
    assert holders(allowed, "subscribes", "topic", "/left/object_pose") == {
        "/left/estimator",
        "/left/experiment",
        "/left/recorder",
        "/left/view",
    }
    assert holders(allowed, "publishes", "topic", "/left/actuator/transition_event") == {"/left/actuator"}
    assert holders(allowed, "publishes", "topic", "/rosout") == set(allowed)


def test_the_policy_fits_the_schema(allowed):
    root = ElementTree.fromstring(security.policy(allowed))
    assert (root.tag, root.attrib) == ("policy", {"version": "0.2.0"})
    (enclaves,) = root
    assert enclaves.tag == "enclaves"
    for enclave in enclaves:
        assert enclave.tag == "enclave"
        assert enclave.attrib.keys() == {"path"}
        ((profile,),) = enclave
        assert f"{profile.get('ns')}/{profile.get('node')}" == enclave.get("path")
        for listed in profile:
            assert set(listed.attrib) <= ATTRIBUTES[listed.tag]
            assert set(listed.attrib.values()) == {"ALLOW"}
            assert len(listed) > 0
            assert {entry.tag for entry in listed} == {ENTRIES[listed.tag]}
            assert all(entry.text.startswith("/left/") or entry.text.count("/") == 1 for entry in listed)


def test_sros2_takes_the_policy(allowed, tmp_path):
    sros2 = pytest.importorskip("sros2.policy", reason="sros2 is not installed")
    path = tmp_path / security.FILE
    path.write_text(security.policy(allowed))
    sros2.load_policy(path)  # raises an error if it does not fit the schema


def test_the_nodes_of_the_command_line_serve_nothing(ros):
    """Not even their parameters: the policy allows it to nobody, and a node that may not serve cannot be made."""
    with Visit(partial(MonitorNode, print, print, starts_player=False, namespace="/left")) as monitor:
        assert [*monitor.node.services] == []
    with Person("/left") as person:
        assert [*person._node.services] == []
