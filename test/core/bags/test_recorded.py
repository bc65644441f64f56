"""Offline estimation from a bag with a force sensor, and from one of several cells."""

import json
import pathlib
import shutil

import pytest
from calls import invoked
from geometry_msgs.msg import PoseWithCovarianceStamped, WrenchStamped
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from pushfric_core import TABLE_1, EstimatorConfig, InvalidInput, Pose, PushedObject, PushingLine
from pushfric_core.bags.bag import Bag
from pushfric_core.bags.bag_writer import BagWriter, offered
from pushfric_core.bags.message_types import encoder
from pushfric_core.bags.recorded import Recorded
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.object_file import load_object
from pushfric_msgs.msg import PusherState
from pushfric_ros.messages.conversions import pose_to_msg, stamp_to_msg
from pushfric_ros.node_kit.qos import RELIABLE, SENSOR_DATA

DEMO = pathlib.Path(__file__).resolve().parents[3] / "bags/rubber_rect4"
NAME = "rubber_rect4"
FRAME = round(1e9 / 14)
WITH_FORCES = EstimatorSettings(EstimatorConfig(terms=("moment", "force")))
TYPES = {
    "object_pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "pusher_state": "pushfric_msgs/msg/PusherState",
    "wrench": "geometry_msgs/msg/WrenchStamped",
}


def bag_of(folder, wrenches):
    """A push of 38 frames, the pusher at rest in two; in the first `wrenches`, the force sensor measured 2 N along y."""
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
            if frame in (0, 37):
                state.push_id, state.speed = PusherState.NO_PUSH, 0.0
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
    every = Recorded(bag).read(model, EstimatorSettings(), warnings.append).observations
    assert len(every) >= 5
    assert not warnings
    found = Recorded(bag).read(model, WITH_FORCES, warnings.append).observations
    last = 10**18 + (wrenches - 1) * FRAME + 2  # poses, states and forces come 1 ns apart
    complete = [o.stamp for o in every if o.stamp + round(o.duration * 5e8) < last]
    assert [o.stamp for o in found] == complete
    assert all(sum(component**2 for component in o.force) == pytest.approx(4.0) for o in found)
    left_out = len(every) - len(complete)
    told = f"{bag}: ends before the force of its last observations was measured; left out: {left_out}"
    assert warnings == ([told] if left_out else [])
    assert (left_out > 2) == (wrenches == 20)


# --- several cells in one bag ---


@pytest.fixture(scope="module")
def two_cells(tmp_path_factory):
    """The demo's bag recorded as two cells, of which /left has left out push 3, and the settings of /right come last."""
    folder = tmp_path_factory.mktemp("cells") / "both"
    demo = Bag(DEMO)
    encode = encoder("std_msgs/msg/String")
    with BagWriter(folder) as writer:
        for cell in ("left", "right"):
            for topic in demo.summary.topics:
                writer.add_topic(topic.name.replace("/cell", f"/{cell}"), topic.type_name, topic.qos_profiles)
        settings = Recorded(DEMO).settings
        for message in demo.messages():
            for cell, later in (("left", 0), ("right", 1)):
                raw = message.raw
                if message.topic == "/cell/estimator_settings":
                    raw = encode(String(data=(settings if later else settings.without([3, 99])).to_text()))
                writer.write(message.topic.replace("/cell", f"/{cell}"), message.log_time_ns + later, raw)
    shutil.copy(DEMO / "object.yaml", folder)
    return folder


def test_one_of_several_cells_must_be_chosen(two_cells, tmp_path):
    pushes = tmp_path / "pushes.csv"
    pushes.write_text("contact_x,contact_y,normal_x,normal_y,tip_vx,tip_vy\n0.0,-0.032,0,-1,0.0,1.0\n")
    for command in (["estimate"], ["region"], ["recognize"], ["replay", "--headless"], ["predict", "--pushes", str(pushes)]):
        run = invoked(*command, two_cells)
        assert isinstance(run.exception, InvalidInput), command
        assert "holds the observations of 2 cells, /left, /right; choose one with --namespace" in str(run.exception)
    run = invoked("estimate", two_cells, "--namespace", "middle")
    assert "no observations of /middle; expected the topics object_pose and pusher_state" in str(run.exception)


@pytest.mark.parametrize(("cell", "excluded"), [("/left", (3, 99)), ("right/", ())])
def test_the_settings_are_those_of_the_chosen_cell(two_cells, cell, excluded):
    assert Recorded(two_cells, cell).settings.excluded == excluded
    leave_out = [text for push in excluded[:1] for text in ("--exclude-push", str(push))]
    run = invoked("estimate", two_cells, "--namespace", cell, "--json")
    chosen, alone = json.loads(run.stdout), json.loads(invoked("estimate", DEMO, *leave_out, "--json").stdout)
    assert chosen["data_points"] == alone["data_points"]
    assert chosen["w"] == alone["w"]
    again = json.loads(invoked("estimate", two_cells, "--namespace", cell, "--keep-push", "3", "--json").stdout)
    assert again["w"] == json.loads(invoked("estimate", DEMO, "--keep-push", "3", "--json").stdout)["w"]
