"""The camera: whether its frames arrive, change, are well exposed and have good stamps."""

import itertools
import math
import threading
import time
from typing import Any, NamedTuple

import numpy as np
from sensor_msgs.msg import CompressedImage
from sensor_msgs.msg import Image as ImageMsg

from pushfric_core.errors import InvalidInput
from pushfric_ros.files.node_settings import CameraConfig
from pushfric_ros.messages.conversions import stamp_from_msg
from pushfric_ros.node_kit.visit import visit
from pushfric_ros.nodes.tracker import IMAGE_QUEUE, TOPICS, grey_from_msg
from pushfric_ros.pushers.check import Check, Level
from pushfric_ros.vision.camera import Image, picture_from
from pushfric_ros.vision.edge_fit import MIN_CONTRAST, SATURATED
from pushfric_ros.vision.frame_source import Device

PATIENCE = 5.0
"""How long to wait for the first frame [s]."""

FRAMES, WATCHED = 20, 3.0
"""A camera is watched for this many frames, or for this long [s]."""

SLOWEST = 10.0
"""Frame rate that a push at 2 cm/s needs [1/s]."""

BRIGHTEST, MOST_SATURATED = 235, 0.01
"""Grey level from which a pixel counts as saturated (the video range ends there), and the largest share of such pixels."""

STALE = 1.0
"""Frames older than this on arrival [s], or from the future, have stamps of another clock."""


class Frame(NamedTuple):
    """A frame of the camera as it arrived."""

    stamp: int  # [ns]
    arrival: int  # [ns]
    image: Image


def watch(entry: CameraConfig, namespace: str, size: tuple[int, int] | None) -> list[Frame]:
    """The first frames of a camera, which is a device or a topic; empty if no frame comes in time.

    Args:
        entry: the section `camera` of the cell's file.
        namespace: namespace of the cell.
        size: width and height to ask of a device [px]; None: its default.
    Raises:
        InvalidInput: there is no such device, or the topic carries no pictures.
    """
    if entry.source in TOPICS:
        return _watch_topic(entry.source, namespace)
    arrived = threading.Event()
    device = Device(entry.source, size, time.time_ns, arrived.set)
    frames: list[Frame] = []
    deadline = time.monotonic() + PATIENCE
    device.start()
    try:
        while len(frames) < FRAMES and time.monotonic() < deadline and (device.is_alive() or device.frames):
            arrived.wait(0.1)
            arrived.clear()
            while device.frames:
                if not frames:
                    deadline = time.monotonic() + WATCHED
                stamp, image = device.frames.popleft()
                frames.append(Frame(stamp, time.time_ns(), image))
    finally:
        device.close()
    return frames


def _watch_topic(source: str, namespace: str) -> list[Frame]:
    frames: list[Frame] = []
    problems: list[str] = []

    def take(msg: Any) -> None:
        arrival = time.time_ns()
        try:
            image = grey_from_msg(msg) if source == "topic" else picture_from(np.frombuffer(msg.data, np.uint8), msg.format)
        except ValueError as error:
            problems.append(str(error))
            return
        frames.append(Frame(stamp_from_msg(msg.header.stamp), arrival, image))

    with visit("doctor", namespace) as here:
        here.node.create_subscription(ImageMsg if source == "topic" else CompressedImage, TOPICS[source], take, IMAGE_QUEUE)
        deadline = time.monotonic() + PATIENCE
        while len(frames) < FRAMES and not problems and time.monotonic() < deadline:
            here.spin_once(0.1)
            if len(frames) == 1:
                deadline = min(deadline, time.monotonic() + WATCHED)
    if problems:
        raise InvalidInput(f"{TOPICS[source]}: {problems[0]}")
    return frames


def check_camera(frames: list[Frame], source: str) -> Check:
    """Whether frames come, come fast enough, and change."""
    what = TOPICS.get(source, source)
    if not frames:
        advice = "check that its driver runs and publishes in the cell's namespace" if source in TOPICS else "plug it in again"
        return Check("camera", Level.FAILED, f"no frames from {what}", advice)
    height, width = frames[0].image.shape
    seconds = (frames[-1].arrival - frames[0].arrival) / 1e9
    rate = (len(frames) - 1) / seconds if seconds > 0 else math.nan
    finding = f"{what}: {width} x {height} px, {rate:.1f} frames/s"
    if len(frames) > 2 and all(np.array_equal(frame.image, frames[0].image) for frame in frames):
        return Check("camera", Level.FAILED, f"{finding}, all of them equal", "it hangs: unplug it and plug it in again")
    if not rate >= SLOWEST:
        advice = f"{SLOWEST:g} frames/s or more are needed: shorter exposure with more light, or another port or format"
        return Check("camera", Level.WARNING, finding, advice)
    return Check("camera", Level.OK, finding)


def check_exposure(image: Image) -> Check:
    """Whether an image (height, width), mono8, is neither saturated nor too dark."""
    saturated, bright, middle = np.mean(image >= BRIGHTEST), np.percentile(image, 99.9), np.median(image)
    finding = (
        f"{100 * saturated:.1f} % of the pixels are saturated, the brightest have {bright:.0f}, the median is {middle:.0f}"
    )
    if middle >= SATURATED:
        return Check("exposure", Level.WARNING, finding, "the table must be dark: shorter exposure, less gain")
    if saturated > MOST_SATURATED:
        return Check(
            "exposure", Level.WARNING, finding, "saturated areas look too large: shorter exposure, less gain, no highlights"
        )
    if bright < MIN_CONTRAST:
        return Check("exposure", Level.WARNING, finding, "too dark to see an object: more light or exposure, and no lens cap")
    return Check("exposure", Level.OK, finding)


def check_stamps(frames: list[Frame]) -> Check:
    """Whether the stamps of the frames agree with this machine's clock."""
    ages = [(frame.arrival - frame.stamp) / 1e9 for frame in frames]
    finding = f"{np.median(ages):.3f} s old on arrival"
    backwards = any(b.stamp <= a.stamp for a, b in itertools.pairwise(frames))
    if not -STALE / 10 <= np.median(ages) <= STALE or backwards:
        finding += ", not in order" if backwards else ""
        advice = "the driver's clock is not this one: synchronise them; small constant offsets go into camera.time_offset"
        return Check("stamps", Level.FAILED, finding, advice)
    return Check("stamps", Level.OK, finding)
