"""The doctor on real parts: a GRBL controller on a pseudo-terminal, video files and topics as camera, and wrong files."""

import json
import math
import os
import shutil
import tempfile
import time

import numpy as np
import pytest
import yaml
from sensor_msgs.msg import Image
from videos import save_video

from pushfric_core.cell.node_settings import CameraConfig, PlanConfig
from pushfric_core.commands import dependencies
from pushfric_core.files.object_file import load_object
from pushfric_core.geometry.planar import Pose
from pushfric_core.pushers import serial_checks
from pushfric_core.pushers.pusher import Limits, Mode, PusherConfig
from pushfric_core.pushers.serial_config import GrblConfig
from pushfric_core.settings import plain
from pushfric_core.simulated.camera import SimulatedCamera
from pushfric_core.simulated.grbl_firmware import SimulatedGrbl
from pushfric_core.vision.camera import Camera, save_camera
from pushfric_core.vision.frame_source import Frame
from pushfric_ros.commands import doctor
from pushfric_ros.commands.demo import demo_cell
from pushfric_ros.commands.doctor import Check, Grade, camera, machine
from pushfric_ros.commands.doctor.camera import check_calibration
from pushfric_ros.graph import supervisor
from pushfric_ros.messages.conversions import stamp_to_msg
from pushfric_ros.node_kit import network
from pushfric_ros.node_kit.qos import SENSOR_DATA

NAME = "rubber_rect4"
SECOND = 10**9
CAMERA = Camera.looking_down(320, 240, (0.0, 0.06), 0.001)
SHARP = Camera.looking_down(640, 480, (0.0, 0.06), 0.0004)
OK, WARNING, FAILED = Grade.OK, Grade.WARNING, Grade.FAILED


class Listening(SimulatedGrbl):
    """Remembers the lines that it was sent."""

    def __init__(self, *arguments, **options) -> None:
        self.heard: list[str] = []
        super().__init__(*arguments, **options)

    def _system(self, line):
        self.heard.append(line)
        super()._system(line)

    def _gcode(self, line, jog=False):
        self.heard.append(line)
        return super()._gcode(line, jog)


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """Allow for a machine that is busy with other tests."""
    monkeypatch.setattr(machine, "ANSWER_TIMEOUT", 60.0)
    monkeypatch.setattr(camera, "FRAME_TIMEOUT", 60.0)


def pusher(**changes) -> PusherConfig:
    values = {"line_origin": (0.0, 0.0), "line_direction": (0.0, 1.0), "tip_radius": 0.003, "stroke": 0.06, "max_speed": 0.1}
    return PusherConfig(**{**values, **changes})


def cell_file(folder, port, **pushers):
    """A cell of a camera whose pictures come from a video file."""
    simulation = SimulatedCamera(SHARP, load_object(NAME).outline.vertices, 0.0, np.random.default_rng(0))
    save_video(folder / "camera.avi", [simulation.render(Pose(0.02, 0.05, 0.3)) for _ in range(25)], rate=30)
    save_camera(SHARP, folder / "camera.yaml")
    content = {
        "object": NAME,
        "camera": {"source": str(folder / "camera.avi"), "calibration": "camera.yaml"},
        "pusher": plain(pusher(**pushers)) | {"port": str(port)},
    }
    (folder / "cell.yaml").write_text(yaml.safe_dump(content))
    return folder / "cell.yaml"


def examined(path, folder):
    checks = list(doctor.examine(path, folder / "runs", lambda _: None))
    assert len({check.name for check in checks}) == len(checks)
    assert all(check.advice or check.level is OK for check in checks)
    return {check.name: check for check in checks}


