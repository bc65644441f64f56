"""An object that is drawn over a picture, or on an empty sheet: its outline, and where it touches the table."""

import contextlib
import math
import os
import pathlib
import queue
from collections.abc import Callable
from typing import Annotated, Any

import cv2
import numpy as np
import shapely
from pydantic import Field

from pushfric_core.cell.node_settings import ViewConfig
from pushfric_core.errors import InvalidInput, blaming
from pushfric_core.files.disk import write_whole
from pushfric_core.files.object_file import Length, ObjectFile, ObjectModel, Point, edited_object
from pushfric_core.files.yaml_files import Strict, fitting, read_yaml
from pushfric_core.geometry.planar import Array, Pose, inverse, transform
from pushfric_core.page.server import PageServer, Reply, Request
from pushfric_core.records import mapped
from pushfric_core.vision.camera import Camera, Image, check_size
from pushfric_core.vision.contour_tracker import ContourTracker
from pushfric_core.vision.frame_source import Frames
from pushfric_core.vision.outline_measurement import measured_outline
from pushfric_core.vision.sighting import NotSeen

PICTURE = "picture.png"

ADDRESSES = f"state|{PICTURE}", "work|another|save"
"""The requests of the page that change nothing, and the others."""

MOST = 200
"""Number of corners, and of support points."""

LONGEST_SIDE_PX = 1600
"""Longest side of the picture that the page shows."""

EMPTY = 0.3
"""Width of an empty sheet [m]."""

USUAL: dict[str, Any] = ObjectFile.model_fields["support"].default.model_dump(exclude_none=True)
"""The support of an object of which nothing is known."""

PRECISION = 5
"""Lengths are written with this many decimals [m]."""


Points = Annotated[list[Point], Field(max_length=MOST)]


class DrawnSupport(Strict):
    """The support of an object's file, which may still be incomplete."""

    grid: tuple[int, int] | None = None
    inset: Length | None = None
    points: Points | None = None
    spacing: Length | None = None


class Drawing(Strict):
    """The object as the page has drawn it."""

    outline: Points = Field(default=[])
    support: DrawnSupport = DrawnSupport(**USUAL)
    picture: tuple[Length, Length, float] = (0.0, 0.0, 0.0)  # where its frame lies in the object frame [m, m, degrees]
    find: bool = False  # take the outline that the picture shows in place of the one drawn


