"""Fits the pose of a flat pattern of straight edges, each bright on one side, to an image, to a few hundredths of a pixel."""

import math
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, Pose, cross, rotation, transform, wrap
from pushfric_core.vision.camera import Camera, Image
from pushfric_core.vision.sighting import Sighting

MIN_CONTRAST = 30.0
"""Least difference between the bright and the dark side [grey levels]."""
SATURATED = 200.0
"""A dark side brighter than this is overexposed [grey levels]."""
MIN_VISIBLE = 0.7
"""At least this fraction of the edges must be found."""
MIN_PROOF = 0.2
"""For any stretch or shear of the object, at least this share of the edges that would show it must be found."""
MAX_RESIDUAL_PX = 0.7
"""Edges that fit worse than this (rms) do not belong to the object."""

REACH_PX = (4, 6)
"""Least and greatest distance to either side of an edge within which grey levels are used; a larger one tolerates more blur."""
_PER_PIXEL = 2  # samples of a profile
_LEVEL_PX = 3  # length at each end of a profile that gives the grey level there
_EDGE_PX = 3  # a profile is summed up over this length to either side of its middle
_BLUR_PX = 0.5  # an edge this close to the middle of its window leaves clear samples at both ends
_OUTLIER_PX = 0.4  # an edge closer to its place than this is never rejected
_OUTLIER_MEDIANS = 5.2  # 3.5 sigma
_RESAMPLING_PX = 0.03  # error of an edge sample in a frame without noise
_MIN_INFORMATION = 0.05  # determinant over that of all edges; 0 if the edges leave a direction free
_NEAR_PX = 1.5  # an edge counts as visible if it is this close to its place
_MAX_STEPS = 6
_MIN_EDGE_CONTRAST = 0.35  # of the frame's contrast; an edge with less is hidden, not shaded
_MAX_UNEVENNESS = 0.1  # of the contrast, at the ends of a profile; a profile with more shows the border of a shadow


