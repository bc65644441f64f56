"""An object that is drawn in a browser: what becomes of its file, and where a picture lies under it; without a browser."""

import json
import math

import numpy as np
import pytest
import yaml

from pushfric_core import InvalidInput, Outline, Pose
from pushfric_core.files.object_file import load_object
from pushfric_core.page.drawn_object import DrawnObject
from pushfric_core.simulated.camera import SimulatedCamera
from pushfric_core.vision.camera import Camera

OUTLINE = [[-0.06, -0.04], [0.06, -0.04], [0.06, 0.04], [-0.06, 0.04]]
FILE = f"""\
name: plate  # of steel
outline: {OUTLINE}
support:
  grid: [7, 5]
height: 0.02
"""
CAMERA = Camera.looking_down(640, 480, (0.2, 0.15), 0.0006, distortion=(-0.1, 0.02, 0.0, 0.0, 0.0))


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "object.yaml"
    path.write_text(FILE, newline="\r\n")
    return path


def drawing(outline=OUTLINE, **support):
    return json.dumps({"outline": outline, "support": support or {"grid": [7, 5]}, "picture": [0, 0, 0]}).encode()


@pytest.mark.parametrize("shown", [[[-0.07, -0.04], *OUTLINE[1:]], OUTLINE])
def test_only_what_is_drawn_changes_in_the_file(file, shown):
    drawn = DrawnObject(file)
    assert drawn.model.support_points.shape == (35, 2)
    drawn.take(drawing(shown, points=[[-0.05, 0.0], [0.05, 0.012345678]]))
    assert file.read_text() == FILE
    # by another hand, while the page is open
    file.write_text(FILE.replace("steel", "brass").replace("-0.06, -0.04", "-0.05, -0.03"), newline="\r\n")
    assert str(file) in drawn.save()
    assert file.read_bytes().count(b"\r\n") == len(FILE.splitlines())
    assert "# of brass" in file.read_text()
    model = load_object(str(file))
    assert (model.name, model.height) == ("plate", 0.02)
    np.testing.assert_array_equal(model.outline.vertices, shown)
    np.testing.assert_array_equal(model.support_points, [[-0.05, 0.0], [0.05, 0.01235]])
    assert [one.name for one in file.parent.iterdir()] == ["object.yaml"]


def test_a_new_file_is_written_when_there_is_an_object(tmp_path):
    drawn = DrawnObject(tmp_path / "block.yaml", width=0.4)
    assert drawn.figures()["region"] == pytest.approx({"left": -0.2, "bottom": -0.15, "width": 0.4, "height": 0.3})
    with pytest.raises(InvalidInput, match="there is no picture"):
        drawn.picture()
    with pytest.raises(InvalidInput, match=r"^outline: expected a list of at least 3, got \[\]$"):
        drawn.save()
    drawn.take(drawing(grid=[4, 3]))
    drawn.save()
    content = yaml.safe_load((tmp_path / "block.yaml").read_text())
    assert content == {"name": "block", "outline": OUTLINE, "support": {"grid": [4, 3]}}


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        (drawing([OUTLINE[0], OUTLINE[2], OUTLINE[1], OUTLINE[3]]), "the outline must be a simple polygon with an area: Self-"),
        (drawing(OUTLINE[:2]), "outline: expected a list of at least 3, got "),
        (drawing([]), "outline: expected a list of at least 3, got "),
        (drawing(points=[]), "support.points: expected a list of at least 1, got "),
        (drawing(points=[[0.5, 0.0]]), "support points must lie within 0.12 m of the outline, got (0.5, 0) m"),
        (drawing(grid=[0, 3]), "a grid needs at least 1 column and 1 row, got 0 x 3"),
    ],
)
def test_what_is_no_object_is_not_saved(file, body, problem):
    drawn = DrawnObject(file)
    drawn.take(body)
    assert drawn.problem.startswith(problem)
    assert "\n" not in drawn.problem
    with pytest.raises(InvalidInput):
        drawn.save()
    assert file.read_text() == FILE


