"""Sees a bright object on a dark table: its pose, by fitting the known outline to its edge, to a few hundredths of a pixel."""

import math
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
import shapely

from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.outline import Outline
from pushfric_core.planar import Array, Pose, compose, cross, rotation, transform, wrap
from pushfric_ros.camera import Camera, Image

MIN_CONTRAST = 30.0
"""Object and table differ by at least this much [grey levels]."""
SATURATED = 200.0
"""A dark table is never brighter [grey levels]."""
AREA_RANGE = (0.6, 1.6)
"""A blob of this much of the outline's area may be the object."""
SPECK_AREA = 0.1
"""What covers less of the outline's area is ignored."""
MIN_VISIBLE = 0.7
"""At least this part of the outline must be found."""
MAX_RESIDUAL_PX = 0.7
"""An outline that fits worse (rms) is not the object's."""

_SHRUNK_WIDTH_PX = 10  # inradius of the object in the shrunk image that blobs are sought in, at least
_COARSE_SAMPLES = 360  # over the outline; divisible by the orders of symmetry
_SYMMETRIES = (1, 2, 3, 4, 5, 6, 8)
_EDGE_SAMPLES = 80  # over the outline
_FINE_REACH_PX = 4
_LEVEL_SAMPLES = 3  # at each end of a profile: the grey level there
_MIN_EDGE_SAMPLES = 24
_OUTLIER_PX = 0.4  # never rejected closer than this
_OUTLIER_MEDIANS = 5.2  # 3.5 sigma
_RESAMPLING_PX = 0.03  # error of an edge sample in a frame without noise
_MIN_INFORMATION = 0.05  # of the whole outline's (determinant); edges that leave a direction free have none
_NEAR_PX = 1.5  # a visible edge is this close to the outline
_MAX_STEPS = 6
_CONVERGED_PX = 0.5
_MIN_EDGE_CONTRAST = 0.35  # of the frame's; less is a hidden edge, not a shaded one


class NotSeen(PushfricError):
    """No pose can be told from this frame; the text says why."""


class Sighting(NamedTuple):
    """The object as seen in one frame."""

    pose: Pose  # in the table frame
    residual_px: float  # rms distance of the edge found from the outline fitted
    visible_fraction: float  # of the outline
    orientations: int  # how many orientations fit equally well
    covariance: Array  # (3, 3) of (x, y, theta) in the table frame [m, m, rad]


