"""The camera: its frames, their exposure and stamps; and the scene: the calibration, the object, and the push plan."""

import itertools
import math
import time
from typing import NamedTuple

import numpy as np

from pushfric_core.cell.cell_file import CellFile
from pushfric_core.cell.node_settings import CameraConfig, PlanConfig
from pushfric_core.commands.frames import frames_from
from pushfric_core.errors import InvalidInput
from pushfric_core.files.object_file import ObjectModel
from pushfric_core.files.plan_file import load_plan
from pushfric_core.pushers.pusher import Check, Grade, PusherConfig
from pushfric_core.vision.camera import Camera, Image
from pushfric_core.vision.edge_fit import MIN_CONTRAST, SATURATED
from pushfric_core.vision.frame_source import TOPICS, Frame
from pushfric_core.vision.sighting import NotSeen, Tracker
from pushfric_core.vision.tracker_settings import ContourConfig
from pushfric_core.wording import counted
from pushfric_ros.node_kit import network

FRAME_TIMEOUT = 5.0
"""How long to wait for the first frame [s]."""

FRAMES, WATCHED = 20, 3.0
"""A camera is watched for this many frames, or for this long [s]."""

SLOWEST = 10.0
"""Frame rate that a push at 2 cm/s needs [1/s]."""

BRIGHTEST, MOST_SATURATED = 235, 0.01
"""Grey level from which a pixel counts as saturated (the video range ends there), and the largest share of such pixels."""

MOST_LOST = 0.02
"""Share of the images of a topic that may be lost on the way."""

EARLY, SLOW, STALE = 0.005, 0.2, 0.5
"""Frames that are more than the first time [s] in the future, or older than the last on arrival, have stamps of another clock.
From the second time on, they may have such stamps, or the driver is slow."""


class Watched(NamedTuple):
    """The frames that came from a camera, and those that did not."""

    frames: list[Frame]  # the first ones; empty if none came in time
    lost: int = 0  # images of a topic that were published meanwhile and did not arrive
    publishers: int = 0  # of the topic


def watch(entry: CameraConfig, namespace: str, size: tuple[int, int] | None) -> Watched:
    """The first frames of a camera, which is a device or a topic.

    Args:
        entry: the section `camera` of the cell's file.
        namespace: namespace of the cell.
        size: width and height to ask of a device [px]; None: its default.
    Raises:
        InvalidInput: there is no such device, or the topic carries no pictures.
    """
    found: list[Frame] = []
    with frames_from(entry.source, namespace, size) as source:
        deadline = time.monotonic() + FRAME_TIMEOUT
        while len(found) < FRAMES and source.wait(deadline - time.monotonic()):
            if not found:
                deadline = time.monotonic() + WATCHED
            found.append(source.waiting.popleft())
    return Watched(found, source.lost, source.publishers)


def check_camera(watched: Watched, source: str) -> Check:
    """Whether frames come, none is lost, they come fast enough, and change."""
    what, frames, lost = TOPICS.get(source, source), watched.frames, watched.lost
    if not frames and watched.publishers:
        finding = f"no frames from {what}, though it has {counted(watched.publishers, 'publisher')}"
        return Check("camera", Grade.FAILED, finding, f"{room()}; or its driver has no picture to publish")
    if not frames:
        advice = "start its driver in the cell's namespace" if source in TOPICS else "plug it in again"
        return Check("camera", Grade.FAILED, f"no frames from {what}", advice)
    height, width = frames[0].image.shape
    seconds = (frames[-1].arrival - frames[0].arrival) / 1e9
    rate = (len(frames) - 1) / seconds if seconds > 0 else math.nan
    finding = f"{what}: {width} x {height} px, {rate:.1f} frames/s"
    if len(frames) > 2 and all(np.array_equal(frame.image, frames[0].image) for frame in frames):
        return Check("camera", Grade.FAILED, f"{finding}, all of them equal", "it hangs: unplug it and plug it in again")
    if lost > MOST_LOST * (lost + len(frames)):
        finding += f"; {100 * lost / (lost + len(frames)):.0f} % of the images are lost on the way"
        return Check("camera", Grade.WARNING, finding, room())
    if not rate >= SLOWEST:
        advice = f"{SLOWEST:g} frames/s or more are needed: shorter exposure with more light, or another port or format"
        return Check("camera", Grade.WARNING, finding, advice)
    return Check("camera", Grade.OK, finding)