class DrawnObject:
    """The object of one file.

    Args:
        target: the object's file; it need not exist.
        camera: that takes the pictures; its table gives them their scale. None: `width` does.
        width: of a picture without a camera, or of the empty sheet [m]; None: that of the empty sheet.
        height: of the object's face over the table [m]; None: as in the file.
    Raises:
        InvalidInput: the file is there, but is no object's.
    """

    def __init__(
        self, target: pathlib.Path, camera: Camera | None = None, width: float | None = None, height: float | None = None
    ) -> None:
        self._target, self._camera, self._width = target, camera, EMPTY if width is None else width
        self._read()
        self._drawing = Drawing(**{key: value for key, value in self._written.items() if key != "height"})
        self._height = self._written.get("height", 0.0) if height is None else height
        self._raw: Image | None = None  # as it was taken
        self._picture: Image | None = None  # as seen from above
        self._frame = Pose(0.0, 0.0, 0.0)  # of the picture, on the camera's table
        self._region = -self._width / 2, -self._width * 3 / 8, self._width, self._width * 3 / 4
        self._check()

    def _read(self) -> None:
        """See what the file says of all that can be drawn; nothing if it is not there."""
        self._written: dict[str, Any] = {}
        if os.path.exists(self._target):
            file = read_yaml(self._target, ObjectFile)
            self._written = file.model_dump(mode="json", exclude_none=True, include={"outline", "support", "height"})

    def take(self, body: bytes) -> None:
        """Replace what is drawn by a JSON text, with the fields of `Drawing`; `problem` says what is wrong with it.

        Raises:
            InvalidInput: the text is no drawing.
        """
        with fitting("expected a drawing"):
            drawing = Drawing.model_validate_json(body)
        if drawing.find:
            with blaming("no outline was found", NotSeen):
                drawing = drawing.model_copy(update={"outline": self._found(drawing), "find": False})
        self._drawing = drawing
        self._check()

    def _check(self) -> None:
        self.model: ObjectModel | None = None
        """The object as drawn; None if there is a problem."""
        self.problem = ""
        """Why what is drawn is no object; empty if it is one."""
        try:
            self._text, self.model = edited_object(self._target, self._changes())
        except InvalidInput as error:
            self.problem = str(error).removeprefix(f"{self._target}: ")

    def _changes(self) -> dict[str, Any]:
        """The differences from the file."""
        drawn = self._drawing.model_dump(mode="json", exclude_none=True, exclude={"picture", "find"})
        if self._height != self._written.get("height", 0.0):
            drawn["height"] = self._height
        return {key: value for key, value in _rounded(drawn).items() if value != _rounded(self._written.get(key, {}))}

    def figures(self) -> dict[str, Any]:
        """The content of the page: all lengths in m, in the object frame, or the picture's where it says so."""
        left, bottom, wide, high = self._region
        return {
            "target": str(self._target),
            **self._drawing.model_dump(exclude_none=True, exclude={"find"}),
            "supports": [] if self.model is None else self.model.support_points,
            "problem": self.problem,
            "region": {"left": left, "bottom": bottom, "width": wide, "height": high},  # of the picture, in its own frame
            "usual": USUAL,
            "has_picture": self._picture is not None,
        }

    def show(self, image: Image, source: str) -> None:
        """Take a picture, and put it where the object that it shows lies under the drawing, if that can be found.

        If nothing is drawn yet, the outline that the picture shows is a first proposal.

        Raises:
            InvalidInput: it has another size than the camera.
        """
        if self._camera is None:
            self._picture, high = image, self._width * image.shape[0] / image.shape[1]
            self._region = -self._width / 2, -high / 2, self._width, high
        else:
            check_size(image, self._camera, source)
            self._frame = self._seen(self._camera, image)
            self._picture, self._region = _from_above(self._camera, image, self._frame, self._height)
        self._raw = image
        self._drawing = self._drawing.model_copy(update={"picture": (0.0, 0.0, 0.0)})
        if not self._drawing.outline:
            with contextlib.suppress(NotSeen):  # then it is drawn by hand
                self._drawing = self._drawing.model_copy(update={"outline": self._found(self._drawing)})
                self._check()

    def _found(self, drawing: Drawing) -> list[Point]:
        """The outline that the picture shows, in the object frame; corner 0 is the one next to that of the drawing.

        Raises:
            NotSeen: it shows none.
        """
        if self._raw is None:
            raise NotSeen("there is no picture")
        x, y, turn = drawing.picture
        lies = Pose(x, y, math.radians(turn))
        if self._camera is None:
            scan = Camera.looking_down(self._raw.shape[1], self._raw.shape[0], (0.0, 0.0), self._width / self._raw.shape[1])
            try:
                corners = measured_outline(scan, self._raw, 0.0)
            except NotSeen:  # it may be darker than what it lies on
                corners = measured_outline(scan, cv2.bitwise_not(self._raw), 0.0)
        else:
            corners = transform(inverse(self._frame), measured_outline(self._camera, self._raw, self._height))
        corners = transform(lies, corners)
        if drawing.outline:
            first = np.hypot(*(corners - drawing.outline[0]).T)
            corners = np.roll(corners, -int(np.argmin(first)), axis=0)
        return [(x, y) for x, y in corners.round(PRECISION).tolist()]

    def _seen(self, camera: Camera, image: Image) -> Pose:
        """Where the object frame lies on the table: that of the file, or about the middle of what is seen, x along its longest
        edge; in the middle of the picture if nothing is found."""
        with contextlib.suppress(NotSeen, InvalidInput):  # it may be too small for the tracker
            if self.model is not None:
                return ContourTracker(camera, self.model.outline.vertices, self._height).track(image).pose
            corners = measured_outline(camera, image, self._height)
            edges = np.roll(corners, -1, axis=0) - corners
            along = edges[np.argmax(np.hypot(*edges.T))]
            (x, y), *_ = shapely.Polygon(corners).centroid.coords
            return Pose(x, y, math.atan2(along[1], along[0]))
        x, y = camera.unproject([((camera.width - 1) / 2, (camera.height - 1) / 2)], self._height)[0].tolist()
        return Pose(x, y, 0.0)

    def picture(self) -> Image:
        """The picture as seen from straight above.

        Raises:
            InvalidInput: there is none.
        """
        if self._picture is None:
            raise InvalidInput("there is no picture")
        return self._picture

    def save(self) -> str:
        """Write the file.

        Raises:
            InvalidInput: what is drawn is no object, or the file cannot be written.
        """
        self._read()  # it may have changed, and shall say what was drawn
        self._check()
        if self.model is None:
            raise InvalidInput(self.problem)
        write_whole(self._target, self._text)
        return f"Saved in {self._target}. You can close this page"


