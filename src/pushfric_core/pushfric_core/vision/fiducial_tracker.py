"""Finds the pose of an object of any colour by fitting the borders of the ArUco or AprilTag markers on it."""

import functools
import math
import pathlib
from typing import Annotated, Any

import cv2
import numpy as np
import numpy.typing as npt
import pydantic

from pushfric_core.errors import InvalidInput
from pushfric_core.files.object_file import Point, within
from pushfric_core.files.yaml_files import Strict, read_yaml
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, Pose, transform
from pushfric_core.plausible import LARGEST
from pushfric_core.vision.camera import Camera, Image
from pushfric_core.vision.edge_fit import MIN_CONTRAST, REACH_PX, SATURATED, EdgeFit, edge_samples
from pushfric_core.vision.sighting import NotSeen, Sighting

FAMILIES = {name.removeprefix("DICT_").lower(): value for name, value in vars(cv2.aruco).items() if name.startswith("DICT_")}
"""OpenCV's dictionaries by name: 4x4_50, apriltag_36h11, ..."""

MIN_MODULE_PX = 4.0
"""The modules, the small squares that a marker is made of, must be at least this wide in the image."""
MAX_MISPLACED_PX = 2.0
"""The corners of the markers may lie this far (rms) from the places that the file and the fitted pose give them."""

BORDER_MODULES = 2
"""Modules of a marker's border: one on each side of its code."""

_EDGE_SAMPLES = 160  # of each marker
_SLACK_PX = 1  # error of a detected corner
_UPRIGHT = np.array(((-1, 1), (1, 1), (1, -1), (-1, -1))) / 2  # corners in the detector's order, y up


class Marker(Strict):
    """A marker on the object's top face."""

    id: Annotated[int, pydantic.Field(ge=0)]
    size: Annotated[float, pydantic.Field(gt=0), within(LARGEST, "m")]  # side of its black square [m]
    center: Point = (0.0, 0.0)  # object frame [m]
    angle_deg: float = 0.0  # of its upward direction in the object frame, counter-clockwise from y


class Fiducials(Strict):
    """The markers on an object, as their YAML file lists them."""

    family: str
    markers: Annotated[list[Marker], pydantic.Field(min_length=1)]

    @pydantic.model_validator(mode="after")
    def _known(self) -> "Fiducials":
        if self.family not in FAMILIES:
            raise ValueError(f"family must be one of {', '.join(sorted(FAMILIES))}")
        ids = [marker.id for marker in self.markers]
        if len(set(ids)) < len(ids):
            raise ValueError("each marker id may occur once")
        count = len(self.dictionary.bytesList)
        if max(ids) >= count:
            raise ValueError(f"{self.family} has the ids 0 to {count - 1}")
        return self

    @property
    def dictionary(self) -> Any:
        """The family as OpenCV's detector takes it."""
        return cv2.aruco.getPredefinedDictionary(FAMILIES[self.family])


def load_fiducials(path: str | pathlib.Path) -> Fiducials:
    """Read the YAML file of an object's markers.

    Raises:
        InvalidInput: the file cannot be read, or describes no markers; the text names file and field.
    """
    return read_yaml(pathlib.Path(path), Fiducials)


class FiducialTracker:
    """Finds one object by its markers.

    Args:
        camera: lens and table.
        outline_vertices: (n, 2) of the object's top face, object frame [m].
        height: of that face, on which the markers are, over the table [m].
        fiducials: the markers.
    Raises:
        InvalidInput: a marker is too small in this camera's image.
    """

    def __init__(self, camera: Camera, outline_vertices: npt.ArrayLike, height: float, fiducials: Fiducials) -> None:
        self._camera, self._height = camera, height
        self._outline = np.asarray(outline_vertices, dtype=float)
        self._pixel = camera.metres_per_pixel(height)
        modules = fiducials.dictionary.markerSize + BORDER_MODULES
        module_px = min(marker.size for marker in fiducials.markers) / modules / self._pixel
        if module_px < MIN_MODULE_PX:
            raise InvalidInput(f"the markers are too small: {module_px:.1f} px per module, expected at least {MIN_MODULE_PX:g}")
        # on one side of the border the marker's code begins, on the other its white margin may end
        self._reach = min(int(module_px) - _SLACK_PX, REACH_PX[1])
        self._detector = cv2.aruco.ArucoDetector(fiducials.dictionary)
        self._corners = {
            marker.id: transform(Pose(*marker.center, math.radians(marker.angle_deg)), marker.size * _UPRIGHT)
            for marker in fiducials.markers
        }
        self._edge_fit_of = functools.cache(self._edge_fit)

    def track(self, image: Image, expected: Pose | None = None) -> Sighting:
        """The object's pose in one frame.

        Args:
            image: (height, width) mono8 frame, the size of the camera's.
            expected: not used: markers distinguish orientations by themselves.

        Raises:
            NotSeen: the frame shows none of the markers, one marker twice, markers that do not lie as the file says, or only
                part of the object.
        """
        ids, pixels = self._markers(image)
        pose = self._rough_pose(ids, pixels)
        edges = self._camera.project(transform(pose, self._outline), self._height)
        if (edges < 0).any() or (edges > (self._camera.width - 1, self._camera.height - 1)).any():
            raise NotSeen("partial view")
        sighting = self._edge_fit_of(ids).refined(image, pose, MIN_CONTRAST)
        if sighting is None:
            raise NotSeen("markers do not fit")
        return sighting._replace(visible_fraction=sighting.visible_fraction * len(ids) / len(self._corners))

    def _markers(self, image: Image) -> tuple[tuple[int, ...], Array]:
        """Ids of the object's markers in view, in ascending order, and their corners (4 n, 2) [px]."""
        found, found_ids, _ = self._detector.detectMarkers(image)
        seen = [] if found_ids is None else [int(number) for number in found_ids.ravel()]
        own = sorted((number, place) for place, number in enumerate(seen) if number in self._corners)
        ids = tuple(number for number, _ in own)
        if not own:
            darkest, brightest, _, _ = cv2.minMaxLoc(image)
            raise NotSeen("saturated or empty frame" if darkest >= SATURATED or brightest == 0 else "no marker of the object")
        if len(set(ids)) < len(ids):
            raise NotSeen("two candidates")
        return ids, np.concatenate([found[place].reshape(4, 2) for _, place in own])

    def _rough_pose(self, ids: tuple[int, ...], pixels: Array) -> Pose:
        """The pose that brings the markers' corners closest to where they are seen, by least squares in complex numbers."""
        there = self._camera.unproject(pixels, self._height) @ (1, 1j)
        here = np.concatenate([self._corners[number] for number in ids]) @ (1, 1j)
        turn = np.vdot(here - here.mean(), there - there.mean())
        turn /= abs(turn)
        shift = there.mean() - turn * here.mean()
        misplaced = np.abs(there - turn * here - shift).reshape(-1, 4) / self._pixel
        if (np.sqrt(np.mean(misplaced**2, axis=1)) > MAX_MISPLACED_PX).any():
            raise NotSeen("markers do not lie as given")
        return Pose(float(shift.real), float(shift.imag), float(np.angle(turn)))

    def _edge_fit(self, ids: tuple[int, ...]) -> EdgeFit:
        """The fit of the borders of these markers."""
        clearance = (self._reach + _SLACK_PX) * self._pixel
        samples = [edge_samples(Outline(self._corners[number]), clearance, _EDGE_SAMPLES) for number in ids]
        points, outward = (np.concatenate(arrays) for arrays in zip(*samples, strict=True))
        return EdgeFit(self._camera, points, -outward, self._height, self._reach, _SLACK_PX)
