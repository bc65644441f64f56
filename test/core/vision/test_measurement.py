"""Objects and tips measured in rendered pictures: how well they are found, and that wrong files are named."""

import math

import cv2
import numpy as np
import pytest

from pushfric_core.errors import InvalidInput
from pushfric_core.files.object_file import ObjectFile, make_object
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Pose, transform
from pushfric_core.pushers.pusher import StageConfig
from pushfric_core.report.measurement import object_findings, tip_findings
from pushfric_core.simulated.camera import SimulatedCamera
from pushfric_core.vision.camera import Camera
from pushfric_core.vision.outline_measurement import height_of, in_frame_of, measured_object, measured_place
from pushfric_core.vision.sighting import NotSeen
from pushfric_core.vision.tip_measurement import measure_tip

PIXEL = 0.0006
DISTORTED = (-0.2, 0.05, 0.001, -0.001, 0.0)
STRAIGHT = Camera.looking_down(640, 480, (0.1, 0.05), PIXEL, distortion=DISTORTED)
HALF_LENGTH, HALF_WIDTH = 0.0635, 0.032
SHAPES = {
    "rectangle": np.array(((-1, -1), (1, -1), (1, 1), (-1, 1))) * (HALF_LENGTH, HALF_WIDTH),
    "triangle": np.array(((0, 0), (0.1, 0), (0, 0.1))) - 0.03,
    "L": np.array(((0, 0), (0.1, 0), (0.1, 0.04), (0.04, 0.04), (0.04, 0.08), (0, 0.08))) - 0.02,
    "hexagon": 0.04 * np.array([(math.cos(a), math.sin(a)) for a in np.arange(6) * math.pi / 3]),
}


def from_the_side() -> Camera:
    eye, target = np.array((0.1, -0.25, 0.65)), np.array((0.1, 0.05, 0.0))
    ahead = (target - eye) / np.linalg.norm(target - eye)
    R = np.array(((1.0, 0.0, 0.0), np.cross(ahead, (1.0, 0.0, 0.0)), ahead))
    K = np.array(((1000.0, 0, 320), (0, 1000, 240), (0, 0, 1)))
    return Camera(640, 480, K, np.array(DISTORTED), K @ np.column_stack((R[:, 0], R[:, 1], -R @ eye)))


CAMERAS = {"straight": STRAIGHT, "from the side": from_the_side()}


def pictured(camera: Camera, vertices, height: float, seed: int, *poses: Pose):
    rendered = SimulatedCamera(camera, vertices, height, np.random.default_rng(seed))
    return [measured_place(camera, rendered.render(pose)) for pose in poses]