class ContourTracker:
    """Finds one object of known outline.

    Args:
        camera: lens and table.
        outline_vertices: (n, 2) of the object's bright top face, object frame [m].
        height: of that face over the table [m].
        threshold: grey level between table and object; None: found in every frame (Otsu).
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
        self._boundary_spectrum = np.conj(np.fft.fft(self._boundary - self._boundary_mean))
        self._spread = np.mean(np.abs(self._boundary - self._boundary_mean) ** 2)
        misfit, _ = self._matches(self._boundary)
        # k-fold symmetric: shifted by a k-th of its length, the outline matches itself to a fraction of a pixel.
        self._symmetry = max(k for k in _SYMMETRIES if misfit[_COARSE_SAMPLES // k % _COARSE_SAMPLES] < 0.1 * self._pixel)

        # From where the blob puts it, the outline is out by about a pixel of the shrunk image.
        wide_reach_px = max(_FINE_REACH_PX, 2 * self._shrinking)
        points, normals = _edge_samples(self._outline, wide_reach_px * self._pixel)
        if len(points) < _MIN_EDGE_SAMPLES:
            raise InvalidInput(f"the object is too small or thin for the tracker: {2 * inradius:.0f} px wide, 25 px are plenty")
        self._wide = _profiles(points, normals, wide_reach_px, self._pixel)
        self._fine = _profiles(points, normals, _FINE_REACH_PX, self._pixel)
        # How far each point moves along its normal per unit of a body twist.
        self._motion = np.column_stack((normals, cross(points, normals)))
        self._min_information = _MIN_INFORMATION * float(np.linalg.det(self._motion.T @ self._motion))

    @property
    def symmetry(self) -> int:
        """How many orientations of the outline look alike."""
        return self._symmetry

    def track(self, image: Image, expected: Pose | None = None) -> Sighting:
        """The object's pose in one frame.

        Args:
            image: (height, width) mono8 frame, the size of the camera's.
            expected: about where it should be, in the table frame. Of several orientations that fit equally well the
                nearest to it is taken; None: the nearest to 0.
        Raises:
            NotSeen: no object, part of it, more than one, or an outline that does not fit.
            ValueError: the image has another size or type.
        """
        if image.shape != (self._camera.height, self._camera.width) or image.dtype != np.uint8:
            size = (self._camera.height, self._camera.width)
            raise ValueError(f"image must be uint8 of shape {size}, got {image.dtype} of shape {image.shape}")
        blob, contrast = self._blob(image)
        # most often the object is about where it was
        if expected is not None and (fit := self._fit(image, expected, contrast, self._fine)) is not None:
            return fit
        heading = 0.0 if expected is None else expected.theta
        starts = [self._turned_towards(heading, start) for start in self._coarse_poses(blob)]
        fits = [fit for start in starts if (fit := self._fit(image, start, contrast, self._wide)) is not None]
        if not fits:
            raise NotSeen("outline does not fit")
        best = min(fit.residual_px for fit in fits)
        equal = [fit for fit in fits if fit.residual_px <= 1.5 * best]
        nearest = min(equal, key=lambda fit: abs(wrap(fit.pose.theta - heading)))
        return nearest._replace(orientations=len(equal) * self._symmetry)

    def _blob(self, image: Image) -> tuple[Array, float]:
        """Outline (m, 2) of the one bright blob of the object's size [m], and the contrast of the frame [grey levels]."""
        shrunk = image
        # Averaging pixels suppresses the noise; halving repeatedly is far faster than the same in one step.
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
            raise NotSeen("no object")

        full_area = self._outline.polygon.area
        speck = SPECK_AREA * full_area / (self._pixel * self._shrinking) ** 2
        whole, partial, misshapen = [], False, False
        for contour in cv2.findContours(bright, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]:
            if cv2.contourArea(contour) < speck:
                continue
            if _touches_border(contour, shrunk.shape):
                partial = True
                continue
            corners = cv2.approxPolyDP(contour, 0.7, True).reshape(-1, 2)
            blob = self._camera.unproject((corners + 0.5) * self._shrinking - 0.5, self._height)
            # the contour runs through the centres of the outermost pixels
            rim = 0.5 * self._pixel * self._shrinking * cv2.arcLength(blob.astype(np.float32), True)
            if AREA_RANGE[0] <= (abs(_signed_area(blob)) + rim) / full_area <= AREA_RANGE[1]:
                whole.append(blob)
            else:
                misshapen = True
        if len(whole) > 1:
            raise NotSeen("two candidates")
        if not whole:
            raise NotSeen("partial view" if partial else "outline does not fit" if misshapen else "no object")
        return whole[0], contrast

    def _coarse_poses(self, blob: Array) -> list[Pose]:
        """Poses in which the outline matches a blob's (m, 2) about equally well, one per orientation that looks different."""
        samples = _boundary_samples(blob)
        misfit, turn = self._matches(samples)
        # Further shifts repeat those of a symmetric outline.
        misfit = misfit[: _COARSE_SAMPLES // self._symmetry]
        lowest = (misfit <= np.roll(misfit, 1)) & (misfit < np.roll(misfit, -1))
        lowest &= misfit <= misfit.min() + self._shrinking * self._pixel
        poses = []
        for rotor in turn[np.flatnonzero(lowest)]:
            origin = samples.mean() - rotor * self._boundary_mean
            poses.append(Pose(float(origin.real), float(origin.imag), float(np.angle(rotor))))
        return poses

    def _matches(self, samples: npt.NDArray[np.complex128]) -> tuple[Array, npt.NDArray[np.complex128]]:
        """How well the turned outline matches other boundary samples, for each shift along the boundary.

        The best rotation of one set of points to another is the phase of their complex correlation; for all shifts it
        takes one Fourier transform.

        Returns:
            (n,) rms misfit [m] and (n,) the rotation, a complex number of length 1.
        """
        samples = samples - samples.mean()
        correlation = np.fft.ifft(np.fft.fft(samples) * self._boundary_spectrum) / len(samples)
        strength = np.maximum(np.abs(correlation), np.finfo(float).tiny)
        squared = np.mean(np.abs(samples) ** 2) + self._spread - 2 * strength
        return np.sqrt(np.maximum(squared, 0)), correlation / strength

    def _turned_towards(self, heading: float, pose: Pose) -> Pose:
        """Of the poses in which a symmetric outline looks the same, the one nearest to a heading [rad]."""
        step = 2 * np.pi / self._symmetry
        turn = step * round(wrap(heading - pose.theta) / step)
        if turn == 0:
            return pose
        shift = self._boundary_mean * (1 - np.exp(1j * turn))  # the middle stays where it is
        return compose(pose, Pose(float(shift.real), float(shift.imag), turn))

    def _fit(self, image: Image, pose: Pose, contrast: float, profiles: "_Profiles") -> Sighting | None:
        """Refine a pose by least squares on the edge's distances from the outline; None where the outline does not fit.

        The distances are linear in the motion of the body as long as the profiles hold the edge well: one small step
        that rejects nothing is the last.
        """
        used = np.ones(len(self._motion), dtype=bool)
        for _ in range(_MAX_STEPS):
            distances, contrasts = self._edge_distances(image, pose, profiles)
            seen = contrasts > _MIN_EDGE_CONTRAST * contrast
            used &= seen
            motion = self._motion[used]
            information = motion.T @ motion
            if np.linalg.det(information) < self._min_information:
                return None
            spread = np.linalg.inv(information)
            step = spread @ (motion.T @ distances[used])
            moved = self._motion @ step
            residuals = np.abs(distances - moved)
            typical = np.partition(residuals, len(residuals) // 2)[len(residuals) // 2]
            trusted = residuals <= max(_OUTLIER_PX * self._pixel, _OUTLIER_MEDIANS * typical)
            x, y = transform(pose, step[:2])
            pose = Pose(float(x), float(y), wrap(pose.theta + float(step[2])))
            settled = profiles is self._fine and np.abs(moved).max() < _CONVERGED_PX * self._pixel
            if settled and not (used & ~trusted).any():
                break
            used, profiles = trusted, self._fine
        else:
            return None
        # in the end, everything close to the outline counts as seen, and as misfit
        near = residuals[seen & (residuals < _NEAR_PX * self._pixel)]
        visible = len(near) / len(distances)
        rms = math.sqrt(near @ near / max(len(near), 1))
        if visible < MIN_VISIBLE or rms > MAX_RESIDUAL_PX * self._pixel:
            return None
        turn = np.eye(3)
        turn[:2, :2] = rotation(pose.theta)
        covariance = turn @ spread @ turn.T * max(rms, _RESAMPLING_PX * self._pixel) ** 2
        return Sighting(pose, rms / self._pixel, visible, self._symmetry, covariance)

    def _edge_distances(self, image: Image, pose: Pose, profiles: "_Profiles") -> tuple[Array, Array]:
        """Along each normal, how far outside the outline at `pose` the edge lies [m], and its contrast [grey levels].

        The bright part of a profile ends at the edge, whatever the blur: its length is the mean grey level between the
        levels of its two ends. Those are taken from each profile itself, as light and shadow differ around the object.
        """
        ends = self._camera.project(transform(pose, profiles.ends), self._height)
        inner, outer = ends.reshape(2, -1, 1, 2).astype(np.float32)
        places = inner + profiles.steps * (outer - inner)
        grey = cv2.remap(image, places, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32)
        inside, outside, mean = (grey @ profiles.averages).T.astype(float)
        contrasts = inside - outside
        bright = (mean - outside) / np.maximum(contrasts, 1.0)
        return (2 * bright - 1) * profiles.reach, contrasts


class _Profiles(NamedTuple):
    """Where, across the edges, grey levels are sampled, from inside to outside."""

    reach: float  # to either side of the edge [m]
    ends: Array  # (2 n, 2) the inner ends, then the outer ones, object frame [m]
    steps: npt.NDArray[np.float32]  # (m, 1) on the way from the inner end to the outer
    averages: npt.NDArray[np.float32]  # (m, 3) weights of the means over the inner end, the outer end, all of it


def _profiles(points: Array, normals: Array, reach_px: int, pixel: float) -> _Profiles:
    """Profiles of +- `reach_px` across the edges at points (n, 2) with normals (n, 2), a sample per pixel."""
    reach = reach_px * pixel
    count = 2 * reach_px + 1
    averages = np.zeros((count, 3), np.float32)
    averages[:_LEVEL_SAMPLES, 0] = averages[-_LEVEL_SAMPLES:, 1] = 1 / _LEVEL_SAMPLES
    averages[:, 2] = 1 / (count - 1)
    averages[[0, -1], 2] /= 2  # trapezoidal rule
    ends = np.vstack((points - reach * normals, points + reach * normals))
    return _Profiles(reach, ends, np.linspace(0, 1, count, dtype=np.float32)[:, None], averages)


def _edge_samples(outline: Outline, reach: float) -> tuple[Array, Array]:
    """Points on the edges and their outward normals, (n, 2) each, whose profiles of +- reach [m] cross no other edge."""
    points, normals = [], []
    for start, edge, length, normal in zip(outline.vertices, outline.edges, outline.lengths, outline.normals, strict=True):
        count = int(np.ceil(_EDGE_SAMPLES * length / outline.perimeter))
        points.append(start + ((np.arange(count) + 0.5) / count)[:, None] * edge)
        normals.append(np.tile(normal, (count, 1)))
    at, outward = np.concatenate(points), np.concatenate(normals)
    # At both ends of its profile, this edge is the nearest of all.
    clear = [
        all(outline.distance_to(point + side * reach * normal) > 0.95 * reach for side in (-1, 1))
        for point, normal in zip(at, outward, strict=True)
    ]
    return at[clear], outward[clear]


def _boundary_samples(polygon: Array) -> npt.NDArray[np.complex128]:
    """Points x + iy evenly over a polygon's (m, 2) boundary, counter-clockwise."""
    corners = polygon[:, 0] + 1j * polygon[:, 1]
    if _signed_area(polygon) < 0:
        corners = corners[::-1]
    closed = np.append(corners, corners[0])
    length = np.concatenate(((0.0,), np.cumsum(np.abs(np.diff(closed)))))
    return np.interp(np.arange(_COARSE_SAMPLES) * (length[-1] / _COARSE_SAMPLES), length, closed)


def _signed_area(polygon: Array) -> float:
    return float(cv2.contourArea(polygon.astype(np.float32), oriented=True))


def _touches_border(contour: npt.NDArray[np.int32], shape: tuple[int, ...]) -> bool:
    left, top, width, height = cv2.boundingRect(contour)
    return left == 0 or top == 0 or left + width == shape[1] or top + height == shape[0]
