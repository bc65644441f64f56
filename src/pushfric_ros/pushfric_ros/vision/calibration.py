"""Calibrates a camera: its lens from views of a printed board, its table from the board lying on it or from measured points."""

import pathlib
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from pushfric_core.errors import InvalidInput
from pushfric_core.planar import Array
from pushfric_ros.files.csv_table import read_table
from pushfric_ros.vision.board import Board, BoardFinder, View, moved
from pushfric_ros.vision.camera import Camera, Image, Lens
from pushfric_ros.vision.frame_source import Device

MIN_VIEWS = 8
"""Number of different views that a lens calibration needs."""
MIN_TILT = 20.0
"""The tilt of the board must vary by this much over the views, about the image's u axis and about its v axis [degree]."""
MAX_FOCAL_ERROR = 0.005
"""The focal length must be known at least this well (1 sigma, relative)."""
MAX_LENS_RMS_PX = 1.0
MAX_TABLE_RMS_PX = 5.0
"""Larger reprojection errors (rms) mean that the input is wrong."""
MAX_LEVERAGE = 4.0
"""An error of 1 px (1 sigma) in the points on the table may grow to this at the image's corners [px]."""
NOVEL = 0.04
"""A new view must differ from every earlier one by at least this fraction of the image's width."""
STILL_PX = 1.0
"""From one frame to the next, the corners of a board at rest move at most this far on average."""

_REGIONS = tuple(f"{row} {column}".strip() for row in ("upper", "middle", "lower") for column in ("left", "centre", "right"))


class LensCalibration(NamedTuple):
    """A lens, and how well it explains the views."""

    lens: Lens
    rms_px: float  # reprojection error over all views
    view_rms_px: Array  # (n,) reprojection error of each view
    focal_error: float  # of the focal length, 1 sigma, relative


class TableCalibration(NamedTuple):
    """A camera over its table, and how well it explains the points."""

    camera: Camera
    errors_px: Array  # (n,) reprojection errors
    errors: Array  # (n,) the same errors on the table [m]

    @property
    def rms_px(self) -> float:
        """Root mean square of the reprojection errors."""
        return _rms(self.errors_px)

    @property
    def rms(self) -> float:
        """Root mean square of the errors on the table [m]."""
        return _rms(self.errors)


def calibrate_lens(views: Sequence[View], width: int, height: int) -> LensCalibration:
    """The lens that explains views of a board.

    Args:
        views: at least `MIN_VIEWS` of one board, from different directions.
        width, height: of the images [px].
    Raises:
        InvalidInput: the views do not determine the lens; the text says what is missing.
    """
    if len(views) < MIN_VIEWS:
        raise InvalidInput(f"too few different views of the board: expected at least {MIN_VIEWS}, got {len(views)}")
    pixels = np.concatenate([view.pixels for view in views])
    cells = (pixels * (3 / width, 3 / height)).astype(int).clip(0, 2)
    seen = {row * 3 + column for column, row in cells.tolist()}
    if missing := [region for number, region in enumerate(_REGIONS) if number not in seen]:
        raise InvalidInput(f"the board was never seen in parts of the image: {', '.join(missing)}")
    try:
        rms, K, D, turns, _, deviations, _, view_rms = cv2.calibrateCameraExtended(
            [np.column_stack((view.points, np.zeros(len(view.points)))).astype(np.float32) for view in views],
            [view.pixels.astype(np.float32) for view in views],
            (width, height),
            None,
            None,
            flags=cv2.CALIB_FIX_K3,
        )
    except cv2.error as error:
        raise InvalidInput(f"no lens explains the views: {error.err}; the board must be tilted") from error
    normals = np.array([cv2.Rodrigues(turn)[0][:, 2] for turn in turns])
    tilts = np.degrees(np.ptp(np.arcsin(normals[:, :2]), axis=0))
    for tilt, way in zip(tilts, ("left and right", "up and down"), strict=True):
        if tilt < MIN_TILT:
            raise InvalidInput(f"too little tilt {way}: {tilt:.0f} degrees between the views, expected at least {MIN_TILT:g}")
    focal_error = float(np.max(deviations.ravel()[:2] / (K[0, 0], K[1, 1])))
    if rms > MAX_LENS_RMS_PX:
        worst = int(np.argmax(view_rms)) + 1
        raise InvalidInput(
            f"reprojection error of {rms:.2f} px, worst in view {worst}: is the board flat, and are its squares the size given?"
        )
    if not focal_error < MAX_FOCAL_ERROR:
        raise InvalidInput(
            f"the focal length is known only to {focal_error:.1%}: add nearer views in which the board is tilted more"
        )
    return LensCalibration(Lens(width, height, K, D.ravel()[:5]), float(rms), view_rms.ravel(), focal_error)