def room() -> str:
    """Advice if images do not arrive."""
    command = network.for_camera_drivers()
    if command is None:
        return "give the middleware of the driver's process more memory for messages of this size"
    return f"the driver's process has too little shared memory for its images; in its terminal: {command}, then start it again"


def check_exposure(image: Image) -> Check:
    """Whether an image (height, width), mono8, is neither saturated nor too dark."""
    saturated, bright, middle = np.mean(image >= BRIGHTEST), np.percentile(image, 99.9), np.median(image)
    finding = (
        f"{100 * saturated:.1f} % of the pixels are saturated, the brightest have {bright:.0f}, the median is {middle:.0f}"
    )
    for wrong, advice in (
        (middle >= SATURATED, "the table must be dark: shorter exposure, less gain"),
        (saturated > MOST_SATURATED, "saturated areas look too large: shorter exposure, less gain, no highlights"),
        (bright < MIN_CONTRAST, "too dark to see an object: more light or exposure, and no lens cap"),
    ):
        if wrong:
            return Check("exposure", Grade.WARNING, finding, advice)
    return Check("exposure", Grade.OK, finding)


def check_stamps(frames: list[Frame]) -> Check:
    """Whether the stamps of the frames agree with this machine's clock."""
    ages = [(frame.arrival - frame.stamp) / 1e9 for frame in frames]
    finding = f"{np.median(ages):.3f} s old on arrival"
    backwards = any(b.stamp <= a.stamp for a, b in itertools.pairwise(frames))
    age = float(np.median(ages))
    if not -EARLY <= age <= STALE or backwards:
        finding += ", not in order" if backwards else ", so not by this machine's clock"
        advice = "sudo timedatectl set-ntp true on both machines, or chrony; small constant offsets go into camera.time_offset"
        return Check("stamps", Grade.FAILED, finding, advice)
    if age > SLOW:
        speed = PlanConfig.speed
        finding += f"; by another clock, a push at {1e3 * speed:g} mm/s would be seen {1e3 * speed * age:.0f} mm behind"
        advice = "compare the clocks, with `date +%s.%N` on both machines; a driver on this one is slow: fewer pixels, no queue"
        return Check("stamps", Grade.WARNING, finding, advice)
    return Check("stamps", Grade.OK, finding)


COARSEST = 0.8e-3
"""Largest useful size of a pixel on the table [m]."""

LENS_ERROR_PX = 0.5
"""The way from a pixel to the table and back must end within this distance of the pixel."""


def check_calibration(camera: Camera, image: Image | None, pusher: PusherConfig) -> Check:
    """The calibration, compared with the camera's picture (height, width), if there is one, and with the pushing line."""
    if image is not None and image.shape != (camera.height, camera.width):
        finding = f"made for {camera.width} x {camera.height} px, the camera gives {image.shape[1]} x {image.shape[0]}"
        return Check("calibration", Grade.FAILED, finding, "set the camera to that size, or calibrate it at this one")
    corners = np.array([(u, v) for u in (0, camera.width - 1) for v in (0, camera.height - 1)], dtype=float)
    off = np.abs(camera.project(camera.unproject(corners)) - corners).max()
    if not off < LENS_ERROR_PX:
        advice = "`./pushfric calibrate lens` again, with the board in the corners of the picture"
        return Check("calibration", Grade.FAILED, "the lens model fails in the corners of the picture", advice)
    pixels = camera.project(pusher.line.origin + np.linspace(0, pusher.stroke, 50)[:, None] * pusher.line.direction)
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
    finding = f"{model.name} is seen at ({x:z.0f}, {y:z.0f}) mm, edges fit to {sighting.residual_px:.2f} px"
    if isinstance(cell.tracker, ContourConfig) and model.outline.is_its_mirror_image:
        finding += "; it looks the same in a mirror: only with markers, the tracker would notice a mirrored picture"
    return Check("object", Grade.OK, finding)


def check_plan(plan: PlanConfig, model: ObjectModel) -> Check:
    """Whether the push plan fits the object."""
    try:
        pushes = load_plan(plan.plan, model)
    except InvalidInput as error:
        return Check("plan", Grade.FAILED, str(error), "docs/files.md shows a plan")
    finding = f"{plan.choose or len(pushes)} pushes of {1e3 * plan.distance:g} mm at {1e3 * plan.speed:g} mm/s"
    return Check("plan", Grade.OK, finding)
