"""The camera against OpenCV's own projection, its files, and bad input."""

import dataclasses

import cv2
import numpy as np
import pytest
import yaml
from sensor_msgs.msg import CameraInfo

from pushfric_core.errors import InvalidInput
from pushfric_core.vision.camera import Camera, load_camera, load_lens, save_camera

K = np.array(((900.0, 0.0, 320.0), (0.0, 910.0, 238.0), (0.0, 0.0, 1.0)))
D = np.array((-0.2, 0.05, 0.001, -0.001, 0.0))

# as `camera_calibration` writes it, with the homography added
YAML = """\
image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [1280., 0., 319.5, 0., 1280., 239.5, 0., 0., 1.]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.1, 0.02, 0., 0., 0.]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]
projection_matrix:
  rows: 3
  cols: 4
  data: [1280., 0., 319.5, 0., 0., 1280., 239.5, 0., 0., 0., 1., 0.]
table_homography:
  rows: 3
  cols: 3
  data: [1600., 0., 319.5, 0., -1600., 239.5, 0., 0., 1.]
"""


def oblique_pose() -> tuple[np.ndarray, np.ndarray]:
    """Rotation and translation, table to camera, of a camera that looks at the table from the side."""
    eye = np.array((0.1, -0.3, 0.6))
    ahead = np.array((0.1, 0.05, 0.0)) - eye
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, (0, 0, 1))
    right /= np.linalg.norm(right)
    R = np.array((right, np.cross(ahead, right), ahead))
    return R, -R @ eye


def oblique() -> Camera:
    R, t = oblique_pose()
    return Camera(640, 480, K, D, K @ np.column_stack((R[:, 0], R[:, 1], t)))


def points(rng: np.random.Generator) -> np.ndarray:
    return np.array((0.1, 0.05)) + rng.uniform(-0.1, 0.1, (20, 2))


@pytest.mark.parametrize("height", [0.0, 0.05])
def test_projection_agrees_with_the_pose_of_the_camera(rng, height):
    R, t = oblique_pose()
    table = points(rng)
    solid = np.column_stack((table, np.full(len(table), height)))
    expected, _ = cv2.projectPoints(solid, cv2.Rodrigues(R)[0], t, K, D)
    np.testing.assert_allclose(oblique().project(table, height), expected.reshape(-1, 2), atol=1e-6)


@pytest.mark.parametrize("height", [0.0, 0.05])
def test_unprojection_undoes_projection(rng, height):
    table = points(rng)
    camera = oblique()
    np.testing.assert_allclose(camera.unproject(camera.project(table, height), height), table, atol=1e-9)


def test_reads_what_camera_calibration_writes(tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text(YAML)
    camera = load_camera(path)
    assert (camera.width, camera.height) == (640, 480)
    assert camera.K[0, 0] == 1280
    assert camera.D.tolist() == [-0.1, 0.02, 0, 0, 0]
    ((x, y),) = camera.unproject([(319.5, 239.5)])
    assert (x, y) == pytest.approx((0.0, 0.0), abs=1e-12)


def test_a_saved_camera_is_read_back(tmp_path):
    camera = oblique()
    save_camera(camera, tmp_path / "camera.yaml")
    same = load_camera(tmp_path / "camera.yaml")
    for name in ("width", "height", "K", "D", "H"):
        np.testing.assert_array_equal(getattr(same, name), getattr(camera, name))


def test_a_lens_without_a_table(tmp_path):
    path = tmp_path / "lens.yaml"
    path.write_text(YAML[: YAML.index("table_homography")])
    lens = load_lens(path)
    assert (lens.width, lens.height, lens.K[0, 0], lens.D[0]) == (640, 480, 1280, -0.1)
    with pytest.raises(InvalidInput, match="table_homography must hold"):
        load_camera(path)
    with pytest.raises(InvalidInput, match="aaa: no such file"):
        load_camera(tmp_path / ("a" * 300))
    save_camera(lens, tmp_path / "same.yaml")
    assert "table_homography" not in yaml.safe_load((tmp_path / "same.yaml").read_text())
    np.testing.assert_array_equal(load_lens(tmp_path / "same.yaml").K, lens.K)
    np.testing.assert_array_equal(lens.over(oblique().H).H, oblique().H)


@pytest.mark.parametrize("load", [load_lens, load_camera])
def test_a_calibration_that_is_missing_is_named_with_the_command_that_makes_it(load, tmp_path):
    with pytest.raises(InvalidInput, match=r"camera\.yaml: no such file; \./pushfric calibrate makes it"):
        load(tmp_path / "camera.yaml")


@pytest.mark.parametrize(("distortion", "model"), [(D, "plumb_bob"), (np.arange(8) / 100, "rational_polynomial")])
def test_camera_info_has_the_lens(distortion, model):
    camera = dataclasses.replace(oblique(), D=distortion)
    info = CameraInfo(**camera.info_fields())
    assert (info.width, info.height, info.distortion_model) == (camera.width, camera.height, model)
    np.testing.assert_array_equal(info.k, camera.K.ravel())
    np.testing.assert_array_equal(info.d, camera.D)


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"K": np.zeros((3, 3))}, "not calibrated: K must have focal lengths > 0"),
        ({"width": 0}, "image size must be positive, got 0 x 480"),
        ({"H": np.diag((1.0, 1.0, 0.0))}, "table homography is degenerate"),
        ({"H": np.array(((1600.0, 0, 320), (0, 1600, 240), (0, 0, 1)))}, "table homography is mirrored"),
    ],
)
def test_an_impossible_camera_is_refused(fields, text):
    with pytest.raises(InvalidInput, match=text):
        dataclasses.replace(oblique(), **fields)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("table_homography", "homography", "table_homography must hold `data`, a list of 9 numbers, got None"),
        ("[1280., 0., 319.5, 0., 1280., 239.5, 0., 0., 1.]", "[0, 0, 0, 0, 0, 0, 0, 0, 0]", "not calibrated: K is all zero"),
        ("[-0.1, 0.02, 0., 0., 0.]", "[a, b, c, d]", "distortion_coefficients must hold `data`, a list of 4 or 5 or 8 numbers"),
        ("plumb_bob", "equidistant", "distortion model must be"),
        (YAML, "just text", "expected a camera YAML with image_width, camera_matrix, ..., got str"),
    ],
)
def test_a_bad_file_is_refused_by_name_and_field(tmp_path, old, new, text):
    path = tmp_path / "camera.yaml"
    path.write_text(YAML.replace(old, new))
    with pytest.raises(InvalidInput, match=text) as raised:
        load_camera(path)
    assert str(raised.value).startswith(f"{path}: ")
