"""Which images are kept, and what a tracker finds in them afterwards."""

import csv
import json
import os
import pathlib

import cv2
import numpy as np
import pytest
from calls import figures, invoked
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from pushfric_core import TABLE_1, Pose
from pushfric_core.simulated.camera import SimulatedCamera
from pushfric_core.vision.camera import Camera, save_camera
from pushfric_core.vision.keyframes import Keyframes, RunState

NAME = "rubber_rect4"
FRAME = np.zeros((4, 4), np.uint8)


def kept(moments: list[RunState], everything: bool = False) -> list[int]:
    """Numbers of the images that are kept."""
    keyframes = Keyframes(everything)
    return [stamp for number, moment in enumerate(moments) for stamp, _ in keyframes.take(FRAME, number, moment)]


def test_a_push_gives_its_placement_begin_middle_and_end():
    rest, placed, pushed = RunState(False, False, True), RunState(False, True, True), RunState(True, True, True)
    course = [rest] * 5 + [placed] * 5 + [pushed] * 11 + [rest] * 5
    assert kept(course) == [5, 10, 15, 21]
    assert kept(course * 2) == [5, 10, 15, 21, 31, 36, 41, 47]
    assert kept(course, everything=True) == list(range(26))


def test_each_loss_of_the_object_is_kept_once():
    seen, lost = RunState(True, True, True), RunState(True, True, False)
    assert kept([seen, seen, lost, lost, seen, lost]) == [0, 2, 5]


@pytest.fixture(params=["raw", "compressed"])
def foreign(request, tmp_path) -> tuple[pathlib.Path, list[Pose]]:
    """A bag of images alone, as `ros2 bag record` writes it, with the files of its cell; and where the object lies."""
    camera = Camera.looking_down(640, 480, (0.0, 0.06), 0.000625)
    save_camera(camera, tmp_path / "camera.yaml")
    cell = {"object": NAME, "camera": {"source": "topic", "calibration": "camera.yaml"},
            "pusher": {"port": "/dev/null", "line_origin": [0, 0], "line_direction": [0, 1], "tip_radius": 0.003,
                       "stroke": 0.06, "max_speed": 0.1}}  # fmt: skip
    (tmp_path / "cell.yaml").write_text(json.dumps(cell))
    rng = np.random.default_rng(4)
    simulated = SimulatedCamera(camera, TABLE_1[NAME].outline.vertices, 0.0, rng)
    poses = [Pose(0.01 * number, 0.05, 0.1 * number) for number in range(4)]
    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    kind = "sensor_msgs/msg/Image" if request.param == "raw" else "sensor_msgs/msg/CompressedImage"
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        out = bag.add_connection("/camera/image", kind, typestore=store)
        for number, pose in enumerate([*poses, None]):
            frame = np.full((480, 640), 20, np.uint8) if pose is None else simulated.render(pose)
            stamp = types["builtin_interfaces/msg/Time"](number, 0)
            header = types["std_msgs/msg/Header"](stamp, "camera")
            if request.param == "raw":
                msg = types[kind](header, 480, 640, "mono8", 0, 640, frame.ravel())
            else:
                msg = types[kind](header, "jpeg", cv2.imencode(".jpg", frame)[1].ravel())
            bag.write(out, number * 10**9, store.serialize_cdr(msg, kind))
    return tmp_path, poses


def test_a_bag_of_others_is_tracked_with_the_settings_of_a_cell(foreign):
    folder, poses = foreign
    arguments = ["track", folder / "bag", "--object", NAME, "--cell", folder / "cell.yaml"]
    found = figures(*arguments, "--csv", folder / "poses.csv")
    assert (found["topic"], found["images"], found["seen"], found["compared"]) == ("/camera/image", 5, 4, 0)
    with (folder / "poses.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row, pose in zip(rows, poses, strict=False):
        assert [float(row[name]) for name in ("x", "y")] == pytest.approx([pose.x, pose.y], abs=5e-5)
    assert rows[-1]["reason"]
    # another threshold: nothing is bright enough
    cell = json.loads((folder / "cell.yaml").read_text())
    cell["camera"]["threshold"] = 254
    (folder / "cell.yaml").write_text(json.dumps(cell))
    assert figures(*arguments)["seen"] == 0
    (mcap,) = (folder / "bag").glob("*.mcap")
    os.truncate(mcap, mcap.stat().st_size * 2 // 3)
    assert "missing" in invoked(*arguments).stderr