def calibrate_table(lens: Lens, pixels: Array, points: Array) -> TableCalibration:
    """The table plane from points on it.

    Args:
        pixels: (n, 2) where the points appear in the image.
        points: (n, 2) where they lie, in the table frame [m].
    Raises:
        InvalidInput: the points do not determine the plane; the text says what is missing.
    """
    if len(np.unique(points, axis=0)) < 4:
        raise InvalidInput(f"too few different points: expected at least 4, got {len(np.unique(points, axis=0))}")
    solid, pixels = np.column_stack((points, np.zeros(len(points)))), np.ascontiguousarray(pixels, dtype=float)
    found, turns, shifts, _ = cv2.solvePnPGeneric(solid, pixels, lens.K, lens.D, flags=cv2.SOLVEPNP_IPPE)
    if not found or not np.isfinite((turns, shifts)).all():
        raise InvalidInput("the points lie on a line or in one place: expected points spread over the table")
    # from a distance, a plane tilted the other way looks nearly the same
    poses = [cv2.solvePnPRefineLM(solid, pixels, lens.K, lens.D, *pose) for pose in zip(turns, shifts, strict=True)]
    turn, shift = min(poses, key=lambda pose: _rms(_misses(lens, solid, pixels, *pose)))
    errors_px = _misses(lens, solid, pixels, turn, shift)
    R, _ = cv2.Rodrigues(turn)
    camera = lens.over(lens.K @ np.column_stack((R[:, :2], shift)))
    corners = np.array(((0, 0), (1, 0), (1, 1), (0, 1))) * (lens.width - 1, lens.height - 1)
    leverage = _leverage(camera, solid, camera.unproject(corners), turn, shift)
    if not leverage.max() < MAX_LEVERAGE:
        corner = ("upper left", "upper right", "lower right", "lower left")[int(np.argmax(leverage))]
        raise InvalidInput(
            f"the points are badly spread: an error of 1 px in them grows to {leverage.max():.0f} px in the image's {corner}; "
            "add points there"
        )
    errors = np.linalg.norm(camera.unproject(pixels) - points, axis=1)
    if _rms(errors_px) > MAX_TABLE_RMS_PX:
        worst = int(np.argmax(errors_px))
        raise InvalidInput(
            f"the points disagree by {_rms(errors_px):.1f} px ({1e3 * _rms(errors):.1f} mm); the worst is number {worst + 1}, "
            f"by {errors_px[worst]:.1f} px"
        )
    return TableCalibration(camera, errors_px, errors)


