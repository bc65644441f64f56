"""Measures the pushing line from pictures of the tip at known stroke positions, without an object: where it is, and its radius.

The tip may be the round end of a rod or hang from above, and it may be brighter or darker than the table. What has changed
since the picture of the first position ends, in the direction of the stroke, with the round front of the tip.
"""

import math
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import cv2
import numpy as np
from scipy.optimize import least_squares

from pushfric_core.errors import InvalidInput
from pushfric_core.geometry.planar import Array, cross
from pushfric_core.pushers.pusher import StageConfig
from pushfric_core.records import FieldPlace
from pushfric_core.vision.camera import Camera, Image

LEAST_PICTURES = 4
"""Fewer positions would not show errors."""
LEAST_CHANGE = 12.0
"""The tip must differ from the table by this [grey levels]; a strip of paper under a dark tip helps."""
LEAST_STROKE, WHOLE = 4.0, 2.5
"""The first and the last position must be this many radii apart, and pictures this many from the first."""
NOT_ROUND_PX = 0.5
"""A front that deviates from a circle by more than this (rms) is not round."""
LEAST_POINTS, ROUND_SHARE = 6, 0.7
"""Least number of points on a front, and the share of the points ahead of the circle's centre that must lie on the circle."""
NOT_ROUND = "the front of what moves is not round, or too small in the image: expected the tip alone, without an object"
OFF_LINE = 0.5e-3
"""Centres that deviate from a line by more than this (rms) [m] do not move along one."""
HEIGHTS = (-0.002, 0.1)
"""Range of the tip's height over the table [m]; beyond it, the length of the stroke is wrong."""
LINE_ERROR, ANGLE_ERROR, RADIUS_ERROR = 0.3e-3, math.radians(0.2), 0.15e-3
"""A pushing line that differs from the file's by more than this [m, rad] is reported, and a tip's radius [m]."""
SCALE_ERROR = 0.005
"""A stroke that differs from what the controller says by more than this share is reported."""

GREEN, ORANGE = (0, 200, 0), (0, 140, 255)  # BGR

_BLUR_PX = 0.7  # against the noise; it does not move a circle's centre
_NOISE_SHARE = 0.5  # of the change, at which the edge is
_FRONT = 0.35  # of the circle, points this share of the radius before its centre belong to the front
_BAND = 0.25  # and those that are off the circle by less than this share
_ROUNDS = 12


class TipMeasurement(NamedTuple):
    """The tip, and the line it moves on; the names are those of the command's JSON."""

    line_origin: Array  # (2,) centre of the tip at stroke position 0, in the table frame [m]
    line_direction: Array  # (2,) unit, of the forward stroke
    tip_radius: float  # [m]
    tip_height: float  # of the visible part of the tip, over the table [m]
    stroke_scale: float  # the stroke's length as seen at this height, divided by what the controller says
    rms: float  # distance of the tip's centres from the line and from their places on it [m]
    centers: Annotated[Array, FieldPlace(key="")]  # (n, 2) where the tip was seen, as if it were on the table [m]


