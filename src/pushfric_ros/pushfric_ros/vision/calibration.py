"""Calibrates a camera: its lens from views of a printed board, its table from the board lying on it or from measured points."""

import csv
import math
import pathlib
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
import shapely
import shapely.affinity
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from pushfric_core.errors import InvalidInput
from pushfric_core.planar import Array
from pushfric_ros.files.file_errors import reading
from pushfric_ros.vision.camera import Camera, Image, Lens
from pushfric_ros.vision.frame_source import Device

MIN_VIEWS = 8
"""Number of different views that a lens calibration needs."""
MIN_CORNERS = 12
"""Number of corners that a view of the board must show."""
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

_DICTIONARY = cv2.aruco.DICT_4X4_250
_MARKER = 0.7  # of a square
_MARKER_MODULES = 6
_SUBPIX = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-3)
_PAPER_MM = (297.0, 210.0)  # A4, landscape
_MARGIN_MM = 12.0
_RULER_MM = 100
_REGIONS = tuple(f"{row} {column}".strip() for row in ("upper", "middle", "lower") for column in ("left", "centre", "right"))


@dataclass(frozen=True)
class Board:
    """A ChArUco board: a chessboard with a marker in each white square.

    The origin of its frame is the lower left corner of the printed chessboard: x right, y up, z towards the viewer.

    Args:
        columns, rows: number of squares.
        square: side of a square [m].
    Raises:
        ValueError: fewer than 4 x 4 or more than 500 squares, or squares not between 0 and 1 m.
    """

    columns: int = 9
    rows: int = 6
    square: float = 0.028

    def __post_init__(self) -> None:
        if self.columns < 4 or self.rows < 4 or self.columns * self.rows > 500:
            raise ValueError(f"a board must have 4 x 4 to 500 squares, got {self.columns} x {self.rows}")
        if not 0 < self.square < 1:
            raise ValueError(f"the board's squares must be larger than 0 and smaller than 1 m, got {self.square:g}")

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the chessboard [m]."""
        return self.columns * self.square, self.rows * self.square


class View(NamedTuple):
    """The corners of a board's squares that one image shows."""

    ids: Array  # (n,) numbers of the corners
    points: Array  # (n, 2) where they are on the board, in its frame [m]
    pixels: Array  # (n, 2) where they are in the image [px]


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


