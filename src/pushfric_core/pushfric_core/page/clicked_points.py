"""Points of the table that are clicked in a camera's picture: the calibration that they give, and what the page shows of it."""

import math
import pathlib
from typing import Annotated, Any

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from pushfric_core.errors import InvalidInput
from pushfric_core.geometry.planar import Array
from pushfric_core.plausible import FARTHEST
from pushfric_core.vision.calibration import Placement, TableCalibration, calibrate_table
from pushfric_core.vision.camera import Camera, Image, Lens, check_size, save_camera
from pushfric_core.wording import counted

MOST = 100
"""Number of points."""
ENOUGH = 4
"""Points that are needed."""

LINES = 6
"""About so many lines of the table are drawn along its longer side."""
SAMPLES = 17
"""Points of a line, which the lens bends."""

Pixel = Annotated[float, Field(allow_inf_nan=False, ge=-0.5, le=1e5)]
Place = Annotated[float, Field(allow_inf_nan=False, ge=-FARTHEST, le=FARTHEST)] | None
Point = tuple[Pixel, Pixel, Place, Place]
"""u, v [px] and x, y [m]; None: not typed yet."""

_POINTS: TypeAdapter[list[Point]] = TypeAdapter(Annotated[list[Point], Field(max_length=MOST)])


class ClickedPoints:
    """The points clicked so far.

    Args:
        lens: of the camera.
        target: the file that the calibration is written to.
        marks: x and y of the points to click [m]; empty: they are typed on the page.
    Raises:
        InvalidInput: too many marks.
    """

    def __init__(self, lens: Lens, target: pathlib.Path, marks: list[list[float]]) -> None:
        if len(marks) > MOST:
            raise InvalidInput(f"expected at most {MOST} points to click, got {len(marks)}")
        self._lens, self._target, self._marks = lens, target, marks
        self._picture: Image | None = None
        self._points: list[Point] = []
        self.found: TableCalibration | None = None
        """The calibration by the points, if they determine one."""
        self.problem = _missing(0)
        """Why there is no calibration; empty if there is one."""

    def show(self, image: Image, source: str) -> None:
        """Take the picture in which points are clicked.

        Raises:
            InvalidInput: it has another size than the lens is calibrated for.
        """
        check_size(image, self._lens, source)
        self._picture = image

    def picture(self) -> Image:
        """The camera's picture as it is."""
        assert self._picture is not None
        return self._picture

    def save(self) -> str:
        """Write the calibration.

        Raises:
            InvalidInput: the points give none, or the file cannot be written.
        """
        if self.found is None:
            raise InvalidInput(self.problem)
        save_camera(self.found.camera, self._target)
        return f"Saved in {self._target}. You can close this page"

    def take(self, body: bytes) -> None:
        """Replace the points by those of a JSON text, a list of [u, v, x, y], and fit them.

        Raises:
            InvalidInput: the text is not such a list.
        """
        try:
            self._points = _POINTS.validate_json(body)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(map(str, first["loc"])) or "points"
            raise InvalidInput(f"expected at most {MOST} points [u, v, x, y]: {where}: {first['msg']}") from error
        self.found, self.problem = None, _missing(len(self._points))
        untold = [number for number, (_, _, x, y) in enumerate(self._points, 1) if x is None or y is None]
        if untold:
            self.problem = f"where is point {untold[0]}? Type its x and y"
        elif not self.problem:
            try:
                table = np.array(self._points, dtype=float)
                self.found = calibrate_table(self._lens, [Placement(table[:, :2], table[:, 2:])])
            except InvalidInput as error:
                self.problem = str(error)

    def figures(self) -> dict[str, Any]:
        """The content of the page: all lengths in m, all pixels as (u, v)."""
        figures: dict[str, Any] = {"points": self._points, "problem": self.problem, "fit": None}
        figures |= {"target": str(self._target), "width": self._lens.width, "height": self._lens.height, "marks": self._marks}
        if self.found is not None:
            found, camera = self.found, self.found.camera
            places = np.array(self._points, dtype=float)[:, 2:]
            step, lines = _lines(camera, places)
            figures["fit"] = {
                "rms_px": found.rms_px,
                "rms": found.rms,
                "errors": found.errors,
                "seen": camera.project(places),
                "median": float(np.median(found.map.errors)),
                "largest": float(found.map.errors.max()),
                "map": found.map.errors,
                "step": step,
                "lines": lines,
                "axes": camera.project(np.array(((0.0, 0.0), (step, 0.0), (0.0, step)))),
            }
        return figures


def _missing(count: int) -> str:
    if count >= ENOUGH:
        return ""
    return f"{counted(ENOUGH - count, 'point')} more, spread over the picture" if count else f"at least {ENOUGH} points"


def _lines(camera: Camera, places: Array) -> tuple[float, list[Array]]:
    """Lines of the table over the rectangle around places (n, 2), as they appear in the image: their step [m], (k, 2) each."""
    (low_x, low_y), (high_x, high_y) = places.min(axis=0), places.max(axis=0)
    raw = max(high_x - low_x, high_y - low_y) / LINES
    power = 10.0 ** math.floor(math.log10(raw))
    step = power * next(factor for factor in (1, 2, 5, 10) if factor * power >= raw)
    lines = []
    for low, high, start, end, along in ((low_x, high_x, low_y, high_y, 1), (low_y, high_y, low_x, high_x, 0)):
        for value in step * np.arange(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1):
            line = np.full((SAMPLES, 2), value)
            line[:, along] = np.linspace(start, end, SAMPLES)
            lines.append(camera.project(line))
    return step, lines
