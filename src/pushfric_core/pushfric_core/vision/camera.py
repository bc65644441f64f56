"""A calibrated camera over the table: its lens, and where table points appear in its image."""

import math
import os
import pathlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import yaml

from pushfric_core.errors import InvalidInput, blaming
from pushfric_core.files.disk import write_whole
from pushfric_core.files.yaml_files import yaml_content
from pushfric_core.geometry.planar import Array
from pushfric_core.vision import PIXEL_LIMIT

Image = npt.NDArray[np.uint8]
"""A mono8 image (height, width)."""

Loaded = TypeVar("Loaded")

DISTORTION_MODELS = ("plumb_bob", "rational_polynomial")
DISTORTION_COEFFICIENTS = (4, 5, 8)
_ZERO = np.zeros(3)


@dataclass(frozen=True, eq=False)
class Lens:
    """Lens and image size of one camera. Pixels are (u, v): u to the right, v down, (0, 0) the centre of the first pixel.

    Args:
        width, height: of the image [px].
        K: (3, 3) camera matrix [px].
        D: (4,), (5,) or (8,) distortion coefficients, in the order of OpenCV.
    Raises:
        ValueError: K or D has another shape.
        InvalidInput: values that no camera has, such as an infinite one, an image size of 0, or a focal length of 0.
    """

    width: int
    height: int
    K: Array
    D: Array

    def __post_init__(self) -> None:
        self._freeze("K", (3, 3))
        self._freeze("D", *((n,) for n in DISTORTION_COEFFICIENTS))
        if self.width < 1 or self.height < 1:
            raise InvalidInput(f"the image size must be positive, got {self.width} x {self.height}")
        if not (self.K[0, 0] > 0 and self.K[1, 1] > 0 and self.K[2, 2] == 1):
            raise InvalidInput(
                f"the camera is not calibrated: K must have focal lengths > 0 and 1 at its end, got {self.K.tolist()}"
            )

    def over(self, table_homography: npt.ArrayLike) -> "Camera":
        """The camera with this lens and a homography H (3, 3), as `Camera` takes it."""
        return Camera(self.width, self.height, self.K, self.D, np.asarray(table_homography, dtype=float))

    def info_fields(self) -> dict[str, Any]:
        """The fields of sensor_msgs/CameraInfo by name, for CameraInfo(header=..., **lens.info_fields())."""
        return {
            "width": self.width,
            "height": self.height,
            "distortion_model": DISTORTION_MODELS[len(self.D) == 8],
            "d": self.D.tolist(),
            "k": self.K.ravel().tolist(),
            "r": np.eye(3).ravel().tolist(),
            "p": np.column_stack((self.K, np.zeros(3))).ravel().tolist(),
        }

    def _freeze(self, name: str, *shapes: tuple[int, ...]) -> None:
        """Make a field a read-only array of one of these shapes."""
        array = np.array(getattr(self, name), dtype=float)
        if array.shape not in shapes:
            raise ValueError(f"{name} must have shape {' or '.join(map(str, shapes))}, got {array.shape}")
        if not np.isfinite(array).all():
            raise InvalidInput(f"{name} must be finite, got {array.tolist()}")
        array.setflags(write=False)
        object.__setattr__(self, name, array)


def check_size(frame: Image, lens: Lens, source: str) -> None:
    """Raise InvalidInput, naming the source, if a frame (height, width) has another size than the lens's."""
    if frame.shape != (lens.height, lens.width):
        got = f"{frame.shape[1]} x {frame.shape[0]}"
        raise InvalidInput(f"{source}: the lens is calibrated for {lens.width} x {lens.height} px, the image has {got}")


