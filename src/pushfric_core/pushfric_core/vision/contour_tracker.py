"""Finds the pose of a bright object on a dark table: fits its known outline to its edge, to a few hundredths of a pixel."""

import cmath
import math

import cv2
import numpy as np
import numpy.typing as npt
import shapely

from pushfric_core.errors import InvalidInput
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, Pose, wrap
from pushfric_core.vision.camera import Camera, Image
from pushfric_core.vision.edge_fit import MIN_CONTRAST, REACH_PX, SATURATED, EdgeFit, edge_samples
from pushfric_core.vision.sighting import NO_OBJECT, NotSeen, Sighting

AREA_RANGE = (0.6, 1.6)
"""Area of a blob that may be the object, as a fraction of the outline's."""
SPECK_AREA = 0.1
"""Blobs smaller than this fraction of the outline's area are ignored."""

ALIKE, MISTAKEN, EXACT = 0.02, 0.1, 0.002
"""How an object that does not fit is explained. It has the outline's shape if its slenderness agrees within the first share or
a coarse pixel. It is another object if its size differs by more than the second share; if it differs by less than the third,
its size is not the reason."""
RISE = 0.01
"""Step in height [m] that shows how fast the pixels shrink, and so at which height an object would have its size."""

_SHRUNK_WIDTH_PX = 10  # least inradius of the object in the shrunk image, in which blobs are sought
_COARSE_SAMPLES = 360  # around the outline; divisible by each order of symmetry
_SYMMETRIES = (1, 2, 3, 4, 5, 6, 8)
_EDGE_SAMPLES = 80
_MIN_EDGE_SAMPLES = 24