def file_of(vertices, height=0.0):
    corners = [tuple(corner) for corner in np.asarray(vertices).tolist()]
    return make_object(ObjectFile(name="thing", outline=corners, height=height), "thing.yaml")


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize("shape", SHAPES)
def test_outline_and_height_are_found(camera, shape):
    """Asked: outline to 0.3 mm, height to 1 mm."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        height, way, theta = rng.uniform(0.0, 0.03), rng.uniform(0, 2 * np.pi), rng.uniform(-np.pi, np.pi)
        first, moved = np.array((0.1, 0.05)), 0.12
        step = moved / 2 * np.array((math.cos(way), 0.5 * math.sin(way)))
        step *= moved / 2 / np.hypot(*step)
        step[1] = np.clip(step[1], -0.03, 0.03)
        moved = 2 * float(np.hypot(*step))
        places = pictured(camera, SHAPES[shape], height, seed, *(Pose(*(first + s * step), theta) for s in (-1, 1)))
        found = height_of(camera, places, moved)
        assert found == pytest.approx(height, abs=1e-3)
        measured = measured_object(camera, places, found)
        known = Outline(SHAPES[shape])
        same, larger = in_frame_of(measured.outline, known)
        assert larger == pytest.approx(1.0, abs=1.5e-3)
        assert np.hypot(*(same.vertices - known.vertices).T).max() < 0.3e-3
        assert measured.spread < 0.1e-3


def test_an_outline_that_is_too_large_in_the_file_is_named():
    (place,) = pictured(STRAIGHT, SHAPES["rectangle"], 0.012, 0, Pose(0.1, 0.05, 0.4))
    measured = measured_object(STRAIGHT, [place], 0.012)
    known = file_of(1.006 * SHAPES["rectangle"], 0.012)
    outline, height, findings = object_findings(STRAIGHT, [place], measured, 0.012, known, height_is_known=True)
    assert findings == ["the outline in the file is 0.6 % too large: 127.8 x 64.4 mm, measured 127.0 x 64.0 mm"]
    assert height == 0.012
    np.testing.assert_allclose(outline.vertices, SHAPES["rectangle"], atol=0.1e-3)  # in the file's frame


def test_a_forgotten_height_is_named():
    height = 0.0024
    places = pictured(STRAIGHT, SHAPES["triangle"], height, 1, *(Pose(0.1 + x, 0.05, 0.4) for x in (-0.06, 0.06)))
    found = height_of(STRAIGHT, places, 0.12)
    measured = measured_object(STRAIGHT, places, found)
    known = file_of(SHAPES["triangle"])
    *_, findings = object_findings(STRAIGHT, places, measured, found, known, height_is_known=True)
    (finding,) = findings
    assert finding.startswith("the height in the file is 0.0 mm, measured 2.")
    # without a known length, size and height cannot be told apart: both are named
    unknown = measured_object(STRAIGHT, places, 0.0)
    *_, findings = object_findings(STRAIGHT, places, unknown, 0.0, known, height_is_known=False)
    (finding,) = findings
    assert "0.3 % too small" in finding
    assert "; or the height is 2." in finding


def test_an_object_as_the_file_has_it_is_not_named():
    (place,) = pictured(STRAIGHT, SHAPES["L"], 0.01, 2, Pose(0.1, 0.05, 2.4))
    measured = measured_object(STRAIGHT, [place], 0.01)
    *_, findings = object_findings(STRAIGHT, [place], measured, 0.01, file_of(SHAPES["L"], 0.01), height_is_known=True)
    assert findings == []


def test_another_shape_is_named():
    (place,) = pictured(STRAIGHT, SHAPES["L"], 0.01, 2, Pose(0.1, 0.05, 2.4))
    measured = measured_object(STRAIGHT, [place], 0.01)
    *_, findings = object_findings(STRAIGHT, [place], measured, 0.01, file_of(SHAPES["triangle"]), height_is_known=True)
    assert findings == ["the file has another object: 3 corners, 100.0 x 100.0 mm; measured: 6 corners, 100.0 x 80.0 mm"]
    wrong = SHAPES["L"].copy()
    wrong[2] += (0.0, 0.004)
    *_, findings = object_findings(STRAIGHT, [place], measured, 0.01, file_of(wrong, 0.01), height_is_known=True)
    assert any(finding.startswith("corner 2 lies ") for finding in findings)


def test_a_round_object_becomes_a_polygon_that_follows_it():
    angles = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    disc = 0.04 * np.column_stack((np.cos(angles), np.sin(angles)))
    (place,) = pictured(STRAIGHT, disc, 0.01, 3, Pose(0.1, 0.05, 0.0))
    outline = measured_object(STRAIGHT, [place], 0.01).outline
    assert len(outline.vertices) >= 8
    assert outline.polygon.area == pytest.approx(math.pi * 0.04**2, rel=0.01)
    assert np.abs(np.hypot(*outline.vertices.T) - 0.04).max() < 2 * PIXEL


def test_an_object_that_was_turned_says_nothing_about_its_height():
    places = pictured(STRAIGHT, SHAPES["triangle"], 0.01, 0, Pose(0.05, 0.05, 0.0), Pose(0.15, 0.05, 0.1))
    with pytest.raises(InvalidInput, match=r"turned by 5\.7 degrees .*: slide it along a ruler"):
        height_of(STRAIGHT, places, 0.1)
    places = pictured(STRAIGHT, SHAPES["triangle"], 0.01, 0, Pose(0.05, 0.05, 0.0), Pose(0.15, 0.05, 0.0))
    with pytest.raises(InvalidInput, match=r"seems to have moved by 101\.3 mm, not 300\.0 mm"):
        height_of(STRAIGHT, places, 0.3)


@pytest.mark.parametrize(
    ("vertices", "pose", "reason"),
    [
        (SHAPES["rectangle"], Pose(5.0, 5.0, 0.0), "nothing is brighter"),
        (SHAPES["rectangle"], Pose(-0.09, 0.05, 0.0), "leaves the picture"),
        (0.01 * SHAPES["rectangle"], Pose(0.1, 0.05, 0.0), "specks"),
        (0.1 * SHAPES["rectangle"], Pose(0.1, 0.05, 0.0), "too small or thin|specks"),
    ],
)
def test_what_cannot_be_measured_says_why(vertices, pose, reason):
    with pytest.raises(NotSeen, match=reason):
        pictured(STRAIGHT, vertices, 0.0, 0, pose)


def test_whatever_is_bright_is_measured_or_refused_in_words():
    """Thin ellipses and scribbles in noise, whose corners must not be taken for an outline."""
    seen, refused = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        image = np.full((480, 640), 40, np.uint8)
        if seed % 2:  # a scribble
            line = (320, 240) + np.cumsum(rng.normal(0, 20, (8, 2)), axis=0)
            cv2.polylines(image, [np.rint(line).astype(np.int32)], True, 200, int(rng.integers(2, 10)), cv2.LINE_AA)
        else:
            size, angle = (int(rng.integers(20, 100)), int(rng.integers(1, 8))), rng.uniform(0, 180)
            cv2.ellipse(image, (320, 240), size, angle, 0, 360, 200, -1, cv2.LINE_AA)
        noise = rng.normal(0.0, 20.0, image.shape)
        image = np.clip(cv2.GaussianBlur(image, (0, 0), rng.uniform(0.3, 6.0)) + noise, 0, 255).astype(np.uint8)
        try:
            seen.append(measured_place(STRAIGHT, image))
        except NotSeen as reason:
            refused.append(str(reason))
    assert len(seen) > 10
    assert any("too thin or ragged" in reason for reason in refused)


def test_two_objects_are_not_taken_for_one():
    (first,) = pictured(STRAIGHT, SHAPES["rectangle"], 0.01, 0, Pose(0.05, 0.05, 0.2))
    (second,) = pictured(STRAIGHT, SHAPES["rectangle"] * (0.6, 1.3), 0.01, 1, Pose(0.15, 0.05, 0.2))
    with pytest.raises(InvalidInput, match=r"does not look the same everywhere: its corners are .* mm apart"):
        measured_object(STRAIGHT, [first, second], 0.01)


RADIUS, TOP = 0.004, 0.015
TIP = RADIUS * np.column_stack((np.cos(np.linspace(0, 2 * np.pi, 90)[:-1]), np.sin(np.linspace(0, 2 * np.pi, 90)[:-1])))
POSITIONS = np.linspace(0.0, 0.06, 13)


def rod(angle: float):
    """A round tip at the end of a rod, which points the other way."""
    half = RADIUS * np.array([(math.cos(a), math.sin(a)) for a in np.linspace(-np.pi / 2, np.pi / 2, 60)])
    return transform(Pose(0.0, 0.0, angle), np.vstack((half, ((-0.3, RADIUS), (-0.3, -RADIUS)))))


def strokes(camera, shape, origin, angle, seed, *, scale=1.0, height=TOP, tip=90, table=25):
    rng = np.random.default_rng(seed)
    rendered = SimulatedCamera(camera, shape, height, rng, foreground=tip, background=table)
    along = scale * np.array((math.cos(angle), math.sin(angle)))
    return [rendered.render(Pose(*(np.asarray(origin) + s * along), 0.0)) for s in POSITIONS]


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize(("kind", "tip", "table"), [("disc", 90, 25), ("rod", 90, 25), ("disc", 20, 120), ("rod", 60, 200)])
def test_the_tip_and_its_line_are_found(camera, kind, tip, table):
    """Asked: the line to 0.3 mm and 0.2 degrees."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        angle, origin = rng.uniform(-np.pi, np.pi), np.array((0.1, 0.05)) + rng.uniform(-0.02, 0.02, 2)
        shape = TIP if kind == "disc" else rod(angle)
        images = strokes(camera, shape, origin, angle, seed, tip=tip, table=table)
        found = measure_tip(camera, POSITIONS, images, 0.003)
        assert np.hypot(*(found.origin - origin)) < 0.3e-3
        assert abs(math.degrees(math.remainder(math.atan2(*found.direction[::-1]) - angle, 2 * np.pi))) < 0.2
        assert found.radius == pytest.approx(RADIUS, abs=0.15e-3)
        assert found.height == pytest.approx(TOP, abs=3e-3)
        assert found.scale == pytest.approx(1.0, abs=1e-6)