@dataclass(frozen=True, eq=False)
class Camera(Lens):
    """Lens and table of one camera.

    Args:
        H: (3, 3) homography from the table plane z = 0 [m] to undistorted pixels, of any scale.
        width, height, K, D: as for `Lens`.
    Raises:
        ValueError: H has another shape.
        InvalidInput: H is degenerate, or belongs to a camera below the table.
    """

    H: Array

    def __post_init__(self) -> None:
        super().__post_init__()
        self._freeze("H", (3, 3))
        # the z axis of the table points to the camera's side
        if self._axes[2] @ self._axes[3] >= 0:
            raise InvalidInput(
                "the table homography is mirrored: seen by the camera, y must be 90 degrees counter-clockwise from x"
            )

    @classmethod
    def looking_down(
        cls,
        width: int,
        height: int,
        center: tuple[float, float],
        metres_per_pixel: float,
        distance: float = 0.8,
        distortion: Sequence[float] = (0.0,) * 5,
    ) -> "Camera":
        """A camera straight above `center` (x, y) [m] at `distance` [m], with image x along table x and image y along -y."""
        u, v, focal = (width - 1) / 2, (height - 1) / 2, distance / metres_per_pixel
        K = np.array(((focal, 0.0, u), (0.0, focal, v), (0.0, 0.0, 1.0)))
        x, y = center
        return cls(width, height, K, np.array(distortion), K @ ((1.0, 0.0, -x), (0.0, -1.0, y), (0.0, 0.0, distance)))

    def project(self, points: npt.ArrayLike, height: float = 0.0) -> Array:
        """Distorted pixels (n, 2) of table points (n, 2) [m] at `height` [m] over the table."""
        plane = self._plane(height)
        import cv2  # not above: a process that only writes a calibration, such as the demo, saves its 13 MB

        pixels, _ = cv2.projectPoints(np.asarray(points, dtype=float) @ plane[:2] + plane[2], _ZERO, _ZERO, self.K, self.D)
        return np.asarray(pixels.reshape(-1, 2))

    def unproject(self, pixels: npt.ArrayLike, height: float = 0.0) -> Array:
        """Table points (n, 2) [m] at `height` [m] over the table that appear at distorted pixels (n, 2)."""
        seen = np.asarray(pixels, dtype=float).reshape(-1, 1, 2)
        import cv2

        enough = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10)
        rays = cv2.undistortPoints(seen, self.K, self.D, criteria=enough)
        return np.asarray(cv2.perspectiveTransform(rays, np.linalg.inv(self._plane(height).T)).reshape(-1, 2))

    def lifted(self, points: npt.ArrayLike, height: float) -> Array:
        """The points (n, 2) [m] at `height` [m] over the table that hide the table points (n, 2) [m] from the camera."""
        return self.unproject(self.project(points), height)

    def metres_per_pixel(self, height: float = 0.0) -> float:
        """Size [m] of the middle pixel on the plane at `height` [m]: the square root of the area that it covers."""
        u, v = self.width / 2, self.height / 2
        a, b, c = self.unproject(((u, v), (u + 1, v), (u, v + 1)), height)
        return math.sqrt(abs(np.linalg.det((b - a, c - a))))

    def pose(self) -> tuple[Array, Array]:
        """Position (3,) [m] and orientation of the camera in the table frame.

        The orientation is a unit quaternion (4,) x, y, z, w; the camera's axes are those of REP 103: z along the line of sight,
        x to the right and y down in the image.
        """
        import cv2

        x_axis, y_axis, z_axis, origin = self._axes
        # the axes of a measured homography are only nearly orthogonal: take the nearest rotation
        u, _, vt = np.linalg.svd(np.array((x_axis, y_axis, z_axis / np.linalg.norm(z_axis))))
        to_table = u @ vt
        turn, _ = cv2.Rodrigues(to_table)
        angle = float(np.linalg.norm(turn))
        axis = turn.ravel() / angle if angle else turn.ravel()
        return -to_table @ origin, np.array((*(axis * math.sin(angle / 2)), math.cos(angle / 2)))

    def _plane(self, height: float) -> Array:
        """The plane z = `height` [m] in the camera frame, as rows (3, 3): x axis, y axis, origin."""
        x_axis, y_axis, z_axis, origin = self._axes
        return np.array((x_axis, y_axis, origin + height * z_axis))

    @cached_property
    def _axes(self) -> Array:
        """Unit axes x, y, z of the table and its origin [m] in the camera frame, as rows (4, 3)."""
        x_axis, y_axis, origin = np.linalg.solve(self.K, self.H).T
        scale = (np.linalg.norm(x_axis) + np.linalg.norm(y_axis)) / 2
        # 0 if the camera sees the table edge-on
        tilt = np.linalg.det((x_axis, y_axis, origin))
        if not abs(tilt) > 1e-6 * scale**2 * np.linalg.norm(origin):
            raise InvalidInput(f"the table homography is degenerate: {self.H.tolist()}")
        middle = np.linalg.solve(self.K, (self.width / 2, self.height / 2, 1.0))
        # The sign of H is free; the table lies in front of the camera.
        depth = tilt / (np.cross(x_axis, y_axis) @ middle)
        x_axis, y_axis, origin = (np.sign(depth) / scale) * np.array((x_axis, y_axis, origin))
        return np.array((x_axis, y_axis, np.cross(x_axis, y_axis), origin))


