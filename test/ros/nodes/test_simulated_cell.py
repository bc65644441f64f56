"""The simulated cell's clock waits for the actuator."""

import os
import select
import types

from pushfric_core.vision.camera import Camera, save_camera
from pushfric_ros.node_kit.parameters import overrides
from pushfric_ros.nodes import simulated_cell

PERIOD = 0.05  # of the questions, in simulated time [s]


def test_the_clock_does_not_run_ahead_of_the_reports_of_a_moving_pusher(ros, tmp_path, monkeypatch):
    """The world of a starved actuator moves slowly, instead of between two reports."""
    save_camera(Camera.looking_down(64, 48, center=(0.0, 0.0), metres_per_pixel=0.006), tmp_path / "camera.yaml")
    stage = {"line_origin": [0.0, 0.0], "line_direction": [0.0, 1.0], "tip_radius": 0.003, "stroke": 0.06, "max_speed": 0.1}
    place = {"object": "rubber_rect4", "calibration": str(tmp_path / "camera.yaml"), "port_link": str(tmp_path / "tty")}
    parameters = {**stage, **place, "poll_rate": 1 / PERIOD}
    wall = [0.0]
    monkeypatch.setattr(simulated_cell, "time", types.SimpleNamespace(monotonic=lambda: wall[0]))
    node = simulated_cell.SimulatedCellNode(parameter_overrides=overrides(parameters))
    port = os.open(tmp_path / "tty", os.O_RDWR | os.O_NOCTTY)

    def hear(what: bytes) -> None:
        said = b""
        while what not in said:
            assert select.select([port], [], [], 60.0)[0], f"{what!r} did not come, only {said!r}"
            said += os.read(port, 4096)

    def steps(count: int) -> int:
        begin = node._steps
        for _ in range(count):
            node._step()
        return node._steps - begin

    try:
        hear(b"Grbl")
        assert steps(100) == 100  # at rest
        os.write(port, b"$J=G91 G21 X50 F600\n")
        hear(b"ok")
        os.write(port, b"?")
        hear(b"<Jog")
        assert PERIOD < steps(100) * node._period < 2 * PERIOD
        os.write(port, b"?")
        hear(b"<Jog")
        assert PERIOD < steps(100) * node._period < 2 * PERIOD
        wall[0] += 1.0  # nobody waits for ever for an actuator that has stopped
        assert steps(100) == 1
        os.close(port)
        ros.wait_for(lambda: not node._controller.opened, what="the closed port")
        assert steps(100) == 100
    finally:
        node.destroy_node()
