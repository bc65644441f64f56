"""An estimate as markers, and a pose as a transform."""

import math
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from problems import observations_of
from rclpy.serialization import deserialize_message, serialize_message
from visualization_msgs.msg import Marker, MarkerArray

from pushfric_core import TABLE_1, Estimator, Pose
from pushfric_core.bags.samples import stamp_from_msg
from pushfric_core.estimation.estimate_report import EstimateReport
from pushfric_core.files.object_file import load_object
from pushfric_core.geometry.planar import OBJECT, TABLE
from pushfric_core.vision.camera import Camera
from pushfric_ros.messages.conversions import estimate_to_msg, pose_to_msg
from pushfric_ros.messages.markers import estimate_to_markers
from pushfric_ros.node_kit.transforms import TransformBroadcaster, camera_transform, object_transform

NAME = "rubber_rect4"
OUTLINE = TABLE_1[NAME].outline
DATA = observations_of(OUTLINE, TABLE_1[NAME].support, 0.5, 5, np.random.default_rng(5))


@pytest.fixture
def estimate():
    last = Estimator(load_object(NAME).support_points).add(DATA)
    return estimate_to_msg(EstimateReport.of(last, NAME, last.belief))


def test_all_markers_are_in_the_object_frame_at_the_newest_observation(estimate):
    array = deserialize_message(serialize_message(estimate_to_markers(estimate, OUTLINE, DATA[-1])), MarkerArray)
    first, *rest = array.markers
    assert first.action == Marker.DELETEALL  # so that a late subscriber shows all markers, and no others
    assert len({(marker.ns, marker.id) for marker in rest}) == len(rest)
    for marker in array.markers:
        assert marker.header.frame_id == OBJECT
        assert stamp_from_msg(marker.header.stamp) == DATA[-1].stamp
    for marker in rest:
        assert marker.frame_locked
        assert marker.color.a > 0
        assert max(marker.scale.x, marker.scale.y, marker.scale.z) > 0


POSE = PoseWithCovarianceStamped()
POSE.header.frame_id, POSE.header.stamp.sec, POSE.pose.pose = TABLE, 12, pose_to_msg(Pose(0.1, -0.2, 0.7))


def test_a_pose_is_the_transform_from_the_table_to_the_object():
    transform = object_transform(POSE)
    assert (transform.header, transform.child_frame_id) == (POSE.header, OBJECT)
    assert (transform.transform.translation.x, transform.transform.translation.y) == (0.1, -0.2)
    assert transform.transform.rotation.z == pytest.approx(math.sin(0.35))


class Recording:
    """Stands in for a node, and records what it is asked for."""

    def __init__(self) -> None:
        self.lines, self.topics, self.sent = [], [], []

    def get_logger(self):
        return SimpleNamespace(info=self.lines.append)

    def create_publisher(self, kind, topic, qos):
        self.topics.append(topic)
        return SimpleNamespace(publish=self.sent.append)


@pytest.mark.parametrize("prefix", ["", "left/"])
def test_with_tf2_msgs_every_pose_goes_to_tf(monkeypatch, prefix):
    monkeypatch.setitem(sys.modules, "tf2_msgs", SimpleNamespace())
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", SimpleNamespace(TFMessage=SimpleNamespace))
    node = Recording()
    TransformBroadcaster(node, prefix).broadcast(object_transform(POSE))
    assert (node.lines, node.topics) == ([], ["/tf"])
    ((transform,),) = [sent.transforms for sent in node.sent]
    assert (transform.header.frame_id, transform.child_frame_id) == (f"{prefix}table", f"{prefix}object")
    assert POSE.header.frame_id == TABLE


@pytest.mark.parametrize("tilt", [0.0, 0.5])
def test_the_camera_is_where_its_calibration_says(tilt):
    """A point of the table, taken into the camera's frame, lies on the ray of its pixel."""
    down = np.array(((1.0, 0.0, 0.0), (0.0, -math.cos(tilt), -math.sin(tilt)), (0.0, math.sin(tilt), -math.cos(tilt))))
    place = np.array((0.1, -0.4, 0.7))  # of the camera; the rows of `down` are its axes in the table frame
    K = np.array(((900.0, 0.0, 320.0), (0.0, 900.0, 240.0), (0.0, 0.0, 1.0)))
    H = 1.7 * K @ np.column_stack((down[:, 0], down[:, 1], -down @ place))
    camera = Camera(640, 480, K, np.zeros(5), H)
    transform = camera_transform(*camera.pose())
    assert (transform.header.frame_id, transform.child_frame_id) == ("table", "camera_optical")
    shift, turn = transform.transform.translation, transform.transform.rotation
    assert (shift.x, shift.y, shift.z) == pytest.approx(tuple(place))
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    assert math.hypot(x, y, z, w) == pytest.approx(1.0)
    cross = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    to_table = np.eye(3) + 2 * w * cross + 2 * cross @ cross
    for point in ((0.0, 0.0), (0.2, 0.1), (-0.1, 0.3)):
        ray = K @ (to_table.T @ (np.array((*point, 0.0)) - place))
        assert camera.project([point])[0] == pytest.approx(ray[:2] / ray[2])