def photograph(pose):
    """The plate on the table, as the camera sees its top face."""
    return SimulatedCamera(CAMERA, np.array(OUTLINE), 0.02, np.random.default_rng(0)).render(pose)


def lit(drawn, points):
    """Which points of the object frame [m] are bright in the picture as the page shows it."""
    region, shown = drawn.figures()["region"], drawn.picture()
    u = (np.array(points)[:, 0] - region["left"]) / region["width"] * shown.shape[1]
    v = (region["bottom"] + region["height"] - np.array(points)[:, 1]) / region["height"] * shown.shape[0]
    return (shown[v.astype(int), u.astype(int)] > 130).tolist()


def test_a_picture_lies_under_the_object_that_it_shows(file):
    drawn = DrawnObject(file, CAMERA)
    drawn.show(photograph(Pose(0.25, 0.12, math.radians(25))), "photo.png")
    inside, outside = 0.99 * np.array(OUTLINE), 1.01 * np.array(OUTLINE)
    assert lit(drawn, [*inside, *outside]) == [True] * 4 + [False] * 4


def test_a_picture_without_the_object_lies_in_the_middle(file):
    drawn = DrawnObject(file, CAMERA)
    drawn.show(np.full((480, 640), 50, np.uint8), "photo.png")
    region = drawn.figures()["region"]
    assert region["left"] == pytest.approx(-region["width"] / 2, abs=1e-3)
    assert region["bottom"] == pytest.approx(-region["height"] / 2, abs=1e-3)
    far = DrawnObject(file, Camera.looking_down(640, 480, (0.2, 0.15), 0.01))
    far.show(np.full((480, 640), 50, np.uint8), "photo.png")  # in it, the object is too small for the tracker
    assert far.figures()["has_picture"]
    with pytest.raises(InvalidInput, match=r"photo.png: the lens is calibrated for 640 x 480 px, the image has 64 x 48"):
        drawn.show(np.zeros((48, 64), np.uint8), "photo.png")


def test_the_outline_in_a_picture_is_the_first_proposal(tmp_path):
    drawn = DrawnObject(tmp_path / "block.yaml", CAMERA, height=0.02)
    drawn.show(photograph(Pose(0.25, 0.12, math.radians(25))), "photo.png")
    drawn.save()
    found = load_object(str(tmp_path / "block.yaml"))
    assert found.height == 0.02
    assert sorted(found.outline.lengths) == pytest.approx(sorted(Outline(OUTLINE).lengths), abs=0.3e-3)
    np.testing.assert_allclose(found.outline.vertices.mean(axis=0), 0.0, atol=0.1e-3)  # about its middle


def test_a_picture_that_shows_no_object_says_so(file):
    drawn = DrawnObject(file, CAMERA)
    with pytest.raises(InvalidInput, match="no outline was found: there is no picture"):
        drawn.take(json.dumps({"outline": OUTLINE, "find": True}).encode())
    drawn.show(np.full((480, 640), 50, np.uint8), "photo.png")
    with pytest.raises(InvalidInput, match="no outline was found: no object: nothing is brighter than the table"):
        drawn.take(json.dumps({"outline": OUTLINE, "find": True}).encode())


def test_an_outline_is_found_again_in_the_frame_of_the_file(file):
    file.write_text(FILE.replace("[0.06, -0.04], [0.06, 0.04]", "[0.0605, -0.04], [0.0605, 0.04]"))
    drawn = DrawnObject(file, CAMERA)
    drawn.show(photograph(Pose(0.25, 0.12, math.radians(25))), "photo.png")
    before = drawn.figures()["outline"]
    drawn.take(json.dumps({"outline": before, "find": True}).encode())
    np.testing.assert_allclose(drawn.figures()["outline"], OUTLINE, atol=0.3e-3)