def test_a_good_cell_passes_and_its_pusher_is_told_nothing_that_moves_it(tmp_path):
    with Listening(time.monotonic, homing=True) as controller:
        checks = examined(cell_file(tmp_path, controller.port, home=True), tmp_path)
        assert controller.position() == 0
    # these rest on this machine; a busy one reads too few frames a second
    assert {name for name, check in checks.items() if check.level is not OK} <= {"ROS 2", "clock", "priority", "disk", "camera"}
    assert list(checks) == [
        "ROS 2", "packages", "build", "clock", "priority", "disk", "discovery", "multicast",
        "cell", "plan", "camera", "exposure", "calibration", "object", "port", "controller", "limits",
    ]  # fmt: skip
    assert set(controller.heard) == {"$I", "$$", "$#", "$G"}  # neither unlocked nor homed
    assert checks["controller"].finding.startswith("Grbl 1.1h.20190830 at ")
    assert checks["controller"].finding.endswith(", alarm")
    assert checks["camera"].finding.startswith(f"{tmp_path}/camera.avi: 640 x 480 px, ")
    assert checks["calibration"].finding == "a pixel is 0.40 mm, 100 % of the pushing line are in the picture"
    assert checks["object"].finding.startswith("rubber_rect4 is seen at (20, 50) mm, edges fit to 0.")
    assert checks["object"].finding.endswith("only with markers, the tracker would notice a mirrored picture")
    assert checks["limits"].finding == "travel 99 mm, 100 mm/s, 500 mm/s^2"  # 100 mm, less the pull-off of homing
    assert doctor.passed(list(checks.values()))


def test_a_cell_without_its_parts_says_so_of_each(tmp_path):
    path = cell_file(tmp_path, "/dev/pushfric-none")
    (tmp_path / "camera.avi").unlink()
    (tmp_path / "camera.yaml").write_text("image_width: 640\n")
    checks = examined(path, tmp_path)
    assert {name for name, check in checks.items() if check.level is FAILED} == {"camera", "calibration", "port"}
    assert checks["camera"].finding.startswith(f"no camera at '{tmp_path}/camera.avi'")
    assert "image_height must be an integer" in checks["calibration"].finding
    assert checks["port"].finding == "no serial port at /dev/pushfric-none"
    assert "/dev/serial/by-id" in checks["port"].advice
    assert not {"controller", "limits", "exposure", "object"} & set(checks)
    assert not doctor.passed(list(checks.values()))


@pytest.fixture
def machine_is_well(monkeypatch):
    """Leave out the checks of the machine."""
    monkeypatch.setattr(machine, "CHECKS", ())
    for name in ("discovery", "multicast"):
        monkeypatch.setattr(machine, f"check_{name}", lambda name=name: Check(name, OK, ""))


@pytest.mark.usefixtures("machine_is_well")
def test_the_lock_of_the_cell_is_given_back(tmp_path, monkeypatch):
    path = cell_file(tmp_path, "/dev/pushfric-none")
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    assert examined(path, tmp_path)["cell"].level is OK
    assert list((tmp_path / "temporary").iterdir()) == []


@pytest.mark.parametrize(("level", "code"), [(WARNING, 0), (FAILED, 1)])
def test_the_exit_code_says_whether_a_check_failed(monkeypatch, call, level, code):
    monkeypatch.setattr(doctor, "examine", lambda *_: [Check("port", level, "as it is")])
    said = call("doctor", "--json")
    assert said.returncode == code
    assert json.loads(said.stdout)["passed"] is (code == 0)


def test_a_path_is_not_broken_where_nobody_sees_the_table(monkeypatch, call):
    path = f"/{100 * 'a'}/camera.yaml"
    monkeypatch.setattr(doctor, "examine", lambda *_: [Check("port", OK, "as it is", path)])
    assert path in call("doctor").stdout


@pytest.mark.usefixtures("machine_is_well")
def test_the_parts_of_a_running_cell_are_left_alone(tmp_path):
    with SimulatedGrbl(time.monotonic) as controller, supervisor.lock("/cell"):
        checks = examined(cell_file(tmp_path, controller.port), tmp_path)
    assert "a cell named /cell is already running" in checks["cell"].finding
    assert list(checks)[-1] == "cell"


# The machine


def test_the_environment_of_these_tests_is_the_one_that_was_tried():
    assert machine.check_ros().level is OK
    assert machine.check_packages().level is OK
    assert machine.check_build().level is OK


