"""A camera that renders one bright object on a dark table, for the tracker of the simulated cell."""

import cv2
import numpy as np
import numpy.typing as npt
import shapely

from pushfric_core.geometry.planar import Array, Pose, transform
from pushfric_core.vision.camera import Camera, Image

SHADOW = 0.7
"""Brightness inside the shadow, relative to the brightness outside."""
_PIECE_PX = 8  # edges are drawn in pieces of about this length, because a lens bends them
_NOISE_MARGIN_PX = 128  # the noise field is larger than the frame by this much; each frame gets another crop of it


class SimulatedCamera:
    """Renders mono8 frames of an object on the table, with exact pixel coverage, blur and sensor noise.

    Args:
        camera: lens and table.
        outline_vertices: (n, 2) top face of the object, object frame [m].
        height: of that face over the table [m].
        rng: source of the noise.
        noise_sigma: standard deviation of the noise [grey levels].
        blur_px: standard deviation of the lens's blur [px].
        foreground, background: brightness of object and table [grey levels].
        shadow: (a, b, c): pixels with a u + b v > c lie in a shadow, 30 % darker; None: no shadow.
    """

    def __init__(
        self,
        camera: Camera,
        outline_vertices: npt.ArrayLike,
        height: float,
        rng: np.random.Generator,
        noise_sigma: float = 2.0,
        blur_px: float = 0.7,
        foreground: float = 220,
        background: float = 20,
        shadow: tuple[float, float, float] | None = None,
    ) -> None:
        self.camera = camera
        self.lit = True  # by the lamp
        self._height = height
        self._rng = rng
        self._blur_px = blur_px
        pieces = shapely.segmentize(shapely.Polygon(outline_vertices), _PIECE_PX * camera.metres_per_pixel(height))
        self._outline = shapely.get_coordinates(pieces)[:-1]
        self._gain = np.ones((camera.height, camera.width), np.float32)
        if shadow is not None:
            a, b, c = shadow
            v, u = np.mgrid[: camera.height, : camera.width]
            self._gain[a * u + b * v > c] = SHADOW
        self._background = background
        self._contrast = foreground - background
        self._table = np.rint(background * self._gain).astype(np.uint8)
        margin = _NOISE_MARGIN_PX
        noise = np.rint(rng.normal(0, noise_sigma, (camera.height + margin, camera.width + margin)))
        # Two 8-bit fields, one that brightens and one that darkens: saturating arithmetic is far faster than a signed field.
        self._brightening = np.clip(noise, 0, 255).astype(np.uint8)
        self._darkening = np.clip(-noise, 0, 255).astype(np.uint8)

    def render(self, pose: Pose | None) -> Image:
        """The frame (height, width) with the object at `pose` in the table frame; None: without the object."""
        frame = self._table.copy() if self.lit else np.zeros_like(self._table)
        if pose is not None and self.lit:
            self._draw(frame, self.camera.project(transform(pose, self._outline), self._height))
        row, column = self._rng.integers(0, _NOISE_MARGIN_PX, 2)
        crop = np.s_[row : row + self.camera.height, column : column + self.camera.width]
        cv2.add(frame, self._brightening[crop], dst=frame)
        cv2.subtract(frame, self._darkening[crop], dst=frame)
        return np.asarray(frame)

    def _draw(self, frame: Image, polygon: Array) -> None:
        """Draw the object into the part of the frame it covers."""
        margin = int(np.ceil(4 * self._blur_px)) + 1
        # pixel (0, 0) spans -0.5 .. 0.5
        corner = np.floor(polygon.min(axis=0) + 0.5).astype(int) - margin
        size = np.ceil(polygon.max(axis=0) + 0.5).astype(int) + margin - corner
        low = np.maximum(corner, 0)
        high = np.minimum(corner + size, (self.camera.width, self.camera.height))
        if (high <= low).any():
            return
        patch = coverage(polygon + 0.5 - corner, int(size[0]), int(size[1]))
        if self._blur_px > 0:
            patch = cv2.GaussianBlur(patch, (0, 0), self._blur_px)
        seen = np.s_[low[1] : high[1], low[0] : high[0]]
        patch = patch[low[1] - corner[1] : high[1] - corner[1], low[0] - corner[0] : high[0] - corner[0]]
        frame[seen] = np.rint((self._background + self._contrast * patch) * self._gain[seen])


def coverage(polygon: Array, width: int, height: int) -> npt.NDArray[np.float32]:
    """The exact fraction of each pixel that a polygon covers: (height, width) in [0, 1].

    Each piece of the outline within one pixel adds its signed height to all pixels on its right. To its own pixel it adds
    the part on its right. A running sum along the rows gives the area.

    Args:
        polygon: (n, 2) vertices in order [px], within the image; pixel (row, column) spans
            [column, column + 1] x [row, row + 1].
    """
    closed = np.vstack((polygon, polygon[:1]))
    steps = np.arange(len(closed), dtype=float)
    cuts = np.sort(np.concatenate((steps, _grid_crossings(closed[:, 0]), _grid_crossings(closed[:, 1]))))
    x, y = (np.interp(cuts, steps, values) for values in closed.T)
    rise = np.diff(y)
    middle = (x[1:] + x[:-1]) / 2
    column, row = np.floor(middle).astype(int), np.floor((y[1:] + y[:-1]) / 2).astype(int)
    right = column + 1 - middle
    # one column more, for the share to the right of the last column
    cell, cells = row * (width + 1) + column, (width + 1) * height
    area = np.bincount(cell, rise * right, cells) + np.bincount(cell + 1, rise * (1 - right), cells)
    return np.abs(np.cumsum(area.reshape(height, width + 1), axis=1)[:, :-1]).astype(np.float32)


def _grid_crossings(values: Array) -> Array:
    """Where a coordinate of a polyline passes an integer: vertex number plus the fraction of the way to the next vertex."""
    start, rise = values[:-1], np.diff(values)
    lines = np.arange(np.ceil(values.min()), np.floor(values.max()) + 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        way = (lines[:, None] - start) / rise
    line, piece = np.nonzero((way > 0) & (way < 1))
    return np.asarray(piece + way[line, piece], dtype=float)
