"""`./pushfric run CELL --simulated` and `--simulated-camera`: the user's own files, simulated parts, the whole graph."""

import json
import subprocess
import sys
import time

import pytest

from pushfric_ros.commands.demo import demo_cell
from pushfric_ros.simulated.grbl_firmware import SimulatedGrbl

OBJECT = """
name: box
outline: [[-0.06, -0.03], [0.06, -0.03], [0.06, 0.03], [-0.06, 0.03]]
support: {points: [[-0.05, -0.02], [0.05, -0.02], [0.05, 0.02], [-0.05, 0.02]]}
"""
PATIENT = {"silence": 60.0, "owner_timeout": 60.0, "requires_timeout": 60.0, "memory": "", "retract_speed": 0.1}


@pytest.fixture
def cell(tmp_path):
    """The path of a cell's file, whose controller is at tmp_path / "tty"."""
    demo_cell("wood_rect4", tmp_path)  # writes the camera's calibration
    (tmp_path / "object.yaml").write_text(OBJECT)
    pushes = [{"edge": 0, "offset": 0.03}, {"edge": 2, "offset": 0.02}]
    (tmp_path / "plan.yaml").write_text(json.dumps({"pushes": pushes}))
    content = {
        "object": "object.yaml",
        "camera": {"source": "0", "calibration": "camera.yaml"},
        "pusher": {"port": str(tmp_path / "tty"), "line_origin": [0, 0], "line_direction": [0, 1], "tip_radius": 0.003,
                   "stroke": 0.06, "max_speed": 0.1, **PATIENT},
        "plan": {"file": "plan.yaml", "distance": 0.03, "lost_object": 60.0, "lost_result": 60.0},
        "simulation": {"contact_friction": 0.4},
    }  # fmt: skip
    (tmp_path / "cell.yaml").write_text(json.dumps(content))
    return tmp_path / "cell.yaml"


def run(cell, *options) -> subprocess.CompletedProcess:
    arguments = ["run", str(cell), "--headless", "--bag", str(cell.parent / "bag"), *options]
    return subprocess.run([sys.executable, "-m", "pushfric_ros", *arguments], capture_output=True, text=True, timeout=300)


def estimate(cell) -> dict:
    arguments = ["estimate", str(cell.parent / "bag"), "--json"]
    result = subprocess.run([sys.executable, "-m", "pushfric_ros", *arguments], capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


def test_a_cell_without_any_hardware(cell):
    ended = run(cell, "--simulated")
    assert ended.returncode == 0, ended.stderr
    last = estimate(cell)
    assert last["object"] == "box"
    assert last["pushes"] == 2
    assert last["center_of_friction"] == pytest.approx([0.0, 0.0], abs=0.02)


def test_the_rendered_camera_follows_a_real_tip(cell):
    with SimulatedGrbl(time.monotonic, restarts=False) as controller:
        (cell.parent / "tty").symlink_to(controller.port)
        ended = run(cell, "--simulated-camera")
        assert ended.returncode == 0, ended.stderr
        assert controller.position() == pytest.approx(0.0, abs=1e-9)
    last = estimate(cell)
    assert last["pushes"] == 2
    assert last["center_of_friction"] == pytest.approx([0.0, 0.0], abs=0.02)


def test_what_cannot_be_simulated_is_one_line(cell):
    markers = cell.read_text().replace('"calibration"', '"tracker": "fiducial", "fiducials": "markers.yaml", "calibration"')
    (cell.parent / "markers.yaml").write_text("dictionary: DICT_4X4_50\nmarkers: []\n")
    (cell.parent / "other.yaml").write_text(markers)
    for path, options, error in (
        (cell, ("--simulated", "--simulated-camera"), "give --simulated or --simulated-camera, not both"),
        (cell, ("--simulated-camera",), "no serial port at"),
        (cell.parent / "other.yaml", ("--simulated",), "a rendered camera shows an outline, expected camera.tracker contour"),
    ):
        ended = run(path, *options)
        assert ended.returncode == 2, ended.stderr
        assert error in ended.stderr.strip().splitlines()[-1]
        assert not (cell.parent / "bag").exists()