def test_missing_and_old_packages_are_named(monkeypatch):
    wanted = {"pushfric_core": ["numpy>=999"], "pushfric_ros": ["no-such-package>=1.2", "mcap>=1.0"]}
    monkeypatch.setattr(dependencies.importlib.metadata, "requires", wanted.get)
    check = machine.check_packages()
    assert check.finding == f"missing or too old: no-such-package>=1.2 (not installed), numpy>=999 ({np.__version__})"
    assert check.advice == "python3 -m pip install 'no-such-package>=1.2' 'numpy>=999'"


@pytest.mark.parametrize(
    ("file", "text", "stale"),
    [
        ("msg/Hypothesis.msg", "string name # whose\nfloat64 fit_error\nfloat64 ratio\nbool feasible\n", []),
        ("msg/Hypothesis.msg", "string name\nfloat64 fit_error\nbool feasible\n", ["Hypothesis.msg"]),
        ("msg/NeverBuilt.msg", "float64 x\n", ["NeverBuilt.msg"]),
        ("srv/SelectObject.srv", "string object\n---\nbool success\nstring message\n", []),
        ("srv/SelectObject.srv", "string object\n---\nbool success\n", ["SelectObject.srv"]),
    ],
)
def test_an_interface_whose_fields_changed_is_stale(tmp_path, file, text, stale):
    (tmp_path / file).parent.mkdir()
    (tmp_path / file).write_text(text)
    assert machine.stale_interfaces(tmp_path) == stale


@pytest.mark.parametrize(("state", "level"), [(0, OK), (machine.TIME_ERROR, WARNING)])
def test_a_clock_that_nothing_synchronises_is_a_warning(monkeypatch, state, level):
    assert machine.clock_state() in range(6)
    monkeypatch.setattr(machine, "clock_state", lambda: state)
    assert machine.check_clock().level is level


@pytest.mark.parametrize(("free", "level"), [(5e9, OK), (5e8, WARNING), (5e6, FAILED)])
def test_room_for_bags(monkeypatch, tmp_path, free, level):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(1e10, 1e10 - free, free))
    check = machine.check_disk(tmp_path / "not" / "there")
    assert check.level is level
    assert f"{free / 1e9:.1f} GB free at {tmp_path}" in check.finding


