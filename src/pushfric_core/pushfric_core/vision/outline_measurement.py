"""Measures the outline of an object that lies alone in a picture.

A flat face looks exactly like a smaller face nearer to the camera: the two differ by a scaling about the camera's foot on the
table, wherever the object lies and however it is turned. So a picture says nothing about the height; it must be known.
"""

import itertools
import math

import cv2
import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, Pose, cross
from pushfric_core.vision.camera import Camera, Image
from pushfric_core.vision.contour_tracker import touches_border
from pushfric_core.vision.edge_fit import MIN_CONTRAST, REACH_PX, EdgeFit, edge_samples
from pushfric_core.vision.sighting import NotSeen

LEAST_AREA_PX = 400.0
"""A bright blob smaller than this is not an object [px^2]."""
OTHER_OBJECT = 0.3
"""If a second blob has this share of the area of the largest, either may be the object."""

_CORNER_PX = 1.5  # a contour that stays this near to a straight line follows it
_STRAIGHT = math.radians(4.0)  # edges whose directions differ by less are one
_CUT_PX = 3.5  # an edge beyond which its neighbours meet within this cuts off a corner that blur has rounded
_SHARPEST = math.radians(150.0)  # turn at such a corner
_SHORT_PX = 5.0  # an edge shorter than this belongs to a corner
_SAMPLES = 240  # around the outline
_ROUNDS = 6  # of fitting lines where the last ones were
_SETTLED_PX = 0.02
_OUTLIER_PX = 0.3  # a sample this near to the line of its edge is never left out


def measured_outline(camera: Camera, image: Image, height: float) -> Array:
    """The corners (n, 2) of the one bright object in an image, counter-clockwise, in the table frame [m].

    Lines are fitted to its edges. The area under the grey levels across an edge gives its position, whatever the blur. A curved
    outline becomes a polygon that stays within a pixel or two of it.

    Args:
        camera: lens and table.
        image: of the camera's size.
        height: of the object's face over the table [m].
    Raises:
        NotSeen: there is not exactly one such object, it is not sharp enough, or too thin or ragged.
    """
    pixel = camera.metres_per_pixel()
    contour = camera.unproject(_blob(image)[:, 0].astype(float))
    about = contour.mean(axis=0)  # single precision keeps more digits of small numbers
    rough = cv2.approxPolyDP((contour - about).astype(np.float32), _CORNER_PX * pixel, True).reshape(-1, 2) + about
    outline = _polygon(_simple(rough.astype(float), pixel))
    for _ in range(_ROUNDS):
        before, outline = outline, _refined(camera, image, outline, pixel)
        moved = outline.vertices - before.vertices if len(outline.vertices) == len(before.vertices) else np.inf
        if np.abs(moved).max() < _SETTLED_PX * pixel:
            break
    return camera.lifted(outline.vertices, height)


def _blob(image: Image) -> npt.NDArray[np.int32]:
    """The contour (n, 1, 2) of the one bright object, in whole pixels."""
    darkest, brightest, _, _ = cv2.minMaxLoc(image)
    _, bright = cv2.threshold(cv2.GaussianBlur(image, (0, 0), 1.0), 0, 255, cv2.THRESH_OTSU)
    if brightest - darkest < MIN_CONTRAST or not bright.any() or bright.all():
        raise NotSeen("no object: nothing is brighter than the table")
    contours = sorted(cv2.findContours(bright, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0], key=cv2.contourArea)
    areas = [cv2.contourArea(contour) for contour in contours]
    if areas[-1] < LEAST_AREA_PX:
        raise NotSeen("no object: only specks are brighter than the table")
    if len(areas) > 1 and areas[-2] > OTHER_OBJECT * areas[-1]:
        raise NotSeen("two bright objects")
    largest = contours[-1]
    if touches_border(largest, image.shape):
        raise NotSeen("the object leaves the picture")
    return np.asarray(largest, dtype=np.int32)


def _polygon(corners: Array) -> Outline:
    """The outline with these corners (n, 2).

    Raises:
        NotSeen: it crosses itself, or has no area.
    """
    try:
        return Outline(corners)
    except ValueError as error:
        raise NotSeen("the object is too thin or ragged to be measured") from error


