"""Outlines and tips measured in rendered pictures: how well they are found, and that wrong files are named."""

import math

import cv2
import numpy as np
import pytest

from pushfric_core import InvalidInput, Pose
from pushfric_core.geometry.planar import inverse, transform
from pushfric_core.simulated.camera import SimulatedCamera
from pushfric_core.vision.camera import Camera
from pushfric_core.vision.outline_measurement import measured_outline
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


def pictured(camera: Camera, vertices, height: float, seed: int, pose: Pose):
    """The corners as they are found, in the object frame."""
    picture = SimulatedCamera(camera, vertices, height, np.random.default_rng(seed)).render(pose)
    return transform(inverse(pose), measured_outline(camera, picture, height))


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize("shape", SHAPES)
def test_an_outline_is_found(camera, shape):
    """Asked: to 0.3 mm."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        pose = Pose(0.1 + rng.uniform(-0.03, 0.03), 0.05 + rng.uniform(-0.02, 0.02), rng.uniform(-np.pi, np.pi))
        found, known = pictured(camera, SHAPES[shape], rng.uniform(0.0, 0.03), seed, pose), SHAPES[shape]
        assert len(found) == len(known)
        off = np.hypot(*(found[:, None] - known).T).min(axis=1)
        assert off.max() < 0.3e-3


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
            seen.append(measured_outline(STRAIGHT, image, 0.0))
        except NotSeen as reason:
            refused.append(str(reason))
    assert len(seen) > 10
    assert any("too thin or ragged" in reason for reason in refused)


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
        assert np.hypot(*(found.line_origin - origin)) < 0.3e-3
        assert abs(math.degrees(math.remainder(math.atan2(*found.line_direction[::-1]) - angle, 2 * np.pi))) < 0.2
        assert found.tip_radius == pytest.approx(RADIUS, abs=0.15e-3)
        assert found.tip_height == pytest.approx(TOP, abs=3e-3)
        assert found.stroke_scale == pytest.approx(1.0, abs=1e-6)


def test_what_is_no_tip_is_refused():
    still = strokes(STRAIGHT, TIP, (5.0, 5.0), 0.5, 0)
    with pytest.raises(InvalidInput, match="nothing is seen to move"):
        measure_tip(STRAIGHT, POSITIONS, still, 0.003)
    block = strokes(STRAIGHT, SHAPES["rectangle"], (0.08, 0.03), 0.0, 0)
    with pytest.raises(InvalidInput, match=r"not round|has a radius of"):
        measure_tip(STRAIGHT, POSITIONS, block, 0.003)
    with pytest.raises(InvalidInput, match="expected pictures of 4 or more stroke positions, ascending"):
        measure_tip(STRAIGHT, POSITIONS[::-1], still, 0.003)
    for positions, radius in ((np.square(POSITIONS), 0.003), ([*POSITIONS[:11] / 3, 0.05, 0.06], 0.01), (POSITIONS, 0.0)):
        with pytest.raises(InvalidInput, match=r"of them \d+\.\d mm or more from the first; the tip's radius is"):
            measure_tip(STRAIGHT, positions, still, radius)
    images = strokes(STRAIGHT, TIP, (0.1, 0.05), 0.0, 0)
    with pytest.raises(InvalidInput, match="the front of what moves is not round"):  # a picture is there twice
        measure_tip(STRAIGHT, POSITIONS, [*images[:-2], images[0], images[-1]], 0.003)
    found, behind = (measure_tip(STRAIGHT, at, images, 0.003) for at in (POSITIONS, np.subtract(POSITIONS, POSITIONS[-1])))
    np.testing.assert_allclose(behind.line_origin - POSITIONS[-1] * behind.line_direction, found.line_origin, atol=1e-9)