def test_without_discovery_no_other_process_answers(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")
    monkeypatch.setattr(machine, "ANSWER_TIMEOUT", 0.5)
    check = machine.check_discovery()
    assert check.level is FAILED
    assert check.finding.startswith("another process did not answer within 0.5 s on domain")
    assert "discovery range OFF" in check.finding


# The camera


def frames(images, period=0.05, age=0.01):
    arrivals = [1000 * SECOND + round(i * period * SECOND) for i in range(len(images))]
    return [Frame(arrival - round(age * SECOND), arrival, image) for arrival, image in zip(arrivals, images, strict=True)]


NOISE = [np.random.default_rng(i).integers(0, 200, (240, 320)).astype(np.uint8) for i in range(5)]


@pytest.mark.parametrize("domain", ["102", "-1", "seven"])
def test_domains_that_do_not_work_fail(monkeypatch, domain):
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    check = machine.check_discovery()
    assert (check.level, check.finding) == (FAILED, f"ROS_DOMAIN_ID is {domain!r}")


def test_multicast_matters_only_where_other_machines_are_looked_for(monkeypatch):
    assert machine.check_multicast().finding == "not needed: only this machine is looked for"
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE")
    monkeypatch.setattr(machine, "DDS_GROUP", "10.1.2.3")  # no multicast address
    check = machine.check_multicast()
    assert (check.level, check.finding.startswith("does not work: ")) == (WARNING, True)


@pytest.mark.parametrize(
    ("seen", "level", "finding"),
    [
        (frames(NOISE), OK, "image_raw: 320 x 240 px, 20.0 frames/s"),
        (frames(NOISE, period=0.2), WARNING, "image_raw: 320 x 240 px, 5.0 frames/s"),
        (frames(NOISE[:1]), WARNING, "image_raw: 320 x 240 px, nan frames/s"),
        (frames(NOISE[:1] * 5), FAILED, "image_raw: 320 x 240 px, 20.0 frames/s, all of them equal"),
        ([], FAILED, "no frames from image_raw"),
    ],
)
def test_a_camera_gives_living_frames_fast_enough(seen, level, finding):
    assert camera.check_camera(camera.Watched(seen), "topic")[1:3] == (level, finding)


def test_images_lost_on_the_way_need_memory_and_not_light():
    lossy = camera.check_camera(camera.Watched(frames(NOISE, period=0.2), lost=15, publishers=1), "topic")
    assert lossy[1:3] == (WARNING, "image_raw: 320 x 240 px, 5.0 frames/s; 75 % of the images are lost on the way")
    none = camera.check_camera(camera.Watched([], publishers=1), "topic")
    assert none[1:3] == (FAILED, "no frames from image_raw, though it has 1 publisher")
    assert all(f"_DEFAULT_PROFILES_FILE={network.IMAGES}" in check.advice for check in (lossy, none))


@pytest.mark.parametrize(
    ("table", "thing", "level", "advice"),
    [
        (20, 220, OK, ""),
        (20, 255, WARNING, "saturated areas look too large"),
        (16, 235, WARNING, "saturated areas look too large"),  # the luminance of video
        (230, 255, WARNING, "the table must be dark"),
        (5, 20, WARNING, "too dark to see an object"),
    ],
)
def test_exposure(table, thing, level, advice):
    image = np.full((240, 320), table, np.uint8)
    image[100:140, 100:160] = thing
    check = camera.check_exposure(image)
    assert (check.level, advice in check.advice) == (level, True)


def test_stamps_of_another_clock_or_out_of_order_fail():
    assert camera.check_stamps(frames(NOISE, age=0.08))[1:3] == (OK, "0.080 s old on arrival")
    early = "-3600.000 s old on arrival, so not by this machine's clock"
    assert camera.check_stamps(frames(NOISE, age=-3600.0))[1:3] == (FAILED, early)
    for age in (-0.02, 0.6, 5.0):
        assert camera.check_stamps(frames(NOISE, age=age)).level is FAILED
    slow = camera.check_stamps(frames(NOISE, age=0.3))
    assert (slow.level, "a push at 20 mm/s would be seen 6 mm behind" in slow.finding) == (WARNING, True)
    assert "not in order" in camera.check_stamps(frames(NOISE)[::-1]).finding


@pytest.mark.parametrize("encoding", ["mono8", "yuv422_yuy2"])
def test_frames_of_a_topic_are_judged_as_those_of_a_device(ros, encoding):
    node = ros.node("camera_driver", namespace="/cell")
    out = node.create_publisher(Image, "image_raw", SENSOR_DATA)
    image = iter(NOISE * 100)

    def send():
        pixels = next(image) if encoding == "mono8" else np.dstack((next(image), np.full((240, 320), 128, np.uint8)))
        msg = Image(height=240, width=320, encoding=encoding, step=pixels[0].nbytes, data=pixels.tobytes())
        msg.header.stamp = stamp_to_msg(time.time_ns() - 2 * SECOND)
        out.publish(msg)

    node.create_timer(0.02, send)
    seen = camera.watch(CameraConfig("camera.yaml", source="topic"), "/cell", None).frames
    assert len(seen) == camera.FRAMES
    assert all(any(np.array_equal(frame.image, sent) for sent in NOISE) for frame in seen)
    assert camera.check_stamps(seen).level is FAILED


@pytest.mark.parametrize(
    ("camera", "changes", "level", "finding"),
    [
        (SHARP, {}, OK, "a pixel is 0.40 mm, 100 % of the pushing line are in the picture"),
        (SHARP, {"line_origin": (0.0, 0.1258)}, OK, "a pixel is 0.40 mm, 50 % of the pushing line are in the picture"),
        (SHARP, {"line_origin": (5.0, 0.0)}, FAILED, "a pixel is 0.40 mm, 0 % of the pushing line are in the picture"),
        (CAMERA, {}, WARNING, "a pixel is 1.00 mm, 100 % of the pushing line are in the picture"),
        (
            Camera.looking_down(640, 480, (0.0, 0.06), 0.0005, distance=0.2, distortion=(-1.5, 0.0, 0.0, 0.0, 0.0)),
            {},
            FAILED,
            "the lens model fails in the corners of the picture",
        ),
    ],
)
def test_calibration_against_the_pushing_line_and_itself(camera, changes, level, finding):
    picture = np.zeros((camera.height, camera.width), np.uint8)
    assert check_calibration(camera, picture, pusher(**changes))[1:3] == (level, finding)


def test_a_calibration_of_another_size_fails():
    check = check_calibration(SHARP, np.zeros((240, 320), np.uint8), pusher())
    assert check[1:3] == (FAILED, "made for 640 x 480 px, the camera gives 320 x 240")


def test_an_object_that_is_not_seen_is_a_warning_with_numbers(tmp_path):
    check = camera.check_object(demo_cell(NAME, tmp_path), CAMERA, load_object(NAME), None)
    assert check.level is WARNING
    assert "not checked whether it is seen" in check.finding
    check = camera.check_object(demo_cell(NAME, tmp_path), CAMERA, load_object(NAME), np.full((240, 320), 40, np.uint8))
    seen = "expected about 127 x 64 px; the picture has grey levels of 40 (median) to 40"
    assert check[1:3] == (WARNING, f"rubber_rect4 is not seen now: no object; {seen}")
    assert "./pushfric edit" in check.advice


# The pusher


@pytest.mark.parametrize(("plan", "level"), [({}, OK), ({"plan": "none.yaml"}, FAILED)])
def test_a_plan_must_fit_the_object(plan, level):
    assert camera.check_plan(PlanConfig(**plan), load_object(NAME)).level is level


def test_a_port_without_permission_names_its_group(monkeypatch, tmp_path):
    (tmp_path / "port").touch()
    group = (tmp_path / "port").group()
    monkeypatch.setattr(os, "access", lambda *_: False)
    check = serial_checks.check_port(str(tmp_path / "port"))
    assert check.finding == f"no permission to use {tmp_path}/port"
    assert check.advice == f"sudo usermod -aG {group} $USER, then log in again"


@pytest.mark.parametrize(
    ("mode", "position", "home", "level"),
    [
        (Mode.IDLE, 0.0, False, OK),
        (Mode.IDLE, 0.05, False, OK),
        (Mode.IDLE, -0.01, False, WARNING),
        (Mode.IDLE, 0.07, False, WARNING),
        (Mode.IDLE, 0.07, True, OK),  # homing will tell where it is
        (Mode.ALARM, 0.0, True, OK),  # and ends an alarm
        (Mode.ALARM, 0.0, False, WARNING),
        (Mode.HOLD, 0.0, False, WARNING),
        (Mode.RUNNING, 0.0, True, FAILED),
    ],
)
def test_a_controller_must_be_at_rest_within_the_stroke(mode, position, home, level):
    assert serial_checks.judge(mode, position, "", pusher(home=home)).level is level


@pytest.mark.parametrize(
    ("limits", "axis", "level", "words"),
    [
        (Limits(0.06, 0.1, 0.5), "X", OK, "travel 60 mm, 100 mm/s, 500 mm/s^2"),
        (Limits(math.inf, 0.1, 0.5), "X", OK, "travel neither enforced nor known"),
        (Limits(0.05, 0.1, 0.5), "X", FAILED, "$130"),
        (Limits(0.05, 0.1, 0.5), "-Y", FAILED, "$131"),
        (Limits(0.06, 0.01, 0.5), "X", FAILED, "lower plan.speed, 20 mm/s, or raise $110"),
        (Limits(0.06, 0.05, 0.5), "Z", WARNING, "lower pusher.max_speed, 100 mm/s, or raise $112"),
        (Limits(0.06, 0.1, 0.01), "X", WARNING, "$120"),
    ],
)
def test_the_cell_must_stay_within_what_the_controller_is_set_to(limits, axis, level, words):
    check = serial_checks.check_limits(GrblConfig("none", axis=axis), pusher(), 0.05, 0.02, limits)
    assert check.level is level
    assert words in check.finding + check.advice