def load_lens(path: str | pathlib.Path) -> Lens:
    """Read a lens from the YAML that camera_calibration writes.

    Raises:
        InvalidInput: the file cannot be read, lacks a field, or describes no calibrated camera; the text names file and field.
    """
    return _loaded(path, _lens)


def load_camera(path: str | pathlib.Path) -> Camera:
    """Read a camera from the YAML of its lens, extended by `table_homography` (rows, cols, data).

    Raises:
        InvalidInput: as for `load_lens`.
    """
    return _loaded(path, lambda fields: _lens(fields).over(np.reshape(_matrix(fields, "table_homography", 9), (3, 3))))


def table_fields(camera: Camera) -> dict[str, Any]:
    """The fields of a camera's file that are not those of its lens."""
    return {"table_homography": {"rows": 3, "cols": 3, "data": camera.H.ravel().tolist()}}


def save_camera(camera: Lens, path: str | pathlib.Path) -> None:
    """Write a lens or a camera so that `load_lens` or `load_camera` reads it; camera_info_manager reads the lens of either.

    Raises:
        InvalidInput: the file cannot be written.
    """
    info = camera.info_fields()
    fields = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": "camera",
        "camera_matrix": {"rows": 3, "cols": 3, "data": info["k"]},
        "distortion_model": info["distortion_model"],
        "distortion_coefficients": {"rows": 1, "cols": len(info["d"]), "data": info["d"]},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": info["r"]},
        "projection_matrix": {"rows": 3, "cols": 4, "data": info["p"]},
    }
    if isinstance(camera, Camera):
        fields |= table_fields(camera)
    write_whole(pathlib.Path(path), yaml.safe_dump(fields, sort_keys=False, default_flow_style=None))


def picture_from(data: npt.NDArray[np.uint8], format_: str) -> Image:
    """The grey levels (height, width) of a compressed picture.

    Args:
        data: its bytes.
        format_: the format that its sender gives, for the error.
    Raises:
        ValueError: the data are not a picture, or one of more than `PIXEL_LIMIT` pixels.
    """
    import cv2

    try:
        image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if len(data) else None
    except cv2.error as error:
        what = f"{len(data)} bytes of format {format_[:80]!r}"
        raise ValueError(f"not a picture of at most {PIXEL_LIMIT} pixels: {what}") from error
    if image is None:
        raise ValueError(f"not a picture: {len(data)} bytes of format {format_[:80]!r}")
    return np.asarray(image)


def _loaded(path: str | pathlib.Path, read: Callable[[dict[str, Any]], Loaded]) -> Loaded:
    path = pathlib.Path(path)
    if not os.path.exists(path):
        raise InvalidInput(f"{path}: no such file; ./pushfric calibrate makes it, and docs/tutorial.md has one for simulations")
    fields = yaml_content(path)
    if not isinstance(fields, dict):
        raise InvalidInput(f"{path}: expected a camera YAML with image_width, camera_matrix, ..., got {type(fields).__name__}")
    with blaming(path, InvalidInput, ValueError):
        return read(fields)


def _lens(fields: dict[str, Any]) -> Lens:
    """The lens of a camera YAML."""
    width, height = (_integer(fields, key) for key in ("image_width", "image_height"))
    k, model = _matrix(fields, "camera_matrix", 9), str(fields.get("distortion_model"))
    d = _matrix(fields, "distortion_coefficients", *DISTORTION_COEFFICIENTS)
    if not any(k):
        raise InvalidInput("the camera is not calibrated: K is all zero")
    if model not in DISTORTION_MODELS:
        raise InvalidInput(f"distortion model must be {' or '.join(DISTORTION_MODELS)}, got {model!r}")
    return Lens(width, height, np.reshape(k, (3, 3)), np.array(d))


def _integer(fields: dict[str, Any], key: str) -> int:
    value = fields.get(key)
    if not isinstance(value, int):
        raise InvalidInput(f"{key} must be an integer, got {value!r}")
    return value


def _matrix(fields: dict[str, Any], key: str, *lengths: int) -> list[float]:
    entry = fields.get(key)
    data = entry.get("data") if isinstance(entry, dict) else None
    if not isinstance(data, list) or len(data) not in lengths or not all(isinstance(value, int | float) for value in data):
        raise InvalidInput(f"{key} must hold `data`, a list of {' or '.join(map(str, lengths))} numbers, got {entry!r}")
    return data