class ContourTracker:
    """Finds one object of known outline.

    Args:
        camera: lens and table.
        outline_vertices: (n, 2) of the object's bright top face, object frame [m].
        height: of that face over the table [m].
        threshold: grey level between table and object; None: chosen for each frame (Otsu's method).
    Raises:
        InvalidInput: the object is too small or too thin in this camera's image.
    """

    def __init__(self, camera: Camera, outline_vertices: npt.ArrayLike, height: float, threshold: float | None = None) -> None:
        self._camera = camera
        self._height = height
        self._threshold = threshold
        self._outline = Outline(np.asarray(outline_vertices, dtype=float))
        self._pixel = camera.metres_per_pixel(height)
        inradius = shapely.maximum_inscribed_circle(self._outline.polygon).length / self._pixel
        self._shrinking = max((n for n in (2, 4, 8) if inradius >= n * _SHRUNK_WIDTH_PX), default=1)

        self._boundary = _boundary_samples(self._outline.vertices)
        self._boundary_mean = self._boundary.mean()
        self._boundary_spectrum = np.conj(np.fft.fft(self._boundary - self._boundary_mean)) / _COARSE_SAMPLES
        self._spread = _spread(self._boundary - self._boundary_mean)
        squared, _ = self._matches(self._boundary)
        # An outline is k-fold symmetric if it matches itself to a fraction of a pixel when shifted by a k-th of its length.
        alike = squared < (0.1 * self._pixel) ** 2
        self._symmetry = max(k for k in _SYMMETRIES if alike[_COARSE_SAMPLES // k % _COARSE_SAMPLES])

        # The pose found from the blob is wrong by up to half a pixel of the shrunk image.
        slack_px = max(2, self._shrinking // 2)
        reach_px = int(np.clip(inradius / 3, *REACH_PX))
        points, normals = edge_samples(self._outline, (reach_px + slack_px) * self._pixel, _EDGE_SAMPLES)
        if len(points) < _MIN_EDGE_SAMPLES:
            raise InvalidInput(f"the object is too small or thin for the tracker: {2 * inradius:.0f} px wide, 25 px are enough")
        self._edge_fit = EdgeFit(camera, points, normals, height, reach_px, slack_px)

    def track(self, image: Image, expected: Pose | None = None) -> Sighting:
        """The object's pose in one frame.

        Args:
            image: (height, width) mono8 frame, the size of the camera's.
            expected: approximate pose, in the table frame. If several orientations fit equally well, the nearest one is
                taken; with None, the one nearest to 0.
        Raises:
            NotSeen: the frame shows no object, only part of it, more than one, or an outline that does not fit.
            ValueError: the image has another size or type.
        """
        if image.shape != (self._camera.height, self._camera.width) or image.dtype != np.uint8:
            size = (self._camera.height, self._camera.width)
            raise ValueError(f"image must be uint8 of shape {size}, got {image.dtype} of shape {image.shape}")
        blob, contrast = self._blob(image)
        # usually the object is close to where it is expected
        if expected is not None and (fit := self._edge_fit.refined(image, expected, contrast)) is not None:
            return fit._replace(orientations=self._symmetry, doubt=self._doubt(fit))
        heading = 0.0 if expected is None else expected.theta
        starts = self._coarse_poses(blob, heading)
        fits = [fit for start in starts if (fit := self._edge_fit.refined(image, start, contrast)) is not None]
        if not fits:
            raise NotSeen(f"outline does not fit: {self._misfit(image, blob)}")
        best = min(fit.residual_px for fit in fits)
        equal = [fit for fit in fits if fit.residual_px <= 1.5 * best]
        nearest = min(equal, key=lambda fit: abs(wrap(fit.pose.theta - heading)))
        return nearest._replace(orientations=len(equal) * self._symmetry, doubt=self._doubt(nearest))

    def _doubt(self, fit: Sighting) -> str:
        """By how much an object that fits looks too large or too small, in words; empty if it does not."""
        if fit.size is None or abs(fit.size - 1) < EXACT:
            return ""
        expected = _sides(self._outline.vertices)
        return self._wrong_size(fit.size, expected * fit.size, expected)

    def _blob(self, image: Image) -> tuple[Array, float]:
        """Outline (m, 2) [m] of the one bright blob of the object's size, and the contrast of the frame [grey levels]."""
        shrunk = image
        # Averaging pixels suppresses the noise; halving several times is far faster than one large step.
        for _ in range(self._shrinking.bit_length() - 1):
            rows, columns = shrunk.shape
            shrunk = cv2.resize(shrunk[: rows & ~1, : columns & ~1], (columns // 2, rows // 2), interpolation=cv2.INTER_AREA)
        darkest, brightest, _, _ = cv2.minMaxLoc(shrunk)
        if darkest >= SATURATED or brightest == 0:
            raise NotSeen("saturated or empty frame")
        method = cv2.THRESH_OTSU if self._threshold is None else cv2.THRESH_BINARY
        _, bright = cv2.threshold(shrunk, self._threshold or 0, 255, method)
        table_level, object_level = cv2.mean(shrunk, ~bright)[0], cv2.mean(shrunk, bright)[0]
        if table_level >= SATURATED:
            raise NotSeen("saturated or empty frame")
        contrast = object_level - table_level
        if min(contrast, brightest - darkest) < MIN_CONTRAST:
            raise NotSeen(NO_OBJECT)

        full_area = self._outline.polygon.area
        speck = SPECK_AREA * full_area / (self._pixel * self._shrinking) ** 2
        whole, partial, misshapen = [], False, None
        for contour in cv2.findContours(bright, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]:
            if cv2.contourArea(contour) < speck:
                continue
            if touches_border(contour, shrunk.shape):
                partial = True
                continue
            corners = cv2.approxPolyDP(contour, 0.7, True).reshape(-1, 2)
            blob = self._camera.unproject((corners + 0.5) * self._shrinking - 0.5, self._height)
            # the contour runs through the centres of the outermost pixels
            rim = 0.5 * self._pixel * self._shrinking * cv2.arcLength(blob.astype(np.float32), True)
            if AREA_RANGE[0] <= (abs(_signed_area(blob)) + rim) / full_area <= AREA_RANGE[1]:
                whole.append(blob)
            else:
                misshapen = blob
        if len(whole) > 1:
            raise NotSeen("two candidates")
        if not whole:
            if partial or misshapen is None:
                raise NotSeen("partial view" if partial else NO_OBJECT)
            raise NotSeen(f"outline does not fit: {self._misfit(image, misshapen)}")
        return whole[0], contrast

    def _misfit(self, image: Image, blob: Array) -> str:
        """How a blob (m, 2) [m] differs from the outline in size, and why that may be, in words."""
        larger = math.sqrt(self._bright_area(image, blob) / self._outline.polygon.area)
        # the blob's contour runs through the centres of its outermost coarse pixels
        grown = shapely.Polygon(blob).buffer(0.5 * self._pixel * self._shrinking, join_style="mitre")
        rim = np.asarray((grown if grown.geom_type == "Polygon" else grown.convex_hull).exterior.coords[:-1])
        expected = _sides(self._outline.vertices)
        alike = max(ALIKE, self._pixel * self._shrinking / expected.min())
        same_shape = abs(_slenderness(rim) / _slenderness(self._outline.vertices) - 1) < alike
        seen = expected * larger if same_shape else _sides(rim)
        sizes = _sizes(seen, expected)
        if not same_shape or abs(larger - 1) > MISTAKEN:
            return f"{sizes}; is it this object, alone, and without a shadow or reflection at its edge?"
        if abs(larger - 1) < EXACT:
            return f"{sizes}; is it this object, of this shape, the right side up, and sharp?"
        return self._wrong_size(larger, seen, expected)

    def _wrong_size(self, larger: float, seen: Array, expected: Array) -> str:
        """Why an object may look larger than its outline by a factor, with these sides and not the expected ones (2,) [m]."""
        # the apparent size is inversely proportional to the distance from the camera
        ground = self._camera.metres_per_pixel(0.0)
        height = RISE * (ground - self._pixel / larger) / (ground - self._camera.metres_per_pixel(RISE))
        cause = "its size in the object's file"
        if height > -0.001:
            cause += f", or its height: it would fit {height * 1e3:.1f} mm over the table, not {self._height * 1e3:.1f} mm"
        by = f"{abs(larger - 1) * 100:.1f} % too {'large' if larger > 1 else 'small'}"
        return f"{_sizes(seen, expected)}: {by}; check {cause}"

    def _bright_area(self, image: Image, blob: Array) -> float:
        """The area [m^2] of a blob (m, 2) [m], from its grey levels: exact to a fraction of a pixel, whatever the blur."""
        corners = self._camera.project(blob, self._height)
        margin = 4 * self._shrinking
        low = np.maximum(np.floor(corners.min(axis=0)).astype(int) - margin, 0)
        high = np.ceil(corners.max(axis=0)).astype(int) + margin + 1
        part = image[low[1] : high[1], low[0] : high[0]]
        mask = cv2.fillPoly(np.zeros(part.shape, np.uint8), [np.rint(corners - low).astype(np.int32)], 1)
        inside = cv2.erode(mask, np.ones((2 * margin // 2 + 1,) * 2, np.uint8))
        around = cv2.dilate(mask, np.ones((margin + 1,) * 2, np.uint8))
        table = float(np.median(part[around == 0])) if (around == 0).any() else float(part.min())
        bright = float(np.median(part[inside > 0])) if inside.any() else float(part.max())
        share = (part[around > 0].astype(float) - table) / max(bright - table, 1.0)
        return max(float(share.sum()), 0.0) * self._pixel**2  # beside something brighter, it is negative

    def _coarse_poses(self, blob: Array, heading: float) -> list[Pose]:
        """Poses in which the outline matches a blob's (m, 2) about equally well, one for each orientation that looks different.

        Among orientations in which a symmetric outline looks the same, the one nearest to `heading` [rad] is taken.
        """
        samples = _boundary_samples(blob)
        squared, correlation = self._matches(samples)
        # For a symmetric outline, further shifts only repeat these.
        squared = squared[: _COARSE_SAMPLES // self._symmetry]
        around = np.concatenate((squared[-1:], squared, squared[:1]))
        lowest = (squared <= around[:-2]) & (squared < around[2:])
        lowest &= squared <= (math.sqrt(max(squared.min(), 0.0)) + self._shrinking * self._pixel) ** 2
        middle, step = samples.mean(), 2 * np.pi / self._symmetry
        poses = []
        for found in np.angle(correlation[np.flatnonzero(lowest)]).tolist():
            theta = found + step * round(wrap(heading - found) / step)
            origin = middle - cmath.rect(1.0, theta) * self._boundary_mean
            poses.append(Pose(float(origin.real), float(origin.imag), theta))
        return poses

    def _matches(self, samples: npt.NDArray[np.complex128]) -> tuple[Array, npt.NDArray[np.complex128]]:
        """How well the rotated outline matches other boundary samples, for each shift along the boundary.

        The best rotation of one set of points to another is the phase of their complex correlation. One Fourier transform
        gives it for all shifts.

        Returns:
            (n,) mean squared misfit [m^2] and (n,) the correlation.
        """
        centred = samples - samples.mean()
        correlation = np.fft.ifft(np.fft.fft(centred) * self._boundary_spectrum)
        return _spread(centred) + self._spread - 2 * np.abs(correlation), correlation


def _sides(polygon: Array) -> Array:
    """Length and width of the smallest rectangle around a polygon (m, 2), (2,), the longer one first."""
    _, sides, _ = cv2.minAreaRect(polygon.astype(np.float32))
    return np.sort(np.asarray(sides))[::-1]


def _slenderness(polygon: Array) -> float:
    """Ratio of the principal radii of gyration of a polygon (m, 2)."""
    scale = float(np.ptp(polygon, axis=0).max())
    moments = cv2.moments((polygon / scale).astype(np.float32))
    least, greatest = np.linalg.eigvalsh([[moments["mu20"], moments["mu11"]], [moments["mu11"], moments["mu02"]]])
    return float(math.sqrt(greatest / least))


def _sizes(seen: Array, expected: Array) -> str:
    return f"it looks {_millimetres(seen)} mm, the outline is {_millimetres(expected)} mm"


def _millimetres(sides: Array) -> str:
    return " x ".join(f"{side * 1e3:.1f}" for side in sides)


def _spread(centred: npt.NDArray[np.complex128]) -> float:
    """Mean square of deviations."""
    return float(np.vdot(centred, centred).real) / len(centred)


def _boundary_samples(polygon: Array) -> npt.NDArray[np.complex128]:
    """Points x + iy, evenly spaced along a polygon's (m, 2) boundary, counter-clockwise."""
    corners = polygon[:, 0] + 1j * polygon[:, 1]
    if _signed_area(polygon) < 0:
        corners = corners[::-1]
    closed = np.append(corners, corners[0])
    length = np.concatenate(((0.0,), np.cumsum(np.abs(np.diff(closed)))))
    return np.asarray(np.interp(np.arange(_COARSE_SAMPLES) * (length[-1] / _COARSE_SAMPLES), length, closed))


def _signed_area(polygon: Array) -> float:
    return float(cv2.contourArea(polygon.astype(np.float32), oriented=True))


def touches_border(contour: npt.NDArray[np.int32], shape: tuple[int, ...]) -> bool:
    """Whether a contour (n, 1, 2) in whole pixels reaches the border of an image of this shape."""
    left, top, width, height = cv2.boundingRect(contour)
    return bool(left == 0 or top == 0 or left + width == shape[1] or top + height == shape[0])
