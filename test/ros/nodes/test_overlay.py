"""What is drawn over the camera's picture lies where the camera sees it."""

import numpy as np

from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Pose, transform
from pushfric_core.vision.camera import Camera
from pushfric_ros.nodes.tracker.pictures import GHOST, PLACED, SEEN, Overlay

CAMERA = Camera.looking_down(640, 480, (0.0, 0.0), 0.0005)
OUTLINE = Outline.rectangle(0.08, 0.04)
PLACE, FAR = Pose(0.05, 0.02, 0.3), Pose(-0.08, -0.05, 0.0)
HEIGHT = 0.01


def drawn() -> Overlay:
    return Overlay(np.full((480, 640), 90, np.uint8), CAMERA, OUTLINE, HEIGHT)


def share(picture: np.ndarray, colour: tuple[int, int, int], pose: Pose) -> float:
    """The share of the outline at a pose that has about this colour; lines are smoothed, and a pixel wide."""
    corners = transform(pose, OUTLINE.vertices)
    sides = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    points = np.concatenate([begin + np.linspace(0, 1, 60, endpoint=False)[:, None] * (end - begin) for begin, end in sides])
    pixels = np.rint(CAMERA.project(points, HEIGHT)).astype(int)
    near = [[picture[v + dv, u + du] for du in (-1, 0, 1) for dv in (-1, 0, 1)] for u, v in pixels]
    return float(np.mean(np.abs(np.array(near, int) - colour).max(axis=2).min(axis=1) < 60))


def test_the_object_is_outlined_where_it_is_seen():
    overlay = drawn()
    overlay.seen(FAR)
    assert share(overlay.picture, SEEN, FAR) > 0.9
    assert share(overlay.picture, SEEN, PLACE) == 0


def test_its_place_is_dashed_until_it_lies_there():
    overlay = drawn()
    overlay.ghost(PLACE, FAR, in_place=False)
    assert 0.3 < share(overlay.picture, GHOST, PLACE) < 0.9
    assert share(overlay.picture, PLACED, PLACE) == 0
    overlay = drawn()
    overlay.ghost(PLACE, PLACE, in_place=True)
    assert share(overlay.picture, PLACED, PLACE) > 0.9
    assert share(overlay.picture, GHOST, PLACE) == 0
