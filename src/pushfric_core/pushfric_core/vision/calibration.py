"""Calibrates a camera: its lens from views of a printed board, the table from such a board on it or from measured points."""

import math
import pathlib
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.optimize import least_squares

from pushfric_core.errors import InvalidInput
from pushfric_core.files.csv_files import read_table
from pushfric_core.geometry.planar import Array, Pose, transform
from pushfric_core.vision.board import Board, View, calibration_from
from pushfric_core.vision.camera import Camera, Lens
from pushfric_core.vision.frame_source import Frames

MIN_VIEWS = 8
"""Number of different views that a lens calibration needs."""
MIN_TILT = 20.0
"""The tilt of the board must vary by this much over the views, about the image's u axis and about its v axis [degree]."""
MAX_FOCAL_ERROR = 0.005
"""The focal length must be known at least this well (1 sigma, relative)."""
MAX_LENS_RMS_PX = 1.0
"""A larger reprojection error (rms) means that the input is wrong."""

_REGIONS = tuple(f"{row} {column}".strip() for row in ("upper", "middle", "lower") for column in ("left", "centre", "right"))


class LensCalibration(NamedTuple):
    """A lens, and how well it explains the views."""

    lens: Lens
    rms_px: float  # reprojection error over all views
    view_rms_px: Array  # (n,) reprojection error of each view
    focal_error: float  # of the focal length, 1 sigma, relative


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


def lens_from_frames(source: Frames, board: Board, progress: Callable[[str], None]) -> LensCalibration:
    """The lens that took the images of a source, which show the board.

    Args:
        source: not opened yet.
        board: the board that the images show.
        progress: as for `calibration_from`.
    Raises:
        InvalidInput: its images are not enough; the text says what is missing.
    """
    return calibration_from(
        source, board, None, "view", progress, lambda views, shape: calibrate_lens(views, shape[1], shape[0])
    )


MAX_RMS_PX = 5.0
"""A larger reprojection error (rms) means that the input is wrong."""
MAX_LEVERAGE = 4.0
"""An error of 1 px (1 sigma) in the points on the table may grow to this at the image's corners [px]."""
MIN_THICKNESS = 0.01
"""Extent of the points across the line that runs through them, as a share of their extent along it."""
ON_A_LINE = "the points lie on a line or in one place: expected points spread over the table"
MAP = (9, 7)
"""Columns and rows of the map of errors."""

_CORNERS = ("upper left", "upper right", "lower right", "lower left")


class ErrorMap(NamedTuple):
    """How errors of the pixels change the calibration, all over the image."""

    places: Array  # (rows, columns, 2) in the table frame [m]
    errors: Array  # (rows, columns) error of a place seen there, 1 sigma [m]


class TableCalibration(NamedTuple):
    """A camera over its table, and how well it explains the points."""

    camera: Camera
    errors_px: Array  # (n,) reprojection errors
    errors: Array  # (n,) the same errors on the table [m]
    map: ErrorMap

    @property
    def rms_px(self) -> float:
        """Root mean square of the reprojection errors."""
        return _rms(self.errors_px)

    @property
    def rms(self) -> float:
        """Root mean square of the errors on the table [m]."""
        return _rms(self.errors)


def calibrate_table(lens: Lens, placements: Sequence[View]) -> TableCalibration:
    """The table plane from things that lie on it.

    Args:
        lens: of the camera.
        placements: of what lies on it, at least one. The frame of the first is the table frame; where others lie is found.
    Raises:
        InvalidInput: the points do not determine the plane; the text says what is missing.
    """
    first = placements[0]
    if len(np.unique(first.points, axis=0)) < 4:
        raise InvalidInput(f"too few different points: expected at least 4, got {len(np.unique(first.points, axis=0))}")
    if any(_thickness(one) < MIN_THICKNESS for one in (first.pixels, first.points)):
        raise InvalidInput(ON_A_LINE)
    last = lens.width - 0.5, lens.height - 0.5
    if any(((one.pixels < -0.5) | (one.pixels > last)).any() for one in placements):
        raise InvalidInput(f"a pixel lies outside the image for which the lens is calibrated: {lens.width} x {lens.height} px")
    solid, pixels = _solid(first.points), np.ascontiguousarray(first.pixels, dtype=float)
    found, turns, shifts, _ = cv2.solvePnPGeneric(solid, pixels, lens.K, lens.D, flags=cv2.SOLVEPNP_IPPE)
    if not found or not np.isfinite((turns, shifts)).all():
        raise InvalidInput(ON_A_LINE)
    # a plane that is seen exactly from straight above may get a wrong pose
    _, more_turns, more_shifts, _ = cv2.solvePnPGeneric(solid, pixels, lens.K, lens.D, flags=cv2.SOLVEPNP_SQPNP)
    # from a distance, a plane tilted the other way looks nearly the same
    fits: list[tuple[Any, Camera]] = []
    refused: InvalidInput | None = None
    for pose in zip([*turns, *more_turns], [*shifts, *more_shifts], strict=True):
        try:
            fit = _fit(lens, placements, *pose)
            fits.append((fit, _camera(lens, fit.x)))
        except InvalidInput as error:  # this pose shows the table from below, or edge-on; the other one may not
            refused = error
    if refused is not None and not fits:
        raise refused
    fit, camera = min(fits, key=lambda one: one[0].cost)
    errors_px = np.linalg.norm(fit.fun.reshape(-1, 2), axis=1)
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac)[:6, :6]
    corners = np.array(((0, 0), (1, 0), (1, 1), (0, 1))) * (lens.width - 1, lens.height - 1)
    leverage = np.sqrt(np.trace(_spread_px(camera, corners, fit.x, covariance), axis1=1, axis2=2))
    if not leverage.max() < MAX_LEVERAGE:
        raise InvalidInput(
            f"the points are badly spread: an error of 1 px in them grows to {leverage.max():.0f} px in the image's"
            f" {_CORNERS[int(np.argmax(leverage))]}; add points there, or lay the board there too"
        )
    poses = _poses(fit.x)
    seen = [
        np.linalg.norm(camera.unproject(one.pixels) - transform(pose, one.points), axis=1)
        for one, pose in zip(placements, poses, strict=True)
    ]
    errors = np.concatenate(seen)
    if _rms(errors_px) > MAX_RMS_PX:
        worst = int(np.argmax(errors_px))
        raise InvalidInput(
            f"the points disagree by {_rms(errors_px):.1f} px ({1e3 * _rms(errors):.1f} mm); the worst is number {worst + 1}, "
            f"by {errors_px[worst]:.1f} px"
        )
    noise = math.sqrt(2 * fit.cost / max(len(fit.fun) - len(fit.x), 1))
    return TableCalibration(camera, errors_px, errors, _map(camera, fit.x, noise**2 * covariance))


