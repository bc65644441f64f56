"""`./pushfric calibrate tip` on rendered pictures, and on a topic with a controller on a pseudo-terminal."""

import contextlib
import json
import math
import pathlib
import re
import signal
import subprocess
import time

import cv2
import numpy as np
import pytest
import yaml
from calls import PROGRAM, invoked, pushfric, wait_until
from sensor_msgs.msg import Image

from pushfric_core import InvalidInput, Pose
from pushfric_core.cell.cell_file import load_cell
from pushfric_core.commands.frames import frames_from
from pushfric_core.simulated.camera import SimulatedCamera
from pushfric_core.simulated.grbl_firmware import SimulatedGrbl
from pushfric_core.vision.camera import Camera, save_camera
from pushfric_ros.commands import topic_frames
from pushfric_ros.messages.conversions import image_to_msg
from pushfric_ros.node_kit.qos import SENSOR_DATA

CAMERA = Camera.looking_down(640, 480, (0.1, 0.05), 0.0006)
BOX = np.array(((-0.05, -0.03), (0.05, -0.03), (0.05, 0.03), (-0.05, 0.03)))
HEIGHT, RADIUS = 0.012, 0.004
ANGLES = np.linspace(0, 2 * np.pi, 60, endpoint=False)
TIP = RADIUS * np.column_stack((np.cos(ANGLES), np.sin(ANGLES)))
ORIGIN, DIRECTION = np.array((0.08, 0.02)), np.array((math.cos(0.3), math.sin(0.3)))
STROKE = 0.05
DOCS = pathlib.Path(__file__).parents[3] / "docs/files.md"

OBJECT = f"""\
name: box   # a block of wood
outline: {(1.006 * BOX).tolist()}
support: {{grid: [5, 3]}}
height: {HEIGHT}
"""
CELL = """\
object: box.yaml
camera: {{source: "{source}", calibration: camera.yaml}}
pusher:
  port: {port}
  line_origin: [0.0, 0.0]   # not measured yet
  line_direction: [1.0, 0.0]
  tip_radius: 0.003
  stroke: 0.05
  max_speed: 0.1
  silence: 5.0
  owner_timeout: 5.0
"""


@pytest.fixture
def cell(tmp_path):
    """A cell whose camera is a folder of pictures of the object in two places, 10 cm apart."""
    (tmp_path / "pictures").mkdir()
    save_camera(CAMERA, tmp_path / "camera.yaml")
    (tmp_path / "box.yaml").write_text(OBJECT)
    (tmp_path / "cell.yaml").write_text(CELL.format(source=tmp_path / "pictures", port="/dev/pushfric-none"))
    camera = SimulatedCamera(CAMERA, BOX, HEIGHT, np.random.default_rng(0))
    for number, x in enumerate((0.05, 0.15)):
        cv2.imwrite(str(tmp_path / f"pictures/{number}.png"), camera.render(Pose(x, 0.05, 0.4)))
    return tmp_path / "cell.yaml"


def measured(*arguments):
    return invoked("calibrate", "tip", *arguments)


def tip_pictures(cell):
    """Write pictures of the tip along its stroke; returns the arguments that name them."""
    folder, positions = cell.parent / "tip", np.linspace(0, STROKE, 8)
    folder.mkdir()
    camera = SimulatedCamera(CAMERA, TIP, 0.01, np.random.default_rng(1), foreground=80, background=20)
    for number, position in enumerate(positions):
        x, y = ORIGIN + position * DIRECTION
        cv2.imwrite(str(folder / f"{number:02}.png"), camera.render(Pose(x, y, 0.0)))
    return "--source", folder, "--positions", ",".join(map(str, positions))


def test_nothing_is_overwritten_unasked(cell):
    before, given = cell.read_text(), tip_pictures(cell)
    run = measured(cell, *given)
    assert isinstance(run.exception, InvalidInput)
    assert str(run.exception) == f"{cell} exists: give --force, or --out FOLDER to write elsewhere"
    (cell.parent / "new").mkdir()
    assert measured(cell, *given, "--out", cell.parent / "new").exit_code == 0
    assert cell.read_text() == before
    found = yaml.safe_load((cell.parent / "new/pusher.yaml").read_text())["pusher"]
    assert found["tip_radius"] == pytest.approx(RADIUS, abs=0.15e-3)


