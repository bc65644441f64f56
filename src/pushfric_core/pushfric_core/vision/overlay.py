"""The drawing over the camera's picture: the object as it is seen, where it is to be placed, and the table's axes."""

import cv2
import numpy as np

from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, Pose, transform
from pushfric_core.vision.camera import Camera, Image

SEEN, GHOST, PLACED, AXES = (0, 200, 0), (0, 140, 255), (255, 200, 80), (255, 255, 255)  # BGR
DASH, AXIS = 0.006, 0.03
"""Lengths of a dash and of an axis of the table or of the object [m]."""

FINE = 4  # binary places of a drawn coordinate
FONT = cv2.FONT_HERSHEY_SIMPLEX


class Overlay:
    """A picture in colours that is drawn on; all that is drawn on the table is given in the table frame [m].

    Args:
        frame: the camera's picture (height, width) in grey levels.
        camera: its calibration.
        outline: of the object.
        height: of the outline above the table [m].
    Attributes:
        picture: (height, width, 3), BGR.
    """

    def __init__(self, frame: Image, camera: Camera, outline: Outline, height: float) -> None:
        self.picture = cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR)
        self._camera, self._outline, self._height = camera, outline, height
        self._size = max(1, round(frame.shape[1] / 640))  # of lines [px]

    def table(self) -> None:
        """The table's axes."""
        self._axes(Pose(0.0, 0.0, 0.0), 0.0)

    def seen(self, pose: Pose) -> None:
        """The object where it is seen."""
        self._line(transform(pose, self._outline.vertices), SEEN, True)
        self._axes(pose, self._height)

    def ghost(self, place: Pose, seen: Pose | None, in_place: bool) -> None:
        """Where the object is to be placed: dashed, with an arrow from where it is seen, or whole once it lies there."""
        corners = transform(place, self._outline.vertices)
        if in_place:
            self._line(corners, PLACED, True)
            self._write("in place", (place.x, place.y), PLACED)
            return
        for begin, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            count = max(1, round(float(np.linalg.norm(end - begin)) / DASH / 2))
            for dash in range(count):
                ends = [begin + (dash + share) / count * (end - begin) for share in (0.0, 0.5)]
                self._line(np.array(ends), GHOST)
        self._axes(place, self._height, GHOST)
        if seen is not None:
            way = np.array(((seen.x, seen.y), (place.x, place.y)))
            self._arrow(way, self._height, GHOST)
            distance = float(np.linalg.norm(way[1] - way[0]))
            self._write(f"{distance * 1e3:.0f} mm", tuple(way.mean(axis=0)), GHOST)

    def say(self, text: str) -> None:
        """A line of text in the corner."""
        cv2.putText(self.picture, text, (8, 20), FONT, 0.5 * self._size, (0, 200, 255), self._size, cv2.LINE_AA)

    def _axes(self, pose: Pose, height: float, colour: tuple[int, int, int] = AXES) -> None:
        for tip, name in (((AXIS, 0.0), "x"), ((0.0, AXIS), "y")):
            ends = transform(pose, np.array(((0.0, 0.0), tip)))
            self._arrow(ends, height, colour)
            self._write(name, tuple(ends[1]), colour, height)

    def _pixels(self, points: Array, height: float) -> Array:
        seen = self._camera.project(points, height)
        return np.rint(np.clip(seen, -1e4, 1e4) * (1 << FINE)).astype(np.int32)

    def _line(self, points: Array, colour: tuple[int, int, int], closed: bool = False) -> None:
        pixels = self._pixels(points, self._height)
        cv2.polylines(self.picture, [pixels], closed, colour, self._size, cv2.LINE_AA, FINE)

    def _arrow(self, ends: Array, height: float, colour: tuple[int, int, int]) -> None:
        begin, end = (tuple(map(int, pixel)) for pixel in self._pixels(ends, height))
        for shade, thickness in (((0, 0, 0), 3 * self._size), (colour, self._size)):  # seen on dark and bright ground
            cv2.arrowedLine(self.picture, begin, end, shade, thickness, cv2.LINE_AA, FINE, 0.15)

    def _write(self, text: str, point: tuple[float, ...], colour: tuple[int, int, int], height: float | None = None) -> None:
        (u, v), size = self._pixels(np.array([point]), self._height if height is None else height)[0] >> FINE, self._size
        for shade, thickness in (((0, 0, 0), 3 * size), (colour, size)):
            cv2.putText(self.picture, text, (int(u) + 4, int(v) - 4), FONT, 0.5 * size, shade, thickness, cv2.LINE_AA)
