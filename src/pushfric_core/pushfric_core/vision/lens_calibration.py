"""Calibrates a camera's lens from views of a printed board."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from pushfric_core.errors import InvalidInput
from pushfric_core.geometry.planar import Array
from pushfric_core.vision.board import Board, View, calibration_from
from pushfric_core.vision.camera import Lens
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
