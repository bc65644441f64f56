"""Offline estimation from a bag with a force sensor."""

import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped, WrenchStamped
from rclpy.serialization import serialize_message

from pushfric_core.contact import PushingLine
from pushfric_core.estimator import EstimatorConfig
from pushfric_core.planar import Pose
from pushfric_core.simulation import PushedObject
from pushfric_core.table_1 import TABLE_1
from pushfric_msgs.msg import PusherState
from pushfric_ros.bags import data_points
from pushfric_ros.bags.bag_writer import BagWriter
from pushfric_ros.files.estimator_settings import EstimatorSettings
from pushfric_ros.files.object_file import load_object
from pushfric_ros.messages.conversions import pose_to_msg, stamp_to_msg
from pushfric_ros.node_kit.qos import RELIABLE, SENSOR_DATA, offered

NAME = "rubber_rect4"
FRAME = round(1e9 / 14)
WITH_FORCES = EstimatorSettings(EstimatorConfig(terms=("moment", "force")))
TYPES = {
    "object_pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "pusher_state": "pushfric_msgs/msg/PusherState",
    "wrench": "geometry_msgs/msg/WrenchStamped",
}


def bag_of(folder, wrenches):
    """A push of 38 frames; in the first `wrenches` of them, the force sensor measured 2 N along y."""
    known = TABLE_1[NAME]
    pushed = PushedObject(known.outline, known.support, known.mu_c, Pose(0.03, 0.04, 0.0))
    line = PushingLine((0.0, 0.0), (0.0, 1.0), 0.003)
    with BagWriter(folder) as writer:
        for topic, type_name in TYPES.items():
            writer.add_topic(f"/cell/{topic}", type_name, [offered(RELIABLE if topic == "pusher_state" else SENSOR_DATA)])
        for frame in range(38):
            stamp, position = 10**18 + frame * FRAME, frame * 0.02 / 14
            pushed.push(line, position)
            pose = PoseWithCovarianceStamped()
            pose.pose.pose = pose_to_msg(pushed.pose)
            state = PusherState(position=position, speed=0.02, tip_radius=0.003, push_id=0, mode=PusherState.MODE_RUNNING)
            state.direction.y, state.tip.y = 1.0, position
            wrench = WrenchStamped()
            wrench.header.frame_id, wrench.wrench.force.y = "table", 2.0
            said = {"object_pose": pose, "pusher_state": state} | ({"wrench": wrench} if frame < wrenches else {})
            for later, (topic, msg) in enumerate(said.items()):
                msg.header.stamp = stamp_to_msg(stamp + later)
                writer.write(f"/cell/{topic}", stamp + later, serialize_message(msg))
    return folder


@pytest.mark.parametrize("wrenches", [38, 20])
def test_data_points_without_a_force_are_reported(tmp_path, wrenches):
    warnings, model = [], load_object(NAME)
    bag = bag_of(tmp_path / "bag", wrenches)
    every = data_points.observations(bag, model, EstimatorSettings(), warnings.append)
    assert len(every) >= 5
    assert not warnings
    found = data_points.observations(bag, model, WITH_FORCES, warnings.append)
    last = 10**18 + (wrenches - 1) * FRAME + 2  # poses, states and forces come 1 ns apart
    complete = [o.stamp for o in every if o.stamp + round(o.duration * 5e8) < last]
    assert [o.stamp for o in found] == complete
    assert all(sum(component**2 for component in o.force) == pytest.approx(4.0) for o in found)
    left_out = len(every) - len(complete)
    told = f"{bag}: ends before the force of its last data points was measured; left out: {left_out}"
    assert warnings == ([told] if left_out else [])
    assert (left_out > 2) == (wrenches == 20)