def measure_tip(
    camera: Camera, positions: Sequence[float], images: Sequence[Image], radius: float, height: float | None = None
) -> TipMeasurement:
    """The pushing line and the tip.

    Args:
        camera: lens and table.
        positions: along the stroke, ascending [m].
        images: one for each position (height, width); only the pusher differs between them.
        radius: approximate radius of the tip, within a factor of two [m].
        height: of the visible part of the tip, over the table [m]; None: from the parallax, which makes the stroke look longer
            than the controller says.
    Raises:
        InvalidInput: there are too few pictures, the tip is not seen well enough, or no line explains what is seen; the text
            says what to do.
    """
    at = np.asarray(positions, dtype=float)
    if len(at) < LEAST_PICTURES or len(images) != len(at) or not (np.diff(at) > 0).all():
        raise InvalidInput(
            f"expected pictures of {LEAST_PICTURES} or more stroke positions, ascending; got {len(images)} of {len(at)}"
        )
    reach = float(np.ptp(at))
    apart = at - at[0] >= WHOLE * radius  # nearer to the first place, the change since then is no whole front
    if not reach >= LEAST_STROKE * radius > 0 or np.count_nonzero(apart) < LEAST_PICTURES - 1:
        raise InvalidInput(
            f"the stroke positions lie within {1e3 * reach:.1f} mm, expected {1e3 * LEAST_STROKE * radius:.1f} mm or more, and"
            f" {LEAST_PICTURES - 1} of them {1e3 * WHOLE * radius:.1f} mm or more from the first;"
            f" the tip's radius is said to be {1e3 * radius:g} mm"
        )
    smooth = [cv2.GaussianBlur(image, (0, 0), _BLUR_PX).astype(float) for image in images]
    first, middle, last = smooth[0], smooth[len(smooth) // 2], smooth[-1]
    ahead = _ahead(camera, middle - first, last - middle)
    circles = [_front(camera, np.abs(one - first), ahead, radius) for one in np.array(smooth)[apart]]
    seen = float(np.median([circle.radius for circle in circles]))
    circles = [circle.with_radius(seen) for circle in circles]
    centers = np.array([circle.center for circle in circles])
    line = _fitted(at[apart], centers)
    # where everything is scaled about the camera's foot, so is the stroke
    if height is None:
        height = _height(camera, line)
        if not HEIGHTS[0] <= height <= HEIGHTS[1]:
            longer = np.hypot(*line.velocity) - 1
            raise InvalidInput(
                f"the stroke looks {100 * abs(longer):.1f} % {'longer' if longer > 0 else 'shorter'} than the controller says,"
                f" as if the tip were {1e3 * height:.0f} mm over the table: check the controller's steps per millimetre"
                " (docs/hardware.md), and the table's calibration; or say how high the tip is"
            )
    ends = camera.lifted([line.origin, line.origin + reach * line.velocity], height)
    way = ends[1] - ends[0]
    length = float(np.hypot(*way))
    shrunk = length / (reach * float(np.hypot(*line.velocity)))
    if line.rms * shrunk > OFF_LINE:
        raise InvalidInput(
            f"the tip does not move along a line at the positions given: it is {1e3 * line.rms * shrunk:.2f} mm off (rms);"
            " did anything else move, such as a hand or a cable?"
        )
    return TipMeasurement(ends[0], way / length, seen * shrunk, height, length / reach, line.rms * shrunk, centers)


class _Line(NamedTuple):
    origin: Array  # (2,) at position 0
    velocity: Array  # (2,) per metre of stroke
    rms: float  # [m]


def _fitted(positions: Array, centers: Array) -> _Line:
    """The uniform motion through the centres (n, 2), by least squares."""
    velocity, origin = np.polyfit(positions, centers, 1)
    off = centers - origin - positions[:, None] * velocity
    return _Line(origin, velocity, math.sqrt(float(np.mean(np.sum(off**2, axis=1)))))


def _height(camera: Camera, line: _Line) -> float:
    """The tip's height at which the stroke is as long as the controller says: apparent lengths are linear in the height."""
    ends = np.array((line.origin, line.origin + line.velocity))
    flat, risen = (float(np.hypot(*np.diff(camera.lifted(ends, h), axis=0)[0])) for h in (0.0, 0.01))
    return 0.01 * (flat - 1.0) / (flat - risen)


def _ahead(camera: Camera, early: Array, late: Array) -> Array:
    """The direction of the stroke (2,), roughly, from what changed in its first and its second half (height, width).

    The area that was covered and the area that was uncovered both move ahead; the one that the picture's border cuts off less
    is used.
    """
    strong = max(float(np.abs(change).max()) for change in (early, late))
    if strong < LEAST_CHANGE:
        raise InvalidInput(
            f"nothing is seen to move: the picture changes by {strong:.0f} of 255 grey levels, expected {LEAST_CHANGE:.0f} or"
            " more; lay a strip of white paper under a dark tip, and a dark one under a bright tip"
        )
    ways = []
    for sign in (1, -1):
        before, after = (np.argwhere(sign * change > _NOISE_SHARE * strong)[:, ::-1] for change in (early, late))
        if len(before) and len(after):
            even = min(len(before), len(after)) / max(len(before), len(after))
            ways.append((even, after.mean(axis=0), before.mean(axis=0)))
    if not ways:
        raise InvalidInput("what moves is seen in one half of the stroke alone: expected the tip, in the picture all the way")
    _, there, here = max(ways, key=lambda way: way[0])
    way = np.diff(camera.unproject((here, there)), axis=0)[0]
    return np.asarray(way / np.hypot(*way))


class _Circle(NamedTuple):
    center: Array  # (2,) [m]
    radius: float  # [m]
    points: Array  # (k, 2) of the front that it goes through [m]

    def with_radius(self, radius: float) -> "_Circle":
        """The circle of this radius that fits its points best."""
        center = least_squares(lambda at: np.hypot(*(self.points - at).T) - radius, self.center, xtol=1e-12).x
        return _Circle(center, radius, self.points)


def _front(camera: Camera, change: Array, ahead: Array, radius: float) -> _Circle:
    """The circle at the front of what changed since the pusher was at its first position."""
    if not change.any():  # the same picture twice
        raise InvalidInput(NOT_ROUND)
    strong = float(np.percentile(change[change > _NOISE_SHARE * change.max()], 50))
    points = camera.unproject(_level_points(change, _NOISE_SHARE * strong))
    across = np.array((-ahead[1], ahead[0]))
    pixel = camera.metres_per_pixel()
    apex = points[np.argmax(points @ ahead)]
    circle = _Circle(apex - radius * ahead, radius, points)
    for _ in range(_ROUNDS):
        away = (points - circle.center) / circle.radius
        near = (away @ ahead > _FRONT) & (np.abs(np.hypot(*away.T) - 1) < _BAND) & (np.abs(away @ across) < 1.2)
        if np.count_nonzero(near) < LEAST_POINTS:
            raise InvalidInput(NOT_ROUND)
        circle = _through(points[near])
        if not radius / 3 < circle.radius < 3 * radius:
            raise InvalidInput(
                f"the front of what moves has a radius of {1e3 * circle.radius:.1f} mm, the tip's is said to be"
                f" {1e3 * radius:.1f} mm: is this the tip, alone?"
            )
    off = np.hypot(*(circle.points - circle.center).T) - circle.radius
    ahead_of_it = np.count_nonzero((points - circle.center) @ ahead > _FRONT * circle.radius)
    if math.sqrt(float(np.mean(off**2))) > NOT_ROUND_PX * pixel or len(off) < ROUND_SHARE * ahead_of_it:
        raise InvalidInput(NOT_ROUND)
    return circle


def _through(points: Array) -> _Circle:
    """The circle that fits points (k, 2) best, by algebraic least squares (Kasa) in numbers near 1."""
    about = points.mean(axis=0)
    scale = float(np.abs(points - about).max())
    x, y = ((points - about) / scale).T
    (a, b, c), *_ = np.linalg.lstsq(np.column_stack((2 * x, 2 * y, np.ones(len(x)))), x**2 + y**2, rcond=None)
    return _Circle(about + scale * np.array((a, b)), scale * math.sqrt(max(float(c + a**2 + b**2), 0.0)), points)


def _level_points(image: Array, level: float) -> Array:
    """Where grey levels pass a level between two neighbouring pixels (n, 2) [px], at the largest area above it."""
    above = (image > level).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(above, connectivity=8)
    # two discs, the first and the present place of a bare tip, are two areas; specks of noise are none
    least = 0.3 * stats[1:, cv2.CC_STAT_AREA].max()
    large = np.isin(labels, 1 + np.flatnonzero(stats[1:, cv2.CC_STAT_AREA] >= least))
    found = []
    for axis in (0, 1):
        a, b = (image[:-1], image[1:]) if axis == 0 else (image[:, :-1], image[:, 1:])
        own = (large[:-1] | large[1:]) if axis == 0 else (large[:, :-1] | large[:, 1:])
        v, u = np.nonzero(((a > level) != (b > level)) & own)
        share = (level - a[v, u]) / (b[v, u] - a[v, u])
        found.append(np.column_stack((u + share * axis, v + share * (1 - axis))))
    return np.concatenate(found)


def tip_findings(tip: TipMeasurement, stage: StageConfig, height_is_given: bool) -> list[str]:
    """An error in the section `pusher` of a cell's file."""
    off, found = tip.line_origin - np.asarray(stage.line.origin), []
    along, across = float(off @ tip.line_direction), float(cross(tip.line_direction, off))
    if math.hypot(along, across) >= LINE_ERROR:
        found.append(f"line_origin is {1e3 * abs(across):.2f} mm off across the line and {1e3 * abs(along):.2f} mm along it")
    angle = float(np.arctan2(cross(stage.line.direction, tip.line_direction), stage.line.direction @ tip.line_direction))
    if abs(angle) >= ANGLE_ERROR:
        found.append(f"line_direction is off by {math.degrees(abs(angle)):.2f} degrees")
    if abs(stage.tip_radius - tip.tip_radius) >= RADIUS_ERROR:
        found.append(f"tip_radius is {1e3 * stage.tip_radius:.2f} mm, measured {1e3 * tip.tip_radius:.2f} mm")
    apart = tip.stroke_scale - 1
    if height_is_given and abs(apart) >= SCALE_ERROR:
        longer = "longer" if apart > 0 else "shorter"
        found.append(
            f"the stroke is {100 * abs(apart):.1f} % {longer} than the controller says: check its steps per millimetre"
        )
    return found


def tip_picture(camera: Camera, image: Image, tip: TipMeasurement, stroke: float) -> bytes:
    """A PNG: the last picture of the tip with the circle that was fitted to it, and the pushing line."""
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    line = camera.project(tip.line_origin + np.array(((0.0,), (stroke,))) * tip.line_direction, tip.tip_height)
    cv2.polylines(picture, [np.rint(line).astype(np.int32)], False, ORANGE)
    angles = np.linspace(0, 2 * np.pi, 60)
    last = camera.lifted(tip.centers[-1:], tip.tip_height)
    ring = last + tip.tip_radius * np.column_stack((np.cos(angles), np.sin(angles)))
    cv2.polylines(picture, [np.rint(camera.project(ring, tip.tip_height)).astype(np.int32)], True, GREEN)
    return cv2.imencode(".png", picture)[1].tobytes()