def test_wrong_entries_of_the_pusher_are_named():
    images = strokes(STRAIGHT, TIP, (0.08, 0.03), 0.5, 0)
    found = measure_tip(STRAIGHT, POSITIONS, images, 0.003)
    right = StageConfig((0.08, 0.03), (math.cos(0.5), math.sin(0.5)), RADIUS, 0.06, 0.1)
    assert tip_findings(found, right, height_is_given=False) == []
    wrong = StageConfig((0.081, 0.03), (math.cos(0.51), math.sin(0.51)), 0.003, 0.06, 0.1)
    findings = tip_findings(found, wrong, height_is_given=False)
    assert [finding.split()[0] for finding in findings] == ["line_origin", "line_direction", "tip_radius"]


def test_a_stroke_of_another_length_than_the_controller_says_is_named():
    images = strokes(STRAIGHT, TIP, (0.08, 0.03), 0.5, 0, scale=1.02)
    found = measure_tip(STRAIGHT, POSITIONS, images, 0.003, TOP)
    assert found.scale == pytest.approx(1.02, abs=2e-3)
    stage = StageConfig((0.08, 0.03), (math.cos(0.5), math.sin(0.5)), RADIUS, 0.06, 0.1)
    (finding,) = tip_findings(found, stage, height_is_given=True)
    assert finding == "the stroke is 2.0 % longer than the controller says: check its steps per millimetre"
    short = strokes(STRAIGHT, TIP, (0.08, 0.03), 0.5, 0, scale=0.9)
    with pytest.raises(InvalidInput, match=r"the stroke looks 8\.\d % shorter than the controller says"):
        measure_tip(STRAIGHT, POSITIONS, short, 0.003)


def test_what_is_no_tip_is_refused():
    still = strokes(STRAIGHT, TIP, (5.0, 5.0), 0.5, 0)
    with pytest.raises(InvalidInput, match="nothing is seen to move"):
        measure_tip(STRAIGHT, POSITIONS, still, 0.003)
    block = strokes(STRAIGHT, SHAPES["rectangle"], (0.08, 0.03), 0.0, 0)
    with pytest.raises(InvalidInput, match=r"not round|has a radius of"):
        measure_tip(STRAIGHT, POSITIONS, block, 0.003)
    with pytest.raises(InvalidInput, match="expected pictures of 4 or more stroke positions, ascending"):
        measure_tip(STRAIGHT, POSITIONS[::-1], still, 0.003)