class EdgeFit:
    """Fits the edges of one object, sampled at points.

    Args:
        camera: lens and table.
        points: (n, 2) on the edges, object frame [m].
        normals: (n, 2) unit, across the edges from the bright side to the dark one.
        height: of the edges over the table [m].
        reach_px: distance to either side of an edge within which there is no other edge.
        slack_px: error of the first pose from which one step still finds the edges.
    """

    def __init__(self, camera: Camera, points: Array, normals: Array, height: float, reach_px: int, slack_px: int = 2) -> None:
        self._camera, self._height = camera, height
        self._pixel = camera.metres_per_pixel(height)
        self._slack = slack_px
        length = reach_px + slack_px
        self._whole = _averages(length, length)
        self._near = _averages(reach_px, min(reach_px, _EDGE_PX))
        self._places = np.vstack([points + way * length * self._pixel * normals for way in (-1, 0, 1)])
        way = np.linspace(-1, 1, 2 * length * _PER_PIXEL + 1, dtype=np.float32)
        # a parabola through three places, because perspective and lens bend a straight line and its even steps
        self._blend: npt.NDArray[np.float32] = np.stack((way * (way - 1) / 2, 1 - way**2, way * (way + 1) / 2), axis=1)
        self._columns = np.arange(len(points))
        self._rows = np.arange(2 * reach_px * _PER_PIXEL + 1)[:, None] + slack_px * _PER_PIXEL
        # How far each point moves along its normal per unit of a body motion (x, y, theta) [px].
        self._motion = np.column_stack((normals, cross(points, normals))) / self._pixel
        self._min_information = _MIN_INFORMATION * float(np.linalg.det(self._motion.T @ self._motion))
        self._stretches = _whitened(np.column_stack((normals, *(normals.T[:, None] * points.T).reshape(4, -1))))
        sized = np.column_stack((self._motion, np.sum(normals * points, axis=1) / self._pixel))
        self._sizing = np.linalg.pinv(sized)[3]  # distances of all points [px] -> by how much the object is larger

    def refined(self, image: Image, pose: Pose, contrast: float) -> Sighting | None:
        """A pose in the table frame, refined by least squares; None if the edges do not fit.

        Args:
            image: (height, width) mono8 frame.
            pose: where to start, wrong by at most about `slack_px`.
            contrast: usual difference between the bright and the dark side [grey levels].
        """
        for _ in range(_MAX_STEPS):
            profiles = self._profiles(image, pose)
            # roughly from each whole profile, then more precisely from the window around its edge
            rough = self._solved(_edges(profiles, self._whole), contrast)
            if rough is None:
                return None
            edges = self._edges_near(rough.moved, profiles)
            fit = self._solved(edges, contrast)
            if fit is None:
                return None
            x, y = transform(pose, fit.step[:2])
            pose = Pose(float(x), float(y), wrap(pose.theta + float(fit.step[2])))
            if np.abs(fit.moved).max() < self._slack + _BLUR_PX:
                break
        else:
            return None
        # finally, every edge close to its place counts as visible, and in the residual
        found = fit.residuals < _NEAR_PX
        near = fit.residuals[found]
        visible = len(near) / len(self._motion)
        rms = math.sqrt(near @ near / max(len(near), 1))
        if visible < MIN_VISIBLE or rms > MAX_RESIDUAL_PX or not self._prove(found):
            return None
        turn = np.eye(3)
        turn[:2, :2] = rotation(pose.theta)
        covariance = turn @ fit.spread @ turn.T * max(rms, _RESAMPLING_PX) ** 2
        size = 1 + float(self._sizing @ edges.distances) if found.all() else None
        return Sighting(pose, rms, visible, 1, covariance, size)

    def _prove(self, found: npt.NDArray[np.bool_]) -> bool:
        """Whether the edges found belong to this object, and could not also belong to a longer, wider, smaller or skewed one.

        A triangle of another size, for example, fits at two of its sides, however it is turned.
        """
        if found.all():
            return True
        seen = self._stretches[found]
        return bool(np.linalg.eigvalsh(seen.T @ seen)[0] >= MIN_PROOF)

    def offsets(self, image: Image, pose: Pose) -> Array:
        """How far beyond its place each edge lies, each by itself, at this pose (n,) [m]; NaN where it is not clear.

        Args:
            image: (height, width) mono8 frame.
            pose: in the table frame; edges farther off than `slack_px` and half a reach are not found.
        """
        profiles = self._profiles(image, pose)
        edges = self._edges_near(_edges(profiles, self._whole).distances, profiles)
        clear = (edges.contrasts > max(MIN_CONTRAST, _MIN_EDGE_CONTRAST * float(np.median(edges.contrasts)))) & (
            edges.unevenness < _MAX_UNEVENNESS * edges.contrasts
        )
        return np.where(clear, edges.distances * self._pixel, np.nan)

    def _edges_near(self, distances: Array, profiles: npt.NDArray[np.float32]) -> "_Edges":
        """The edges in the windows of profiles (m, n) around places that are off the middle by distances (n,) [px]."""
        farthest = self._slack * _PER_PIXEL
        shift = np.clip(np.rint(distances * _PER_PIXEL), -farthest, farthest).astype(int)
        edges = _edges(profiles[self._rows + shift, self._columns], self._near)
        return edges._replace(distances=edges.distances + shift / _PER_PIXEL)

    def _profiles(self, image: Image, pose: Pose) -> npt.NDArray[np.float32]:
        """Grey levels (m, n) across each of n edges at `pose`, from its bright side to its dark one."""
        places = self._camera.project(transform(pose, self._places), self._height)
        samples = (self._blend @ places.astype(np.float32).reshape(3, -1)).reshape(len(self._blend), -1, 2)
        return np.asarray(cv2.remap(image, samples, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)

    def _solved(self, edges: "_Edges", contrast: float) -> "_Solution | None":
        """The body motion that explains the distances found best, without edges that disagree with most others."""
        seen = edges.contrasts > _MIN_EDGE_CONTRAST * contrast
        used = seen & (edges.unevenness < _MAX_UNEVENNESS * edges.contrasts)
        while True:
            motion = self._motion[used]
            information = motion.T @ motion
            if cv2.determinant(information) < self._min_information:
                return None
            _, spread = cv2.invert(information)
            step = spread @ (motion.T @ edges.distances[used])
            moved = self._motion @ step
            residuals = np.abs(edges.distances - moved)
            typical = np.partition(residuals, len(residuals) // 2)[len(residuals) // 2]
            trusted = used & (residuals <= max(_OUTLIER_PX, _OUTLIER_MEDIANS * typical))
            if (trusted == used).all():
                return _Solution(step, moved, np.where(seen, residuals, np.inf), spread)
            used = trusted


class _Solution(NamedTuple):
    step: Array  # (3,) body motion [m, m, rad]
    moved: Array  # (n,) by how much it moves the points along their normals [px]
    residuals: Array  # (n,) of the edges [px], infinite without contrast
    spread: Array  # (3, 3) covariance of the step per variance of a distance [1/px^2]


def _whitened(columns: Array) -> Array:
    """Orthonormal columns (n, r) that span those given (n, k), without directions that hardly move anything."""
    basis, sizes, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    return np.asarray(basis[:, sizes > 1e-3 * sizes[0]])


def edge_samples(outline: Outline, clearance: float, samples: int) -> tuple[Array, Array]:
    """Points on an outline and its outward normals there, (n, 2) each.

    Of about `samples` points, evenly spaced, those are kept that have no other edge nearer than `clearance` [m].
    """
    points, normals = [], []
    for start, edge, length, normal in zip(outline.vertices, outline.edges, outline.lengths, outline.normals, strict=True):
        count = int(np.ceil(samples * length / outline.perimeter))
        points.append(start + ((np.arange(count) + 0.5) / count)[:, None] * edge)
        normals.append(np.tile(normal, (count, 1)))
    at, outward = np.concatenate(points), np.concatenate(normals)
    # This edge must be the nearest one at both ends of its profile.
    inside, outside = (outline.distances_to(at + side * clearance * outward) for side in (-1, 1))
    clear = np.minimum(inside, outside) > 0.95 * clearance
    return at[clear], outward[clear]


def _averages(reach_px: int, edge_px: int) -> "_Averages":
    """The averages of profiles that reach +- reach_px and are summed up over +- edge_px around the middle."""
    count, summed = (2 * length * _PER_PIXEL + 1 for length in (reach_px, edge_px))
    levels = min(_LEVEL_PX, reach_px - 2) * _PER_PIXEL + 1
    weights = np.zeros((5, count), np.float32)
    weights[0, :levels] = weights[1, -levels:] = 1 / levels
    trapezoid = np.full(summed, 1 / (summed - 1))
    trapezoid[[0, -1]] /= 2
    weights[2, (count - summed) // 2 : (count + summed) // 2] = trapezoid
    half = levels // 2
    weights[3, :half] = weights[4, -half:] = 1 / half
    weights[3, levels - half : levels] = weights[4, -levels : half - levels] = -1 / half
    return _Averages(weights, edge_px)


def _edges(profiles: npt.NDArray[np.float32], averages: "_Averages") -> "_Edges":
    """The edges in profiles (m, n).

    Whatever the blur, the bright part of a profile ends at the edge. Its share of the length is the mean grey level, on a
    scale from the level of the dark end to that of the bright end. Each profile gives its own levels, because light and
    shadow differ around the object.
    """
    bright, dark, mean, *slopes = (averages.weights @ profiles).astype(float)
    contrasts = bright - dark
    part = (mean - dark) / np.maximum(contrasts, 1.0)
    return _Edges((2 * part - 1) * averages.edge_px, contrasts, np.maximum(*np.abs(slopes)))


class _Edges(NamedTuple):
    distances: Array  # (n,) from the middle of the profile to the dark side [px]
    contrasts: Array  # (n,) [grey levels]
    unevenness: Array  # (n,) change of the grey level within an end of the profile, the larger of both [grey levels]


class _Averages(NamedTuple):
    weights: npt.NDArray[np.float32]  # (5, m): means over both ends and the middle, changes within both ends
    edge_px: int  # half the length of the middle
