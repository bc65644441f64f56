"""The simulated cell: its clock waits for the actuator, and a person can turn its switches over."""

import math
import os
import select
import types

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Vector3
from sensor_msgs.msg import Image
from std_msgs.msg import String

from pushfric_core.bags.samples import stamp_from_msg
from pushfric_core.geometry.planar import Pose
from pushfric_core.vision.camera import Camera, save_camera
from pushfric_msgs.msg import PusherState
from pushfric_ros.messages.conversions import pose_to_msg
from pushfric_ros.node_kit.parameters import overrides
from pushfric_ros.node_kit.qos import RELIABLE, SENSOR_DATA
from pushfric_ros.nodes import simulated_cell

PERIOD = 0.05  # of the questions, in simulated time [s]


@pytest.fixture
def parameters(tmp_path):
    save_camera(Camera.looking_down(64, 48, center=(0.0, 0.0), metres_per_pixel=0.006), tmp_path / "camera.yaml")
    stage = {"line_origin": [0.0, 0.0], "line_direction": [0.0, 1.0], "tip_radius": 0.003, "stroke": 0.06, "max_speed": 0.1}
    place = {"object": "rubber_rect4", "calibration": str(tmp_path / "camera.yaml"), "port_link": str(tmp_path / "tty")}
    return {**stage, **place, "poll_rate": 1 / PERIOD}


def hear(port: int, what: bytes) -> bytes:
    """What the controller says, until it has said this."""
    said = b""
    while what not in said:
        assert select.select([port], [], [], 60.0)[0], f"{what!r} did not come, only {said!r}"
        said += os.read(port, 4096)
    return said


def test_the_clock_does_not_run_ahead_of_the_reports_of_a_moving_pusher(ros, tmp_path, parameters, monkeypatch):
    """The world of a starved actuator moves slowly, instead of between two reports."""
    wall = [0.0]
    monkeypatch.setattr(simulated_cell, "time", types.SimpleNamespace(monotonic=lambda: wall[0]))
    node = simulated_cell.SimulatedCellNode(parameter_overrides=overrides(parameters))
    port = os.open(tmp_path / "tty", os.O_RDWR | os.O_NOCTTY)

    def steps(count: int) -> int:
        begin = node._steps
        for _ in range(count):
            node._step()
        return node._steps - begin

    try:
        hear(port, b"Grbl")
        assert steps(100) == 100  # at rest
        os.write(port, b"$J=G91 G21 X50 F600\n")
        hear(port, b"ok")
        for _ in range(2):
            os.write(port, b"?")
            hear(port, b"<Jog")
            assert PERIOD < steps(100) * node._elapsed / node._steps < 2 * PERIOD
        wall[0] += 1.0  # nobody waits for ever for an actuator that has stopped
        assert steps(100) == 1
        os.close(port)
        ros.wait_for(lambda: not node._controller.opened, what="the closed port")
        assert steps(100) == 100
    finally:
        node.destroy_node()


def test_no_frame_shows_what_a_real_pusher_has_not_reported_yet(ros, parameters):
    """On a busy machine, a report that comes late must not look like an object that stays behind its pusher."""
    node = ros.compose(simulated_cell.SimulatedCellNode(parameter_overrides=overrides(parameters | {"port_link": ""})))
    other = ros.node("other")
    shown: list[int] = []
    other.create_subscription(Image, "image_raw", lambda msg: shown.append(stamp_from_msg(msg.header.stamp)), SENSOR_DATA)
    reports = ros.publisher(other, PusherState, "pusher_state", RELIABLE)
    ros.wait_for(lambda: len(shown) > 2, what="frames without a report")

    for position in (0.01, 0.02):
        msg = PusherState(position=position, tip_radius=0.003, direction=Vector3(y=1.0), push_id=PusherState.NO_PUSH)
        msg.header.stamp = other.get_clock().now().to_msg()
        reports.publish(msg)
        last = stamp_from_msg(msg.header.stamp)
        ros.wait_for(lambda last=last: last in shown, what="the moment of the report")
        begin = node._elapsed
        ros.wait_for(lambda begin=begin: node._elapsed > begin + 0.5, what="many frames' time")
        assert max(shown) == last


def test_the_object_is_never_laid_right_by_chance(ros, parameters):
    """A game begins with an object that a person must put right."""
    node = ros.compose(simulated_cell.SimulatedCellNode(parameter_overrides=overrides(parameters | {"placement_error": 0.03})))
    for _ in range(200):
        node._on_placement(PoseStamped(pose=pose_to_msg(Pose(0.0, 0.0, 0.0))))
        _, laid = node._placing
        assert 0.03 <= math.hypot(laid.x, laid.y) < 0.09


def test_a_person_switches_the_lamp_off_unplugs_the_camera_and_presses_the_emergency_stop(ros, tmp_path, parameters):
    """Each again, too: until the emergency stop is released, nothing moves, whatever is asked."""
    node = ros.compose(simulated_cell.SimulatedCellNode(parameter_overrides=overrides(parameters)))
    person = ros.node("person")
    images = ros.heard(person, Image, "image_raw", SENSOR_DATA)
    port = os.open(tmp_path / "tty", os.O_RDWR | os.O_NOCTTY)

    switch = ros.publisher(person, String, "switch", RELIABLE)

    def turn_over(name: str, says: str) -> None:
        switch.publish(String(data=name))
        ros.wait_for(lambda: says in node._health().values.values(), what=says)

    def brightness() -> float:
        images.clear()
        ros.wait_for(lambda: len(images) > 1, what="two images")
        return float(np.mean(images[-1].data))

    try:
        hear(port, b"Grbl")
        lit = brightness()
        turn_over("lamp", "the lamp is off")
        ros.wait_for(lambda: brightness() < 0.2 * lit, what="darkness")
        assert node._health().message == "the lamp is off"
        turn_over("lamp", "the lamp is on")
        ros.wait_for(lambda: brightness() > 0.8 * lit, what="light")
        turn_over("unplug", "the camera is unplugged")
        images.clear()
        begin = node._steps
        ros.wait_for(lambda: node._steps > begin + 20, what="five frames' time")
        assert len(images) <= 1  # one may have been on its way
        turn_over("unplug", "the camera is plugged in")
        brightness()
        os.write(port, b"$J=G91 G21 X50 F600\n")
        hear(port, b"ok")
        turn_over("emergency_stop", "the emergency stop is pressed")
        assert b"ALARM:3" in hear(port, b"Grbl")
        rested = node._controller.position()
        os.write(port, b"$X\n$J=G91 G21 X50 F600\n")
        hear(port, b"Grbl")
        assert node._controller.position() - rested < 0.001
        turn_over("emergency_stop", "the emergency stop is released")
        assert node._health().message == "simulating"
    finally:
        os.close(port)
