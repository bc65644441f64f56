"""The scene: the calibration of the camera, the object, and the push plan."""

import numpy as np

from pushfric_core.cell.cell_file import CellFile
from pushfric_core.cell.node_settings import PlanConfig
from pushfric_core.errors import InvalidInput
from pushfric_core.files.object_file import ObjectModel
from pushfric_core.files.plan_file import load_plan
from pushfric_core.pushers.pusher import Check, Grade, PusherConfig
from pushfric_core.vision.camera import Camera, Image
from pushfric_core.vision.sighting import NotSeen, Tracker
from pushfric_core.vision.tracker_settings import ContourConfig

COARSEST = 0.8e-3
"""Largest useful size of a pixel on the table [m]."""

LENS_ERROR_PX = 0.5
"""The way from a pixel to the table and back must end within this distance of the pixel."""


def check_calibration(camera: Camera, image: Image | None, pusher: PusherConfig) -> Check:
    """The calibration, compared with the camera's picture (height, width), if there is one, and with the pushing line."""
    if image is not None and image.shape != (camera.height, camera.width):
        got = f"{image.shape[1]} x {image.shape[0]}"
        finding = f"made for {camera.width} x {camera.height} px, the camera gives {got}"
        return Check("calibration", Grade.FAILED, finding, "set the camera to that size, or calibrate it at this one")
    corners = np.array([(u, v) for u in (0, camera.width - 1) for v in (0, camera.height - 1)], dtype=float)
    off = np.abs(camera.project(camera.unproject(corners)) - corners).max()
    if not off < LENS_ERROR_PX:
        advice = "`./pushfric calibrate lens` again, with the board in the corners of the picture"
        return Check("calibration", Grade.FAILED, "the lens model fails in the corners of the picture", advice)
    direction = np.asarray(pusher.line_direction) / np.hypot(*pusher.line_direction)
    line = np.asarray(pusher.line_origin) + np.linspace(0, pusher.stroke, 50)[:, None] * direction
    pixels = camera.project(line)
    seen = np.mean(((pixels >= 0) & (pixels <= (camera.width - 1, camera.height - 1))).all(axis=1))
    pixel = camera.metres_per_pixel()
    finding = f"a pixel is {1e3 * pixel:.2f} mm, {100 * seen:.0f} % of the pushing line are in the picture"
    if not seen:
        advice = "`./pushfric calibrate tip CELL` finds the line, `./pushfric calibrate table` the table frame it is in"
        return Check("calibration", Grade.FAILED, finding, advice)
    if pixel > COARSEST:
        advice = f"{1e3 * COARSEST:g} mm or less are needed: a camera nearer to the table, or with more pixels"
        return Check("calibration", Grade.WARNING, finding, advice)
    if image is None:
        advice = "see the camera above, then call doctor again"
        return Check("calibration", Grade.WARNING, f"{finding}; not compared with a picture, for want of one", advice)
    return Check("calibration", Grade.OK, finding)


def check_object(cell: CellFile, camera: Camera, model: ObjectModel, image: Image | None) -> Check:
    """Whether the tracker can find such an object, and whether it sees it now; it may not lie there yet, which is a warning."""
    try:
        tracker: Tracker = cell.tracker.open_tracker(camera, model, (cell.camera and cell.camera.object_height) or model.height)
    except InvalidInput as error:
        return Check("object", Grade.FAILED, str(error), "a camera nearer to the table, larger markers, or another object")
    if image is None or image.shape != (camera.height, camera.width):
        finding = f"{model.name}: not checked whether it is seen, for want of a picture of the calibrated size"
        return Check("object", Grade.WARNING, finding, "see the camera above, then call doctor again")
    try:
        sighting = tracker.track(image)
    except NotSeen as reason:
        size = " x ".join(f"{side / camera.metres_per_pixel(model.height):.0f}" for side in model.outline.size)
        table, brightest = np.percentile(image, (50, 99.9))
        finding = (
            f"{model.name} is not seen now: {reason}; expected about {size} px;"
            f" the picture has grey levels of {table:.0f} (median) to {brightest:.0f}"
        )
        advice = "lay it in the picture, alone; `./pushfric edit OBJECT --picture SOURCE --camera FILE` shows what is seen"
        return Check("object", Grade.WARNING, finding, advice)
    x, y = 1e3 * sighting.pose.x, 1e3 * sighting.pose.y
    finding = f"{model.name} is seen at ({x:.0f}, {y:.0f}) mm, edges fit to {sighting.residual_px:.2f} px"
    if isinstance(cell.tracker, ContourConfig) and model.outline.is_its_mirror_image:
        finding += "; it looks the same in a mirror: only with markers, the tracker would notice a mirrored picture"
    return Check("object", Grade.OK, finding)


def check_plan(plan: PlanConfig, pusher: PusherConfig, model: ObjectModel) -> Check:
    """Whether the push plan fits the object and the pusher."""
    try:
        pushes = load_plan(plan.plan, model)
    except InvalidInput as error:
        return Check("plan", Grade.FAILED, str(error), "docs/files.md shows a plan")
    finding = f"{plan.choose or len(pushes)} pushes of {1e3 * plan.distance:g} mm at {1e3 * plan.speed:g} mm/s"
    if plan.distance > pusher.stroke or plan.speed > pusher.max_speed:
        finding += f"; the pusher's stroke is {1e3 * pusher.stroke:g} mm, its greatest speed {1e3 * pusher.max_speed:g} mm/s"
        return Check("plan", Grade.FAILED, finding, "shorten plan.distance, lower plan.speed")
    return Check("plan", Grade.OK, finding)