def test_the_tip_is_written_into_the_cells_file(cell):
    run = measured(cell, *tip_pictures(cell), "--force")
    assert run.exit_code == 0, run.output
    assert "cell.yaml: line_origin is " in run.stderr
    assert "# not measured yet" in cell.read_text()
    pusher = load_cell(cell).pusher
    np.testing.assert_allclose(pusher.line_origin, ORIGIN, atol=0.3e-3)
    assert abs(math.degrees(math.atan2(*pusher.line_direction[::-1]) - 0.3)) < 0.2
    assert pusher.tip_radius == pytest.approx(RADIUS, abs=0.15e-3)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--force"], "shows no live camera: give --positions"),
        (["--force", "--positions", "0"], "2 pictures, but --positions names 1"),
        (["--force", "--positions", "0,50"], "--positions must lie within 0.05 m, got (0.0, 50.0): are these millimetres?"),
        (["--out", "none"], "none: no such folder"),
    ],
)
def test_what_does_not_go_together_is_refused(cell, arguments, said):
    run = measured(cell, *arguments)
    assert isinstance(run.exception, InvalidInput)
    assert said in str(run.exception)


@contextlib.contextmanager
def live_cell(cell, ros):
    """A driver that shows the tip where the controller has it, and the cell's files for both."""
    camera = SimulatedCamera(CAMERA, TIP, 0.01, np.random.default_rng(1), foreground=80, background=20)
    with SimulatedGrbl(time.monotonic, travel=0.1) as controller:
        cell.write_text(CELL.format(source="topic", port=controller.port))
        driver = ros.node("driver", namespace="/cell")
        out = driver.create_publisher(Image, "image_raw", SENSOR_DATA)

        def show() -> None:
            x, y = ORIGIN + controller.position() * DIRECTION
            out.publish(image_to_msg(camera.render(Pose(x, y, 0.0)), 0))

        driver.create_timer(0.04, show)
        yield controller


def test_the_pusher_goes_along_its_stroke_and_back(cell, ros):
    with live_cell(cell, ros) as controller:
        run = pushfric("calibrate", "tip", cell, "--force", "--speed", "0.05")
        assert run.returncode == 0, run.stderr
        assert controller.position() == pytest.approx(0.0, abs=1e-6)
    pusher = load_cell(cell).pusher
    np.testing.assert_allclose(pusher.line_origin, ORIGIN, atol=0.3e-3)
    np.testing.assert_allclose(pusher.line_direction, DIRECTION, atol=math.radians(0.2))


def test_ctrl_c_stops_the_pusher_and_writes_nothing(cell, ros):
    with live_cell(cell, ros) as controller:
        before = cell.read_text()
        command = [*PROGRAM, "calibrate", "tip", str(cell), "--force", "--speed", "0.001"]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, stdin=subprocess.DEVNULL) as run:
            wait_until(lambda: controller.position() > 1e-3 or run.poll() is not None, "a motion")
            assert run.poll() is None, run.communicate()
            run.send_signal(signal.SIGINT)
            _, said = run.communicate(timeout=120)
        assert run.returncode == 130, said
        assert "Traceback" not in said
        assert controller.position() < STROKE / 2
        assert controller._motion is None
        assert cell.read_text() == before


def test_the_keys_of_its_json_are_documented(cell):
    told = json.loads(measured(cell, *tip_pictures(cell), "--force", "--json").stdout)
    keys = {f"pusher.{key}" for key in told["pusher"]} | {"findings", "files"}
    table = DOCS.read_text().split("\n`calibrate tip`:\n\n")[1].split("\n\n")[0]
    assert keys == {key for row in re.findall(r"^\| (`.*?`) \|", table, re.MULTILINE) for key in re.findall("`(.*?)`", row)}


def test_a_topic_without_frames_says_so(monkeypatch):
    monkeypatch.setattr(topic_frames.TopicFrames, "patience", 0.2)
    with (
        frames_from("topic", "/nobody") as source,
        pytest.raises(InvalidInput, match="no frames from /nobody/image_raw"),
    ):
        next(iter(source))