class BoardFinder:
    """Finds a board's corners in images."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._detector = cv2.aruco.CharucoDetector(_charuco(board))

    def view(self, image: Image) -> View | None:
        """The board in an image (height, width); None: the image shows too few of its corners."""
        pixels, ids, _, _ = self._detector.detectBoard(image)
        if ids is None or len(ids) < MIN_CORNERS:
            return None
        number = ids.ravel()
        points = np.array(_charuco(self._board).getChessboardCorners(), dtype=float)[number, :2]
        # The detector's own window reaches into the markers and loses 0.1 px by it; this one ends before the nearest marker.
        rough = pixels.reshape(-1, 2).astype(float)
        apart = np.linalg.norm(rough[:, None] - rough, axis=2)
        square_px = apart[apart > 0].min()
        window = max(2, int((1 - _MARKER) / 2 * square_px) - 1)
        refined = cv2.cornerSubPix(image, pixels.reshape(-1, 1, 2), (window, window), (-1, -1), _SUBPIX)
        # OpenCV counts rows downwards
        points[:, 1] = self._board.size[1] - points[:, 1]
        return View(number, points, refined.reshape(-1, 2).astype(float))


def calibrate_lens(views: Sequence[View], width: int, height: int) -> LensCalibration:
    """The lens that explains views of a board.

    Args:
        views: at least `MIN_VIEWS` of one board, from different directions.
        width, height: of the images [px].
    Raises:
        InvalidInput: the views do not determine the lens; the text says what is missing.
    """
    if len(views) < MIN_VIEWS:
        raise InvalidInput(f"{len(views)} different views of the board are too few: expected at least {MIN_VIEWS}")
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
        raise InvalidInput(f"{len(np.unique(points, axis=0))} different points are too few: expected at least 4")
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
            if view is None or not all(_moved(view, other) > NOVEL * size[1] for other in kept):
                continue
            if not device.pictures and (last is None or _moved(view, last) > STILL_PX):
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
    values: list[list[float]] = []
    with reading(path), path.open(newline="", encoding="utf-8-sig") as stream:
        reader = csv.DictReader(stream, skipinitialspace=True)
        if missing := [name for name in names if name not in (reader.fieldnames or [])]:
            raise InvalidInput(f"{path}: missing column {', '.join(missing)}; expected u, v, x, y")
        for row in reader:
            try:
                values.append([float(row[name]) for name in names])
            except (TypeError, ValueError):
                raise InvalidInput(f"{path}, line {reader.line_num}: u, v, x and y must be numbers") from None
            if not np.isfinite(values[-1]).all():
                raise InvalidInput(f"{path}, line {reader.line_num}: u, v, x and y must be finite")
    table = np.array(values).reshape(-1, 4)
    return table[:, :2], table[:, 2:]


def save_board(board: Board, path: pathlib.Path) -> None:
    """Write the board to scale as a PDF, on A4 or larger paper, with a ruler to check the print.

    Raises:
        InvalidInput: the file cannot be written.
    """
    width, height = (1e3 * side for side in board.size)
    ruler_room = 16.0
    page = np.maximum(_PAPER_MM, (width + 2 * _MARGIN_MM, height + 2 * _MARGIN_MM + ruler_room))
    figure = Figure(figsize=tuple(page / 25.4), frameon=False)
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, page[0]), ylim=(0, page[1]))
    axes.set_axis_off()
    left, bottom = (page[0] - width) / 2, (page[1] - height + ruler_room) / 2
    black = shapely.affinity.translate(_black(board, 1e3 * board.square), left, bottom)
    axes.add_patch(PathPatch(_path(black), facecolor="black", linewidth=0))
    for mm in range(0, _RULER_MM + 1, 5):
        axes.plot((left + mm,) * 2, (bottom - 10, bottom - (6 if mm % 10 == 0 else 8)), color="black", linewidth=0.3)
    text = f"This ruler is {_RULER_MM} mm long, each square {1e3 * board.square:g} mm wide. If not, print again at 100 %."
    axes.text(left + _RULER_MM + 5, bottom - 10, f"{text} {board.columns} x {board.rows} squares.", fontsize=7)
    try:
        figure.savefig(path, format="pdf")
    except OSError as error:
        raise InvalidInput(f"{path}: cannot be written: {error}") from error


def _charuco(board: Board) -> Any:
    dictionary = cv2.aruco.getPredefinedDictionary(_DICTIONARY)
    return cv2.aruco.CharucoBoard((board.columns, board.rows), board.square, _MARKER * board.square, dictionary)


def _black(board: Board, square: float) -> shapely.Geometry:
    """The black area of a board with squares of side `square` and its lower left corner at the origin."""
    charuco = _charuco(board)
    boxes = [
        shapely.box(column, row, column + 1, row + 1)
        for column in range(board.columns)
        for row in range(board.rows)
        if (column + board.rows - 1 - row) % 2 == 0  # the upper left square is black
    ]
    module = _MARKER / _MARKER_MODULES
    for number, corners in zip(charuco.getIds().ravel(), charuco.getObjPoints(), strict=True):
        code = charuco.getDictionary().generateImageMarker(int(number), _MARKER_MODULES)
        left, top = corners[0][:2] / board.square
        for row, column in np.argwhere(code == 0):
            x, y = left + column * module, board.rows - top - row * module
            boxes.append(shapely.box(x, y - module, x + module, y))
    # Joined to whole areas, because a printer may leave hairlines between neighbours; on a fine grid, so that they do join.
    black = shapely.union_all(shapely.set_precision(boxes, 1e-6))
    return shapely.affinity.scale(black, square, square, origin=(0, 0))


def _path(area: shapely.Geometry) -> Path:
    rings = [ring for part in shapely.get_parts(shapely.orient_polygons(area)) for ring in (part.exterior, *part.interiors)]
    return Path.make_compound_path(*(Path(np.array(ring.coords), closed=True) for ring in rings))


def _moved(view: View, other: View) -> float:
    """Mean distance between the corners that both views show [px]; infinite if they share none."""
    _, mine, its = np.intersect1d(view.ids, other.ids, return_indices=True)
    if not len(mine):
        return math.inf
    return float(np.linalg.norm(view.pixels[mine] - other.pixels[its], axis=1).mean())


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
