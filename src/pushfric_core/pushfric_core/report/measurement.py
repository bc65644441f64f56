"""Measurements of a cell, compared with its files in sentences, and pictures of what was measured."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np

from pushfric_core.files.object_file import ObjectModel
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, cross, transform
from pushfric_core.pushers.pusher import StageConfig
from pushfric_core.vision.camera import Camera, Image
from pushfric_core.vision.outline_measurement import Measured, Place, fitting_height, in_frame_of, pose_of
from pushfric_core.vision.tip_measurement import TipMeasurement

SIZE_ERROR = 0.002
"""An outline that is larger or smaller by more than this share is reported."""
CORNER_ERROR, HEIGHT_ERROR = 0.5e-3, 0.5e-3
"""A corner or a height that differs by more than this is reported [m]."""
LINE_ERROR, ANGLE_ERROR, RADIUS_ERROR = 0.3e-3, math.radians(0.2), 0.15e-3
"""The same for the pushing line [m, rad] and the tip's radius [m]."""
SCALE_ERROR = 0.005
"""A stroke that differs from what the controller says by more than this share is reported."""

GREEN, ORANGE = (0, 200, 0), (0, 140, 255)  # BGR


class ObjectFindings(NamedTuple):
    """A measured object, in the frame of the object in the file if that has the same shape."""

    outline: Outline
    height: float  # of its face over the table [m]
    findings: list[str]


def object_findings(
    camera: Camera, places: Sequence[Place], measured: Measured, height: float, known: ObjectModel | None, height_is_known: bool
) -> ObjectFindings:
    """What is wrong in an object's file.

    Args:
        camera: lens and table.
        places: where the object was measured.
        measured: the object's outline at `height`.
        height: of its face over the table [m].
        known: the object as its file has it; None: there is no file.
        height_is_known: the height was measured; otherwise it comes from the file.
    """
    if known is None:
        return ObjectFindings(measured.outline, height, [])
    same = in_frame_of(measured.outline, known.outline)
    if same is None:
        corners = f"{len(known.outline.vertices)} corners, {size_of(known.outline)} mm"
        seen = f"{len(measured.outline.vertices)} corners, {size_of(measured.outline)} mm"
        return ObjectFindings(measured.outline, height, [f"the file has another object: {corners}; measured: {seen}"])
    outline, larger = same
    found = []
    sizes = f"{size_of(known.outline)} mm, measured {size_of(outline)} mm"
    wrong = f"{100 * abs(larger - 1):.1f} % too {'large' if larger > 1 else 'small'}"
    if abs(larger - 1) >= SIZE_ERROR and height_is_known:
        found.append(f"the outline in the file is {wrong}: {sizes}")
    elif abs(larger - 1) >= SIZE_ERROR:
        fits = fitting_height(camera, places, known.outline)
        found.append(
            f"the outline in the file is {wrong}: {sizes}; or the height is {1e3 * fits:.1f} mm,"
            f" not {1e3 * known.height:.1f} mm: give --height or --moved"
        )
    if height_is_known and abs(known.height - height) >= HEIGHT_ERROR:
        found.append(f"the height in the file is {1e3 * known.height:.1f} mm, measured {1e3 * height:.1f} mm")
    off = np.hypot(*(outline.vertices * larger - known.outline.vertices).T)
    if off.max() >= CORNER_ERROR:
        found.append(
            f"corner {int(np.argmax(off))} lies {1e3 * off.max():.1f} mm from where the file has it, whatever the size"
        )
    return ObjectFindings(outline, height, found)


def tip_findings(tip: TipMeasurement, stage: StageConfig, height_is_given: bool) -> list[str]:
    """What is wrong in the section `pusher` of a cell's file."""
    origin, direction = np.asarray(stage.line_origin), np.asarray(stage.line_direction) / np.hypot(*stage.line_direction)
    off, found = tip.origin - origin, []
    along, across = float(off @ tip.direction), float(cross(tip.direction, off))
    if math.hypot(along, across) >= LINE_ERROR:
        found.append(f"line_origin is {1e3 * abs(across):.2f} mm off across the line and {1e3 * abs(along):.2f} mm along it")
    angle = float(np.arctan2(cross(direction, tip.direction), direction @ tip.direction))
    if abs(angle) >= ANGLE_ERROR:
        found.append(f"line_direction is off by {math.degrees(abs(angle)):.2f} degrees")
    if abs(stage.tip_radius - tip.radius) >= RADIUS_ERROR:
        found.append(f"tip_radius is {1e3 * stage.tip_radius:.2f} mm, measured {1e3 * tip.radius:.2f} mm")
    if height_is_given and abs(tip.scale - 1) >= SCALE_ERROR:
        longer = "longer" if tip.scale > 1 else "shorter"
        found.append(
            f"the stroke is {100 * abs(tip.scale - 1):.1f} % {longer} than the controller says: check its steps per millimetre"
        )
    return found


def object_figures(found: ObjectFindings, measured: Measured) -> dict[str, Any]:
    """The measured object for programs, as the command's JSON has it."""
    return {
        "outline": found.outline.vertices.tolist(),
        "height": found.height,
        "places": len(measured.poses),
        "spread": measured.spread,
    }


def tip_figures(tip: TipMeasurement) -> dict[str, Any]:
    """The measured line and tip for programs, as the command's JSON has them."""
    return {
        "line_origin": tip.origin.tolist(),
        "line_direction": tip.direction.tolist(),
        "tip_radius": tip.radius,
        "tip_height": tip.height,
        "stroke_scale": tip.scale,
        "rms": tip.rms,
    }


def size_of(outline: Outline) -> str:
    """Length and width of the smallest rectangle around an outline [mm]."""
    _, sides, _ = cv2.minAreaRect((1e3 * outline.vertices).astype(np.float32))
    return " x ".join(f"{side:.1f}" for side in sorted(sides, reverse=True))


def object_picture(camera: Camera, place: Place, found: ObjectFindings) -> Image:
    """The picture of a place with the measured outline; its corners have the numbers of the file."""
    picture = cv2.cvtColor(place.image, cv2.COLOR_GRAY2BGR)
    pose = pose_of(camera, place, found.outline, found.height)
    corners = camera.project(transform(pose, found.outline.vertices), found.height)
    cv2.polylines(picture, [np.rint(corners).astype(np.int32)], True, GREEN)
    for number, corner in enumerate(corners):
        _label(picture, str(number), corner)
    _label(picture, f"{size_of(found.outline)} mm, {1e3 * found.height:.1f} mm high", np.array((8.0, 20.0)))
    return np.asarray(picture)


def tip_picture(camera: Camera, image: Image, tip: TipMeasurement, stroke: float) -> Image:
    """The last picture of the tip with the circle that was fitted to it, and the pushing line."""
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    line = camera.project(tip.origin + np.array(((0.0,), (stroke,))) * tip.direction, tip.height)
    cv2.polylines(picture, [np.rint(line).astype(np.int32)], False, ORANGE)
    angles = np.linspace(0, 2 * np.pi, 60)
    last = camera.lifted(tip.centers[-1:], tip.height)
    ring = last + tip.radius * np.column_stack((np.cos(angles), np.sin(angles)))
    cv2.polylines(picture, [np.rint(camera.project(ring, tip.height)).astype(np.int32)], True, GREEN)
    return np.asarray(picture)


def _label(picture: Any, text: str, place: Array) -> None:
    at = (int(place[0]), int(place[1]))
    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, ORANGE, 1, cv2.LINE_AA)
