"""The printed board that calibrates a camera: what it looks like, and finding it in images."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import cv2
import numpy as np

from pushfric_core.errors import InvalidInput, blaming
from pushfric_core.geometry.planar import Array
from pushfric_core.plausible import other_unit
from pushfric_core.vision.camera import Image, Lens, check_size
from pushfric_core.vision.frame_source import Frames
from pushfric_core.wording import counted

MIN_CORNERS = 12
"""Number of corners that a view of the board must show."""

MARKER = 0.7
"""Side of a marker, as a share of its square's side."""

NOVEL = 0.04
"""A new view must differ from every earlier one by at least this fraction of the image's width."""
STILL_PX = 1.0
"""From one frame to the next, the corners of a board at rest move at most this far on average."""

UNSEEN_BOARD, LIKE_ANOTHER = "the board is not found", "the board lies as in a picture before it"
"""Why a picture is left out of a calibration."""

Calibration = TypeVar("Calibration")

_DICTIONARY = cv2.aruco.DICT_4X4_250
_SUBPIX = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-3)


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
            asked = other_unit("m", lambda factor: 0 < self.square * factor < 1)
            raise ValueError(f"the board's squares must be larger than 0 and smaller than 1 m, got {self.square:g}{asked}")

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the chessboard [m]."""
        return self.columns * self.square, self.rows * self.square


class View(NamedTuple):
    """The corners of a board's squares that one image shows."""

    ids: Array  # (n,) numbers of the corners
    points: Array  # (n, 2) where they are on the board, in its frame [m]
    pixels: Array  # (n, 2) where they are in the image [px]


class BoardFinder:
    """Finds a board's corners in images."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._detector = cv2.aruco.CharucoDetector(charuco(board))

    def view(self, image: Image) -> View | None:
        """The corners of the board in an image (height, width); None if the image shows too few of them."""
        pixels, ids, _, _ = self._detector.detectBoard(image)
        if ids is None or len(ids) < MIN_CORNERS:
            return None
        number = ids.ravel()
        points = np.array(charuco(self._board).getChessboardCorners(), dtype=float)[number, :2]
        # The detector's own window reaches into the markers, which costs 0.1 px; this one ends before the nearest marker.
        rough = pixels.reshape(-1, 2).astype(float)
        apart = np.linalg.norm(rough[:, None] - rough, axis=2)
        square_px = apart[apart > 0].min()
        window = max(2, int((1 - MARKER) / 2 * square_px) - 1)
        refined = cv2.cornerSubPix(image, pixels.reshape(-1, 1, 2), (window, window), (-1, -1), _SUBPIX)
        # OpenCV counts rows downwards
        points[:, 1] = self._board.size[1] - points[:, 1]
        return View(number, points, refined.reshape(-1, 2).astype(float))


def charuco(board: Board) -> Any:
    """OpenCV's model of a board, which counts rows downwards."""
    dictionary = cv2.aruco.getPredefinedDictionary(_DICTIONARY)
    return cv2.aruco.CharucoBoard((board.columns, board.rows), board.square, MARKER * board.square, dictionary)


def moved(view: View, other: View) -> float:
    """Mean distance between the corners that both views show [px]; infinite if they share none."""
    _, mine, its = np.intersect1d(view.ids, other.ids, return_indices=True)
    if not len(mine):
        return math.inf
    return float(np.linalg.norm(view.pixels[mine] - other.pixels[its], axis=1).mean())


def calibration_from(
    source: Frames,
    board: Board,
    lens: Lens | None,
    noun: str,
    progress: Callable[[str], None],
    calibrate: Callable[[list[View], tuple[int, ...]], Calibration],
) -> Calibration:
    """The quantities that different views of a board in the images of a source determine.

    A camera is read until the views are enough; a video or a folder of pictures is read to its end.

    Args:
        source: not opened yet.
        board: the board that the images show.
        lens: of the camera, if it is known.
        noun: what a view is called.
        progress: called with a line of text for each view, which, of a camera, also says what is still missing; and with one
            for each reason why pictures are left out.
        calibrate: called with the views and the shape (height, width) of the images; raises InvalidInput while they are not
            enough.
    Raises:
        InvalidInput: images of different sizes or of another size than the lens's, or too few views; the text says what is
            missing.
    """
    finder, kept, frames, shape = BoardFinder(board), list[View](), 0, tuple[int, ...]()
    left_out: dict[str, list[str]] = {}  # names of pictures, by the reason; frames of a camera or a film are mostly alike
    previous: View | None = None
    moving = 0
    with source:
        for frame in source:
            frames += 1
            if lens is not None:
                check_size(frame, lens, source.name)
            if shape and frame.shape != shape:
                sizes = f"{shape[1]} x {shape[0]} and {frame.shape[1]} x {frame.shape[0]}"
                raise InvalidInput(f"{source.name}: pictures of different sizes: {sizes}")
            shape = frame.shape
            view = finder.view(frame)
            last, previous = previous, view
            if view is None and frames == 1:
                progress("board not found yet")
            if view is None or not all(moved(view, other) > NOVEL * shape[1] for other in kept):
                if source.pictures:
                    left_out.setdefault(UNSEEN_BOARD if view is None else LIKE_ANOTHER, []).append(source.names[frames - 1])
                continue
            if not source.pictures and (last is None or moved(view, last) > STILL_PX):
                moving += 1
                continue
            kept.append(view)
            missing = ""
            if source.live:
                try:
                    return calibrate(kept, shape)
                except InvalidInput as error:
                    missing = f"; {error}"
            progress(f"{noun} {len(kept)}: {len(view.ids)} corners{missing}")
    if source.unread:
        left_out["the file is no picture"], frames = [*source.unread], frames + len(source.unread)
    for why, names in left_out.items():
        progress(f"{len(names)} of {counted(frames, 'picture')} left out, {why}: {', '.join(names)}")
    if not kept and moving:
        raise InvalidInput(f"{source.name}: the board never rests in {frames} pictures; hold it still in each place")
    if not kept:
        raise InvalidInput(f"{source.name}: no ChArUco board of {board.columns} x {board.rows} squares in {frames} pictures")
    with blaming(source.name, InvalidInput):
        return calibrate(kept, shape)