def table_from_frames(source: Frames, board: Board, lens: Lens, progress: Callable[[str], None]) -> TableCalibration:
    """The table on which the board lies in one or more places; the board's frame in the first becomes the table frame.

    Args:
        source: not opened yet.
        board: the board that lies on the table.
        lens: of the camera.
        progress: as for `calibration_from`.
    Raises:
        InvalidInput: images of another size than the lens's, or too few places; the text says what is missing.
    """
    return calibration_from(source, board, lens, "place", progress, lambda views, _: calibrate_table(lens, views))


def read_table_points(path: pathlib.Path) -> View:
    """Pixels and table points [m] from a CSV file with columns u,v,x,y.

    Raises:
        InvalidInput: the file cannot be read as such a table; the text names the file, the line, and what was expected there.
    """
    rows = read_table(path, ("u", "v", "x", "y"), "points").rows
    pixels, points = np.array([row.numbers(("u", "v")) for row in rows]), np.array([row.lengths(("x", "y")) for row in rows])
    return View(np.arange(len(rows), dtype=float), points, pixels)


def _fit(lens: Lens, placements: Sequence[View], turn: Array, shift: Array) -> Any:
    """The camera's pose (6) and the placements' poses (3 for each but the first) of the least sum of squared errors [px^2]."""
    camera = _camera(lens, np.concatenate((turn.ravel(), shift.ravel())))
    start = [turn.ravel(), shift.ravel()]
    start += [_lying(camera.unproject(one.pixels), one.points) for one in placements[1:]]

    def misses(x: Array) -> Array:
        parts = [
            cv2.projectPoints(_solid(transform(pose, one.points)), x[:3], x[3:6], lens.K, lens.D)[0].reshape(-1, 2) - one.pixels
            for one, pose in zip(placements, _poses(x), strict=True)
        ]
        return np.concatenate(parts).ravel()

    return least_squares(misses, np.concatenate(start), x_scale="jac", method="trf")


def _lying(places: Array, points: Array) -> Array:
    """The pose (3,) on the table that brings points (n, 2) nearest to places (n, 2)."""
    a, b = points - points.mean(axis=0), places - places.mean(axis=0)
    angle = math.atan2(float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()), float((a * b).sum()))
    turned = transform(Pose(0.0, 0.0, angle), points.mean(axis=0))
    return np.array((*(places.mean(axis=0) - turned), angle))


def _poses(x: Array) -> list[Pose]:
    """The placements' poses on the table."""
    return [Pose(0.0, 0.0, 0.0), *(Pose(*map(float, one)) for one in x[6:].reshape(-1, 3))]


def _camera(lens: Lens, x: Array) -> Camera:
    R, _ = cv2.Rodrigues(x[:3])
    return lens.over(lens.K @ np.column_stack((R[:, :2], x[3:6])))


def _thickness(points: Array) -> float:
    """Extent of points (n, 2) across their main direction, as a share of that along it; 0 if they are in one place."""
    along, across = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(across / along) if along > 0 else 0.0


def _solid(points: Array) -> Array:
    return np.column_stack((points, np.zeros(len(points))))


def _spread_px(camera: Camera, pixels: Array, x: Array, covariance: Array) -> Array:
    """How the image of the table at pixels (k, 2) varies with the camera's pose: (k, 2, 2) [px^2]."""
    solid = _solid(camera.unproject(pixels))
    slopes = cv2.projectPoints(solid, x[:3], x[3:6], camera.K, camera.D)[1][:, :6].reshape(-1, 2, 6)
    return np.asarray(slopes @ covariance @ slopes.transpose(0, 2, 1))


def _map(camera: Camera, x: Array, covariance: Array) -> ErrorMap:
    """The errors of places seen all over the image, for a camera's pose with this covariance (6, 6)."""
    columns, rows = MAP
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, columns), np.linspace(0, camera.height - 1, rows))
    pixels = np.column_stack((u.ravel(), v.ravel()))
    spread = _spread_px(camera, pixels, x, covariance)
    places = camera.unproject(pixels)
    by_pixel = np.stack([camera.unproject(pixels + step) - places for step in ((1, 0), (0, 1))], axis=2)  # (k, 2, 2) [m/px]
    on_table = by_pixel @ spread @ by_pixel.transpose(0, 2, 1)
    errors = np.sqrt(np.trace(on_table, axis1=1, axis2=2))
    return ErrorMap(places.reshape(rows, columns, 2), errors.reshape(rows, columns))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
