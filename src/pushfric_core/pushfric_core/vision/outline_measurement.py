"""Measures an object that lies still on the table: its outline; and its height, from two places of known distance.

A flat face looks exactly like a smaller face nearer to the camera: the two differ by a scaling about the camera's foot on the
table, wherever the object lies and however it is turned. So pictures of unknown places say nothing about the height; only a
known length does. Here, this is the distance by which the object was moved.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from pushfric_core.errors import InvalidInput
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, Pose, cross, transform, wrap
from pushfric_core.vision.camera import Camera, Image, check_size
from pushfric_core.vision.edge_fit import MIN_CONTRAST, REACH_PX, EdgeFit, edge_samples
from pushfric_core.vision.frame_source import Frames
from pushfric_core.vision.sighting import NotSeen

STILL_FRAMES = 5
"""An object that rests for this many frames is measured in the mean of these frames."""
STILL_PX = 0.5
"""From one frame to the next, the middle of an object at rest moves less than this."""
NEW_PLACE_PX = 20.0
"""An object that has moved by less than this is still in the same place."""
LEAST_AREA_PX = 400.0
"""A bright blob smaller than this is not an object [px^2]."""
OTHER_OBJECT = 0.3
"""If a second blob has this share of the area of the largest, either may be the object."""
SYMMETRIC = 0.01
"""Two ways to match a shape are equally good if their errors differ by less than this share of its size."""
OTHER_SHAPE = 0.1
"""Shapes whose corners lie farther apart (rms) than this share of their size are different."""
MOST_TURNED = math.radians(1.0)
"""An object that is slid along a ruler turns by less than this [rad]."""

_CORNER_PX = 1.5  # a contour that stays this near to a straight line follows it
_STRAIGHT = math.radians(4.0)  # edges whose directions differ by less are one
_CUT_PX = 3.5  # an edge beyond which its neighbours meet within this cuts off a corner that blur has rounded
_SHARPEST = math.radians(150.0)  # turn at such a corner
_SHORT_PX = 5.0  # an edge shorter than this belongs to a corner
_SAMPLES = 240  # around the outline
_ROUNDS = 6  # of fitting lines where the last ones were
_SETTLED_PX = 0.02
_OUTLIER_PX = 0.3  # a sample this near to the line of its edge is never left out
_RISE = 0.01  # the apparent length is a linear function of the height: this far apart it is evaluated [m]


class Place(NamedTuple):
    """The object as it lies in one place."""

    corners: Array  # (n, 2) counter-clockwise, as if the face lay on the table [m]
    image: Image  # the image in which it was measured

    @property
    def middle(self) -> Array:
        """The centroid of the face (2,) [m]."""
        return centroid(self.corners)


class Measured(NamedTuple):
    """An object as the pictures show it."""

    outline: Outline  # about its centroid, x along its longest edge
    poses: tuple[Pose, ...]  # of that frame in the table frame, in each place
    spread: float  # rms distance of corresponding corners in different places, after the best motion [m]


def places_from(
    source: Frames, camera: Camera, wanted: int, progress: Callable[[str], None], threshold: float | None = None
) -> list[Place]:
    """The places in which an object lies still in the frames of a source.

    A camera is read until there are as many places as wanted; a video or a folder of pictures is read to its end.

    Args:
        source: not opened yet.
        camera: lens and table.
        wanted: at least 1.
        progress: called with a line of text for each place, and whenever the reason why no place was found yet changes.
        threshold: grey level between table and object; None: found in each frame (Otsu).
    Raises:
        InvalidInput: an image does not have the camera's size, or there are too few places.
    """
    found: list[Place] = []
    resting: list[tuple[Array, Image]] = []  # middle of the blob [px] and frame
    reason, frames = "no frame", 0
    with source:
        for frame in source:
            frames += 1
            check_size(frame, camera, source.name)
            before = reason
            try:
                middle = np.mean(_blob(frame, threshold)[:, 0], axis=0)
                if resting and np.hypot(*(middle - resting[-1][0])) > STILL_PX:
                    resting.clear()
                resting.append((middle, frame))
                if len(resting) < (1 if source.pictures else STILL_FRAMES):
                    continue
                still = np.mean([one for _, one in resting], axis=0)
                resting.clear()
                place = measured_place(camera, np.rint(still).astype(np.uint8), threshold)
            except NotSeen as error:
                resting.clear()
                reason = str(error)
                if source.pictures or reason != before:
                    progress(f"picture {frames}: {reason}" if source.pictures else reason)
                continue
            far = NEW_PLACE_PX * camera.metres_per_pixel()
            if any(np.hypot(*(place.middle - other.middle)) < far for other in found):
                continue
            found.append(place)
            x, y = 1e3 * place.middle
            progress(f"place {len(found)}: {len(place.corners)} corners, about ({x:.0f}, {y:.0f}) mm")
            if source.live and len(found) == wanted:
                return found
    if len(found) < wanted:
        raise InvalidInput(f"{source.name}: {len(found)} places of the object, expected {wanted}; the last reason: {reason}")
    return found


def measured_place(camera: Camera, image: Image, threshold: float | None = None) -> Place:
    """The outline of the one bright object in an image, as if it lay on the table.

    Lines are fitted to its edges. The area under the grey levels across an edge gives its position, whatever the blur. A curved
    outline becomes a polygon that stays within a pixel or two of it.

    Raises:
        NotSeen: there is not exactly one such object, it is not sharp enough, or too thin or ragged.
    """
    pixel = camera.metres_per_pixel()
    contour = camera.unproject(_blob(image, threshold)[:, 0].astype(float))
    about = contour.mean(axis=0)  # single precision keeps more digits of small numbers
    rough = cv2.approxPolyDP((contour - about).astype(np.float32), _CORNER_PX * pixel, True).reshape(-1, 2) + about
    outline = _polygon(_simple(rough.astype(float), pixel))
    for _ in range(_ROUNDS):
        before, outline = outline, _refined(camera, image, outline, pixel)
        moved = outline.vertices - before.vertices if len(outline.vertices) == len(before.vertices) else np.inf
        if np.abs(moved).max() < _SETTLED_PX * pixel:
            break
    return Place(outline.vertices, image)


def height_of(camera: Camera, places: Sequence[Place], moved: float) -> float:
    """The height of the face over the table [m], at which the object was moved by the given distance.

    Args:
        camera: lens and table.
        places: two.
        moved: the distance by which the object was slid from one place to the other, along a straight line [m].
    Raises:
        InvalidInput: the object was turned, or no height fits.
    """
    _check_alike([place.corners for place in places])
    motions = _alignments(*(place.corners for place in places))
    alike = min(motion.rms for motion in motions) + SYMMETRIC * float(np.ptp(places[0].corners, axis=0).max())
    turned = min(abs(wrap(motion.pose.theta)) for motion in motions if motion.rms <= alike)
    if turned > MOST_TURNED:
        angle = f"{math.degrees(turned):.1f} degrees"
        raise InvalidInput(f"the object was turned by {angle} from the first place to the second: slide it along a ruler")
    flat, risen = (
        float(np.hypot(*np.diff(camera.lifted([place.middle for place in places], h), axis=0)[0])) for h in (0.0, _RISE)
    )
    height = _RISE * (flat - moved) / (flat - risen)
    eye = camera.pose()[0][2]
    if not -0.05 * eye < height < 0.5 * eye:
        raise InvalidInput(
            f"the object seems to have moved by {1e3 * flat:.1f} mm, not {1e3 * moved:.1f} mm: no height explains that"
        )
    return height


def measured_object(camera: Camera, places: Sequence[Place], height: float) -> Measured:
    """The outline at a height, averaged over the places.

    Args:
        places: at least one.
        height: of the face over the table [m].
    Raises:
        InvalidInput: the places show different outlines.
    """
    shapes = [camera.lifted(place.corners, height) for place in places]
    _check_alike(shapes)
    edges = np.roll(shapes[0], -1, axis=0) - shapes[0]
    along = edges[np.argmax(np.hypot(*edges.T))]
    x, y = centroid(shapes[0])
    frame = Pose(float(x), float(y), math.atan2(along[1], along[0]))
    own = [_into(frame, shapes[0])]
    poses = [frame]
    for shape in shapes[1:]:
        best = _best_alignment(own[0], shape)
        own.append(_into(best.pose, np.roll(shape, -best.shift, axis=0)))
        poses.append(best.pose)
    mean = np.mean(own, axis=0)
    spread = math.sqrt(float(np.mean(np.sum((np.array(own) - mean) ** 2, axis=2)))) if len(own) > 1 else 0.0
    return Measured(Outline(mean), tuple(poses), spread)


def fitting_height(camera: Camera, places: Sequence[Place], outline: Outline) -> float:
    """The height over the table at which the object, as the camera saw it, has the size of an outline [m]."""
    flat, risen = (
        float(np.mean([math.sqrt(Outline(camera.lifted(place.corners, h)).polygon.area) for place in places]))
        for h in (0.0, _RISE)
    )
    return _RISE * (flat - math.sqrt(outline.polygon.area)) / (flat - risen)


def pose_of(camera: Camera, place: Place, outline: Outline, height: float) -> Pose:
    """Where a measured object lies in one of its places, by its outline at a height [m]."""
    return _best_alignment(outline.vertices, camera.lifted(place.corners, height)).pose


def in_frame_of(outline: Outline, known: Outline) -> tuple[Outline, float] | None:
    """An outline in the frame of a known one of the same shape, its corners in the same order, and how much larger that is.

    Returns:
        The outline, and the known size divided by it; None if the shapes differ.
    """
    larger = math.sqrt(known.polygon.area / outline.polygon.area)
    if len(known.vertices) != len(outline.vertices):
        return None
    best = _best_alignment(known.vertices, outline.vertices * larger)
    if best.rms > OTHER_SHAPE * math.sqrt(known.polygon.area):
        return None
    # the frame's origin keeps its place on the object
    turned = transform(Pose(0.0, 0.0, -best.pose.theta), np.roll(outline.vertices, -best.shift, axis=0))
    return Outline(turned - centroid(turned) + centroid(known.vertices) / larger), larger


def centroid(corners: Array) -> Array:
    """The centroid (2,) of a polygon (n, 2)."""
    a, b = corners - corners[0], np.roll(corners, -1, axis=0) - corners[0]
    areas = cross(a, b)
    return np.asarray(corners[0] + (areas @ (a + b)) / (3 * areas.sum()))


def _blob(image: Image, threshold: float | None) -> npt.NDArray[np.int32]:
    """The contour (n, 1, 2) of the one bright object, in whole pixels."""
    darkest, brightest, _, _ = cv2.minMaxLoc(image)
    method = cv2.THRESH_OTSU if threshold is None else cv2.THRESH_BINARY
    _, bright = cv2.threshold(cv2.GaussianBlur(image, (0, 0), 1.0), threshold or 0, 255, method)
    if brightest - darkest < MIN_CONTRAST or not bright.any() or bright.all():
        raise NotSeen("no object: nothing is brighter than the table")
    contours = sorted(cv2.findContours(bright, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0], key=cv2.contourArea)
    areas = [cv2.contourArea(contour) for contour in contours]
    if areas[-1] < LEAST_AREA_PX:
        raise NotSeen("no object: only specks are brighter than the table")
    if len(areas) > 1 and areas[-2] > OTHER_OBJECT * areas[-1]:
        raise NotSeen("two bright objects")
    largest = contours[-1]
    left, top, width, height = cv2.boundingRect(largest)
    if left == 0 or top == 0 or left + width == image.shape[1] or top + height == image.shape[0]:
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
    meeting = []
    for before, after in zip(np.roll(np.arange(len(lines)), 1), range(len(lines)), strict=True):
        (p, n), (q, m) = lines[before], lines[after]
        meeting.append(np.linalg.solve(np.array((n, m)), np.array((n @ p, m @ q))))
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


def _into(pose: Pose, points: Array) -> Array:
    """Points of the table in the frame at `pose`."""
    return transform(Pose(0.0, 0.0, -pose.theta), points - (pose.x, pose.y))


class _Alignment(NamedTuple):
    pose: Pose  # takes the one shape nearest to the other
    rms: float  # distance that remains [m]
    shift: int  # the other's corners come later by this many places


def _alignments(shape: Array, other: Array) -> list[_Alignment]:
    """The motions that take corners (n, 2) nearest to other ones, for each way in which they may correspond."""
    made = []
    for shift in range(len(shape)):
        there = np.roll(other, -shift, axis=0)
        a, b = shape - shape.mean(axis=0), there - there.mean(axis=0)
        theta = math.atan2(float(cross(a, b).sum()), float((a * b).sum()))
        x, y = there.mean(axis=0) - transform(Pose(0.0, 0.0, theta), shape.mean(axis=0))
        pose = Pose(float(x), float(y), theta)
        made.append(_Alignment(pose, math.sqrt(float(np.mean(np.sum((transform(pose, shape) - there) ** 2, axis=1)))), shift))
    return made


def _best_alignment(shape: Array, other: Array) -> _Alignment:
    return min(_alignments(shape, other), key=lambda motion: motion.rms)


def _check_alike(shapes: Sequence[Array]) -> None:
    """Raises InvalidInput if some have more corners than others, or corners elsewhere."""
    hint = "is it the same object, sharp, and without shadows or reflections at its edge?"
    counts = sorted({len(shape) for shape in shapes})
    if len(counts) > 1:
        raise InvalidInput(f"the object does not look the same everywhere: {counts[0]} and {counts[-1]} corners; {hint}")
    size = float(np.ptp(shapes[0], axis=0).max())
    apart = max((_best_alignment(shapes[0], shape).rms for shape in shapes[1:]), default=0.0)
    if apart > OTHER_SHAPE * size:
        raise InvalidInput(f"the object does not look the same everywhere: its corners are {1e3 * apart:.1f} mm apart; {hint}")