def lens_from_source(source: str, board: Board, progress: Callable[[str], None]) -> LensCalibration:
    """The lens that took the images of a source, which show the board.

    A camera is read until the views are enough; a video or a folder of pictures is read to its end.

    Args:
        source: as `Device` takes it.
        board: the board that the images show.
        progress: called with a line of text for each view; of a camera, the line also says what is still missing.
    Raises:
        InvalidInput: no such source, or its images are not enough; the text says what is missing.
    """
    finder, kept, frames = BoardFinder(board), list[View](), 0
    size: tuple[int, ...] = ()
    previous: View | None = None
    with _Frames(source) as device:
        for frame in device:
            frames += 1
            if size and frame.shape != size:
                raise InvalidInput(
                    f"{source}: pictures of different sizes: {size[1]} x {size[0]} and {frame.shape[1]} x {frame.shape[0]}"
                )
            size = frame.shape
            view = finder.view(frame)
            last, previous = previous, view
            if view is None or not all(moved(view, other) > NOVEL * size[1] for other in kept):
                continue
            if not device.pictures and (last is None or moved(view, last) > STILL_PX):
                continue
            kept.append(view)
            missing = ""
            if device.live:
                try:
                    return calibrate_lens(kept, size[1], size[0])
                except InvalidInput as error:
                    missing = f"; {error}"
            progress(f"view {len(kept)}: {len(view.ids)} corners{missing}")
    if not kept:
        raise InvalidInput(f"{source}: board not found in {frames} pictures")
    try:
        return calibrate_lens(kept, size[1], size[0])
    except InvalidInput as error:
        raise InvalidInput(f"{source}: {error}") from error


def table_from_source(source: str, board: Board, lens: Lens, progress: Callable[[str], None]) -> TableCalibration:
    """The table on which the board lies, from the first image that shows it; the board's frame becomes the table frame.

    Args:
        source: as `Device` takes it.
        board: the board that lies on the table.
        lens: of the camera.
        progress: called with a line of text while the board is not found.
    Raises:
        InvalidInput: no such source, images of another size than the lens's, or no board in them.
    """
    finder, frames = BoardFinder(board), 0
    with _Frames(source) as device:
        for frame in device:
            frames += 1
            if frame.shape != (lens.height, lens.width):
                got = f"{frame.shape[1]} x {frame.shape[0]}"
                raise InvalidInput(f"{source}: the lens is calibrated for {lens.width} x {lens.height} px, the image has {got}")
            view = finder.view(frame)
            if view is not None:
                return calibrate_table(lens, view.pixels, view.points)
            if frames == 1:
                progress("board not found yet")
    raise InvalidInput(f"{source}: board not found in {frames} pictures")


def read_table_points(path: pathlib.Path) -> tuple[Array, Array]:
    """Pixels (n, 2) and table points (n, 2) [m] from a CSV file with columns u,v,x,y.

    Raises:
        InvalidInput: the file cannot be read as such a table; the text names the file, the line, and what was expected there.
    """
    names = ("u", "v", "x", "y")
    table = np.array([row.numbers(names) for row in read_table(path, names, "points").rows])
    return table[:, :2], table[:, 2:]


def _misses(lens: Lens, solid: Array, pixels: Array, turn: Array, shift: Array) -> Array:
    projected, _ = cv2.projectPoints(solid, turn, shift, lens.K, lens.D)
    return np.asarray(np.linalg.norm(projected.reshape(-1, 2) - pixels, axis=1))


def _leverage(camera: Camera, solid: Array, corners: Array, turn: Array, shift: Array) -> Array:
    """How far an error of 1 px in the points moves each of the image's corners, given on the table (4, 2): (4,) [px]."""

    def slopes(places: Array) -> Array:
        """Derivatives of the pixels by the six parameters of the pose: (2 n, 6)."""
        return np.asarray(cv2.projectPoints(places, turn, shift, camera.K, camera.D)[1][:, :6])

    at_points, at_corners = slopes(solid), slopes(np.column_stack((corners, np.zeros(4))))
    spread = np.linalg.pinv(at_points)
    return np.asarray(np.linalg.norm((at_corners @ spread).reshape(4, -1), axis=1))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


class _Frames:
    """The frames of a device, one after another."""

    def __init__(self, source: str) -> None:
        self._arrival = threading.Event()
        self._device = Device(source, None, time.monotonic_ns, self._arrival.set)
        self.pictures, self.live = self._device.pictures, self._device.live

    def __enter__(self) -> "_Frames":
        self._device.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._device.close()

    def __iter__(self) -> Iterator[Image]:
        while True:
            ended = not self._device.is_alive()
            while self._device.frames:
                yield self._device.frames.popleft()[1]
            if ended:
                return
            self._arrival.wait(0.1)
            self._arrival.clear()