def _simple(corners: Array, pixel: float) -> Array:
    """Corners (n, 2) counter-clockwise, without edges that are very short or go straight on."""
    if cross(corners, np.roll(corners, -1, axis=0)).sum() < 0:
        corners = corners[::-1]
    corners = np.array(corners)
    while len(corners) > 3:
        edges = np.roll(corners, -1, axis=0) - corners
        lengths = np.hypot(*edges.T)
        if not lengths.all():
            corners = corners[lengths > 0]
            continue
        turns = np.angle(np.exp(1j * np.diff(_headings(edges), append=_headings(edges[:1]))))  # at the end of each edge
        straight, short = int(np.argmin(np.abs(turns))), int(np.argmin(lengths))
        cut, depth = _shallowest_cut(corners, edges, turns)
        if abs(turns[straight]) < _STRAIGHT:
            corners = np.delete(corners, (straight + 1) % len(corners), axis=0)
        elif depth < _CUT_PX * pixel:  # blur rounds a corner: its neighbouring edges meet beyond it
            before, after = cut - 1, (cut + 1) % len(corners)
            corners[cut] = _meeting(corners[before], edges[before], corners[after], edges[after])
            corners = np.delete(corners, after, axis=0)
        elif lengths[short] < _SHORT_PX * pixel:
            after = (short + 1) % len(corners)
            corners[short] = (corners[short] + corners[after]) / 2
            corners = np.delete(corners, after, axis=0)
        else:
            break
    return corners


def _shallowest_cut(corners: Array, edges: Array, turns: Array) -> tuple[int, float]:
    """The edge that cuts off the least of a corner: its index, and how far beyond it its neighbours meet [m]."""
    depths = np.full(len(corners), np.inf)
    for edge, whole in enumerate(turns + np.roll(turns, 1)):
        before, after = edge - 1, (edge + 1) % len(corners)
        if turns[edge] * turns[before] > 0 and abs(whole) < _SHARPEST:
            tip = _meeting(corners[before], edges[before], corners[after], edges[after])
            depths[edge] = abs(float(cross(edges[edge], tip - corners[edge]))) / float(np.hypot(*edges[edge]))
    least = int(np.argmin(depths))
    return least, float(depths[least])


def _meeting(point: Array, along: Array, other: Array, its: Array) -> Array:
    """Where two lines meet, each through a point (2,) along a vector (2,)."""
    return np.asarray(point + along * (cross(other - point, its) / cross(along, its)))


def _refined(camera: Camera, image: Image, outline: Outline, pixel: float) -> Outline:
    """The outline whose corners are where lines through the edges' samples meet."""
    reach, slack = REACH_PX[0], 2
    points, normals = edge_samples(outline, (reach + slack) * pixel, _SAMPLES)
    if not len(points):
        raise NotSeen("the object is too small or thin to be measured")
    offsets = EdgeFit(camera, points, normals, 0.0, reach, slack).offsets(image, Pose(0.0, 0.0, 0.0))
    moved = points + offsets[:, None] * normals
    lines = []
    for edge, normal in enumerate(outline.normals):
        own = moved[np.isfinite(offsets) & (np.abs(normals - normal).max(axis=1) < 1e-9)]
        middle = outline.vertices[edge] + outline.edges[edge] / 2
        lines.append(_line(own, middle, normal, pixel))
    pairs = itertools.pairwise([lines[-1], *lines])
    meeting = [np.linalg.solve(np.array((n, m)), np.array((n @ p, m @ q))) for (p, n), (q, m) in pairs]
    return _polygon(_simple(np.array(meeting), pixel))


def _line(points: Array, middle: Array, normal: Array, pixel: float) -> tuple[Array, Array]:
    """A point on the line through the samples (k, 2) of an edge, and its unit normal; of fewer than two, the edge as it was."""
    used = points
    while len(used) >= 2:
        about = used.mean(axis=0)
        _, _, axes = np.linalg.svd(used - about)
        across = axes[1] * np.sign(axes[1] @ normal)
        off = np.abs((used - about) @ across)
        near = off <= max(_OUTLIER_PX * pixel, 4 * float(np.median(off)))
        if near.all():
            return about, across
        used = used[near]
    return (used.mean(axis=0) if len(used) else middle), normal


def _headings(edges: Array) -> Array:
    return np.arctan2(edges[:, 1], edges[:, 0])
