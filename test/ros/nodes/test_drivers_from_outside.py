"""A pusher and a tracker of another package in the real nodes, chosen by name in a cell's file, without an edit in pushfric."""

import importlib
import pathlib
import sys

import numpy as np
import pytest
import yaml
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from sensor_msgs.msg import Image

from pushfric_core.cell.cell_file import load_cell
from pushfric_core.errors import InvalidInput
from pushfric_core.vision.camera import Camera, save_camera
from pushfric_msgs.action import Push
from pushfric_msgs.msg import PusherState
from pushfric_ros.commands import doctor
from pushfric_ros.graph import graph
from pushfric_ros.messages.conversions import image_to_msg
from pushfric_ros.node_kit.qos import RELIABLE, SENSOR_DATA, SENSOR_QUEUE
from pushfric_ros.nodes.actuator import ActuatorNode
from pushfric_ros.nodes.tracker import TrackerNode

EXAMPLES = pathlib.Path(__file__).parents[3] / "examples"
MODULE = '''
"""A tracker that takes the bright spot for the object."""

from dataclasses import dataclass

import numpy as np

from pushfric_core.geometry.planar import Pose
from pushfric_core.settings import setting
from pushfric_core.vision.sighting import NotSeen, Sighting


@dataclass(frozen=True)
class SpotConfig:
    level: int = setting(128, "what is brighter belongs to the spot", 1, 254)

    def open_tracker(self, camera, model, height):
        return SpotTracker(camera, height, self.level)

    def absence(self):
        return None


class SpotTracker:
    def __init__(self, camera, height, level):
        self._camera, self._height, self._level = camera, height, level

    def track(self, image, expected=None):
        rows, columns = np.nonzero(image > self._level)
        if not len(rows):
            raise NotSeen("no spot")
        ((x, y),) = self._camera.unproject(np.array([(columns.mean(), rows.mean())]), self._height)
        return Sighting(Pose(float(x), float(y), 0.0), 0.0, 1.0, 1, np.diag((1e-8, 1e-8, 1e-4)))
'''
ENTRY_POINTS = "[pushfric.pushers]\nslide = own_pusher:SlideConfig\n[pushfric.trackers]\nspot = bright_spot:SpotConfig\n"
CAMERA = Camera.looking_down(320, 240, (0.0, 0.06), 0.001)
CELL = {
    "object": "rubber_rect4",
    "camera": {"source": "topic", "calibration": "camera.yaml", "tracker": "spot", "level": 200},
    "pusher": {
        "driver": "slide",
        "backlash": 0.0002,
        "line_origin": [0.1, 0.0],
        "line_direction": [0.0, 1.0],
        "tip_radius": 0.003,
        "stroke": 0.06,
        "max_speed": 0.1,
    },
}


@pytest.fixture
def package(tmp_path, monkeypatch, install):
    """The slide of the examples and a tracker, installed; both are patient with a busy machine."""
    (tmp_path / "site").mkdir()
    (tmp_path / "site/bright_spot.py").write_text(MODULE)
    install(ENTRY_POINTS, tmp_path / "site", EXAMPLES)
    own_pusher = importlib.import_module("own_pusher")
    monkeypatch.setattr(own_pusher, "DEAD_MAN", 10.0)
    own_pusher.Slide(str(tmp_path / "slide")).start()
    yield
    for name in ("bright_spot", "own_pusher"):
        sys.modules.pop(name, None)


@pytest.fixture
def write(tmp_path):
    save_camera(CAMERA, tmp_path / "camera.yaml")

    def write(**changes):
        sections = {
            "pusher": {"device": str(tmp_path / "slide")} | changes.get("pusher", {}),
            "camera": changes.get("camera", {}),
        }
        content = CELL | {name: CELL[name] | section for name, section in sections.items()}
        (tmp_path / "cell.yaml").write_text(yaml.safe_dump(content))
        return tmp_path / "cell.yaml"

    return write


def overrides(cell, name) -> list[Parameter]:
    """What the graph gives a node of this name; but here it speaks to whoever listens."""
    (spec,) = [spec for spec in graph.cell(cell, "bag") if spec.name == name]
    return [Parameter(key, value=value) for key, value in spec.parameters.items() if key != "heard_by"]


def test_a_pusher_from_outside_pushes(ros, package, write):
    cell = load_cell(write(pusher={"owner_timeout": 0}))
    peer = ros.node("peer", namespace="/cell")
    states = ros.heard(peer, PusherState, "pusher_state", RELIABLE)
    client = ActionClient(peer, Push, "push")
    alone = [override for override in overrides(cell, "actuator") if override.name != "requires"]  # no other node runs here
    node = ros.compose(ActuatorNode(namespace="/cell", parameter_overrides=alone))
    assert node.get_parameter("backlash").value == 0.0002
    ros.wait_for(lambda: states and states[-1].mode == PusherState.MODE_IDLE, what="a pusher that is ready")
    ros.wait_for(client.server_is_ready, what="the action server")
    handle = ros.answer(client.send_goal_async, Push.Goal(push_id=3, distance=0.03, speed=0.06), what="the answer to the goal")
    ended = ros.answer(handle.get_result_async, what="the end of the push")
    assert ended.status == GoalStatus.STATUS_SUCCEEDED
    assert ended.result.travelled == pytest.approx(0.03, abs=0.003)  # as last reported
    ros.wait_for(lambda: states[-1].position == pytest.approx(0.03), what="a report from the end of the stroke")
    assert (states[-1].tip.x, states[-1].tip.y) == pytest.approx((0.1, 0.03))
    assert 3 in {state.push_id for state in states}


def test_a_tracker_from_outside_finds_its_object(ros, package, write):
    cell = load_cell(write())
    peer, poses = ros.node("peer", namespace="/cell"), []
    heard = peer.create_subscription(PoseWithCovarianceStamped, "object_pose", poses.append, SENSOR_QUEUE)
    images = peer.create_publisher(Image, "image_raw", SENSOR_DATA)
    ros.compose(TrackerNode(namespace="/cell", parameter_overrides=overrides(cell, "tracker")))
    ros.wait_for(lambda: heard.get_publisher_count() and images.get_subscription_count(), what="the tracker")
    picture = np.full((240, 320), 190, np.uint8)
    ((u, v),) = CAMERA.project(np.array([(0.03, 0.05)])).round().astype(int)
    picture[v - 2 : v + 3, u - 2 : u + 3] = 255
    images.publish(image_to_msg(picture, 10**18))
    ros.wait_for(lambda: poses, what="a pose")
    place = poses[0].pose.pose.position
    assert (place.x, place.y) == pytest.approx((0.03, 0.05), abs=6e-4)


def test_the_doctor_asks_the_driver(package, write):
    cell = load_cell(write())
    checks = list(cell.driver.checks(cell.pusher, cell.plan.distance, cell.plan.speed))
    assert checks == [doctor.Check("slide", doctor.Grade.OK, "0.2 mm of play in pushes of 50 mm")]


def test_a_setting_of_another_driver_is_unknown(package, write):
    with pytest.raises(InvalidInput, match=r"pusher: expected any of line_origin, .*, autostart, device, backlash, got port$"):
        load_cell(write(pusher={"port": "/dev/ttyUSB0"}))


def test_a_package_that_cannot_be_imported_is_told(package, write, tmp_path):
    (tmp_path / "site/bright_spot.py").write_text("import nothing_of_this_name")
    with pytest.raises(InvalidInput, match="tracker 'spot' cannot be loaded from bright_spot:SpotConfig: No module named"):
        load_cell(write())