def _rounded(value: Any) -> Any:
    return mapped(value, lambda one: round(one, PRECISION))


def _from_above(camera: Camera, image: Image, pose: Pose, height: float) -> tuple[Image, tuple[float, float, float, float]]:
    """The plane at a height over the table as a picture shows it, from straight above, along the axes of a pose.

    Returns:
        The picture, and its left, bottom, width and height in the frame of the pose [m].
    """
    u, v = camera.width - 1, camera.height - 1
    border = camera.unproject([(0, 0), (u / 2, 0), (u, 0), (u, v / 2), (u, v), (u / 2, v), (0, v), (0, v / 2)], height)
    seen = transform(inverse(pose), border)
    low, size = seen.min(axis=0), np.ptp(seen, axis=0)
    pixel = max(camera.metres_per_pixel(height) / 2, float(size.max()) / LONGEST_SIDE_PX)
    columns, rows = np.ceil(size / pixel).astype(int).tolist()
    x, y = np.meshgrid((np.arange(columns) + 0.5) * pixel, (rows - 0.5 - np.arange(rows)) * pixel)
    places: Array = transform(pose, low + np.stack((x, y), axis=-1).reshape(-1, 2))
    pixels = camera.project(places, height).reshape(rows, columns, 2).astype(np.float32)
    above = cv2.remap(image, pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR, borderValue=255.0)
    return above, (float(low[0]), float(low[1]), columns * pixel, rows * pixel)


def draw_in_a_browser(drawn: DrawnObject, source: Frames | None, shown: ViewConfig, announce: Callable[[str], None]) -> None:
    """Serve a page on which a person draws an object, until somebody there saves it.

    Args:
        drawn: the object.
        source: not opened yet; one of its frames is shown, and the next when the page asks for it. None: no picture.
        shown: where the page is served.
        announce: called with the line that names its address.
    Raises:
        InvalidInput: the first picture cannot be had, or the page cannot be served there.
    """
    # Everything is done in this thread: a topic is received in the one that opened it.
    requests: queue.SimpleQueue[Request] = queue.SimpleQueue()
    with contextlib.nullcontext() if source is None else source:
        if source is not None:
            drawn.show(_next_picture(source), source.name)
        with contextlib.closing(PageServer(shown, "drawing.html", requests.put, *ADDRESSES)) as server:
            announce(f"view: {server.url}")
            saved = False
            while not saved:
                asked = requests.get()
                reply: Reply
                try:
                    if asked.what == PICTURE:
                        reply = "image/png", cv2.imencode(".png", drawn.picture())[1].tobytes()
                    elif asked.what == "another":
                        if source is not None:
                            drawn.show(_next_picture(source), source.name)
                        reply = {"done": True}
                    elif asked.what == "save":
                        reply = {"done": True, "message": drawn.save()}
                        saved = True
                    else:
                        if asked.what == "work":
                            drawn.take(asked.body)
                        reply = {"done": True, "source": source and source.name, **drawn.figures()}
                except (InvalidInput, OSError) as error:
                    reply = {"done": False, "message": str(error)}
                asked.answer(reply)


def _next_picture(source: Frames) -> Image:
    """The present frame of a camera, or the next picture of an opened source.

    Raises:
        InvalidInput: there is none.
    """
    source.forget()
    for frame in source:
        return frame
    raise InvalidInput(f"{source.name}: no further picture")
