"""The tracker node: camera images -> the object's pose on the table."""

import array
import math
import time
from typing import Any

import cv2
import numpy as np
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage
from sensor_msgs.msg import Image as ImageMsg

from pushfric_core.bags.samples import pose_from_msg, stamp_from_msg
from pushfric_core.cell.node_settings import CameraConfig, FrameConfig, ObjectConfig, RequiredSubscribersConfig
from pushfric_core.cell.plugins import chosen_tracker, tracker_kinds
from pushfric_core.errors import InvalidInput
from pushfric_core.files.object_file import load_object
from pushfric_core.geometry.frames import CAMERA, TABLE
from pushfric_core.geometry.planar import Pose
from pushfric_core.vision.camera import Image, load_camera, picture_from
from pushfric_core.vision.frame_source import TOPICS, Device
from pushfric_core.vision.overlay import Overlay
from pushfric_core.vision.sighting import UNMEASURED, NotSeen, Sighting, Tracker
from pushfric_msgs.msg import PlanProgress
from pushfric_ros.messages.conversions import pose_to_msg, stamp_to_msg
from pushfric_ros.node_kit import executable
from pushfric_ros.node_kit.diagnostics import NO_POSE, Diagnostics, Health, Level
from pushfric_ros.node_kit.heartbeat import Heartbeat
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_DATA
from pushfric_ros.node_kit.required_subscribers import RequiredSubscribers
from pushfric_ros.node_kit.transforms import TransformBroadcaster, camera_transform

IMAGE_QUEUE = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Holds more than a second of frames, so that none is lost in a busy moment."""

TO_GREY = {
    "mono8": (1, None),
    "mono16": (2, None),
    "bgr8": (3, cv2.COLOR_BGR2GRAY),
    "rgb8": (3, cv2.COLOR_RGB2GRAY),
    "bgra8": (4, cv2.COLOR_BGRA2GRAY),
    "rgba8": (4, cv2.COLOR_RGBA2GRAY),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2GRAY),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2GRAY),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2GRAY),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2GRAY),
    "yuyv": (2, cv2.COLOR_YUV2GRAY_YUYV),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2GRAY_YUYV),
    "uyvy": (2, cv2.COLOR_YUV2GRAY_UYVY),
    "yuv422": (2, cv2.COLOR_YUV2GRAY_UYVY),
    "nv12": (1, None),
    "nv21": (1, None),
    "nv24": (1, None),
}
"""Bytes per pixel of the (first) plane for each known encoding, and OpenCV's conversion, which takes the luminance of YUV."""

PLANES = {"nv12": 1.5, "nv21": 1.5, "nv24": 3.0}
"""Size of all planes of an image relative to the luminance plane, which comes first."""

"""The values of `source` that are topics."""

DISORDER = 1_000_000_000
"""Frames that are late by up to this [ns] are dropped; a longer step back means that the clock was reset."""

REPLACED = 0.03
"""An object that moves farther than this [m] between two frames was moved by hand."""

UNWATCHED = 0.2
"""In a gap of this length [s] between frames, a person can turn the object: its last orientation then no longer decides among
those that look alike."""

FROZEN_FRAMES = 3
"""This many identical frames in a row mean that the camera is frozen."""

OVERLAY_PERIOD = 0.2
"""Least time between overlays [s]."""


class TrackerNode(Node):
    """Publishes the object's pose for every frame that shows it, and nothing for the others."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("tracker", **kwargs)
        name = declare(self, ObjectConfig).object
        prefix = declare(self, FrameConfig).within(self.get_namespace())
        self._config = config = declare(self, CameraConfig)
        try:
            driver = chosen_tracker([declare(self, kind) for kind in tracker_kinds(config.tracker)])
        except ValueError as error:
            raise InvalidInput(f"{self.get_fully_qualified_name()}: {error}") from error
        self._object = load_object(name)
        self._camera = load_camera(config.calibration)
        self._height = config.object_height or self._object.height
        self._tracker: Tracker = driver.open_tracker(self._camera, self._object, self._height)

        self._stamp = 0  # of the newest frame [ns]
        self._frame: Image | None = None  # the newest
        self._alike = 1  # number of identical frames in a row, up to the newest
        self._last: Pose | None = None  # where the object was last seen
        self._placement: Pose | None = None  # where it is to be placed, until it is seen there
        self._ghost: Pose | None = None  # where a person is to place it now
        self._placed = False  # whether it lies there
        self._in_sight = False
        self._since = 0  # stamp of the frame since which it is in sight without a break [ns]
        self._sighting: Sighting | None = None  # in the newest frame
        self._reason = "no frame yet"  # why it is not seen in the newest frame
        self._counts = dict.fromkeys(("frames", "seen", "late frames dropped", "unusable frames"), 0)
        self._reported = (time.monotonic(), 0, 0)
        self._latency = 0.0
        self._overlay_time = 0.0
        self._complaints: set[str] = set()

        self._diagnostics = topics = Diagnostics(self, self._health, prefix)
        Heartbeat(self)
        self._pose_out = topics.advertise(PoseWithCovarianceStamped, "object_pose", RELIABLE)
        self._required_subscribers = RequiredSubscribers(
            self, self._pose_out, declare(self, RequiredSubscribersConfig).heard_by
        )
        self._overlay_out = topics.advertise(CompressedImage, "overlay/compressed", SENSOR_DATA)
        topics.subscribe(PoseStamped, "placement", self._on_placement, LATCHED)
        self.create_subscription(PlanProgress, "plan_progress", self._on_plan, LATCHED)
        self._transforms = TransformBroadcaster(self, prefix, fixed=True)
        self._transforms.broadcast(camera_transform(*self._camera.pose()))
        self._device: Device | None = None
        self._source = TOPICS.get(config.source, config.source)
        if config.source == "topic":
            topics.subscribe(ImageMsg, self._source, self._on_image, IMAGE_QUEUE)
        elif config.source == "compressed":
            topics.subscribe(CompressedImage, self._source, self._on_compressed_image, IMAGE_QUEUE)
        else:
            arrived = self.create_guard_condition(self._on_device_frames)
            size = (self._camera.width, self._camera.height)
            try:
                self._device = Device(config.source, size, lambda: self.get_clock().now().nanoseconds, arrived.trigger)
            except InvalidInput as error:
                raise InvalidInput(f"{error}; or {' or '.join(TOPICS)}, for a camera whose driver is a node") from error
            self._device.start()

    def destroy_node(self) -> None:
        """Release the camera, too."""
        if self._device is not None:
            self._device.close()
        super().destroy_node()

    def _on_placement(self, msg: PoseStamped) -> None:
        try:
            self._placement = pose_from_msg(msg.pose)
        except ValueError as error:
            self._complain(f"placement ignored: {error}")
            return
        if 0 < stamp_from_msg(msg.header.stamp) < self._since:  # it came later than frames that show the object placed
            self._in_sight = False

    def _on_plan(self, msg: PlanProgress) -> None:
        """Draw where the object is to be placed, while a person places it."""
        self._placed = msg.in_place
        try:
            self._ghost = pose_from_msg(msg.placement) if msg.phase == PlanProgress.PHASE_PLACING else None
        except ValueError:  # the topic placement has the same pose, and its callback complains
            self._ghost = None

    def _on_image(self, msg: ImageMsg) -> None:
        try:
            frame = grey_from_msg(msg)
        except ValueError as error:
            self._refuse(str(error))
            return
        self._on_frame(frame, stamp_from_msg(msg.header.stamp))

    def _on_compressed_image(self, msg: CompressedImage) -> None:
        try:
            frame = picture_from(np.frombuffer(msg.data, np.uint8), msg.format)
        except ValueError as error:
            self._refuse(str(error))
            return
        self._on_frame(frame, stamp_from_msg(msg.header.stamp))

    def _on_device_frames(self) -> None:
        assert self._device is not None
        while self._device.frames:
            stamp, frame = self._device.frames.popleft()
            self._on_frame(frame, stamp)

    def _on_frame(self, frame: Image, stamp: int) -> None:
        if frame.shape != (self._camera.height, self._camera.width):
            self._refuse(
                f"the camera is calibrated for {self._camera.width} x {self._camera.height} px, "
                f"the image has {frame.shape[1]} x {frame.shape[0]}"
            )
            return
        if not stamp:
            self._refuse("the images carry no time stamp")
            return
        if -DISORDER < stamp - self._stamp <= 0:
            self._counts["late frames dropped"] += 1
            return
        if not 0 < stamp - self._stamp <= UNWATCHED * 1e9:
            self._in_sight = False
        self._stamp = stamp
        self._counts["frames"] += 1
        self._alike = self._alike + 1 if self._frame is not None and _same(frame, self._frame) else 1
        self._frame = frame
        try:
            if self._alike >= FROZEN_FRAMES:
                raise NotSeen("frozen frame")
            self._sighting = self._look(frame)
        except NotSeen as reason:
            self._sighting, self._reason, self._in_sight = None, str(reason), False
        else:
            self._counts["seen"] += 1
            if not self._in_sight:
                self._since = stamp
            self._last, self._in_sight = self._sighting.pose, True
            self._publish(self._sighting, stamp)
        if self._overlay_out.get_subscription_count() and time.monotonic() - self._overlay_time >= OVERLAY_PERIOD:
            self._publish_overlay(frame, stamp)

    def _look(self, frame: Image) -> Sighting:
        """Find the object, and choose among orientations that look the same.

        While the object stays in sight, its last pose decides; when it returns, the pose in which it was to be placed does.
        """
        awaited = self._placement or self._last
        sighting = self._tracker.track(frame, self._last if self._in_sight else awaited)
        returns = not self._in_sight
        if self._in_sight and self._last and _apart(sighting.pose, self._last):
            sighting, returns = self._tracker.track(frame, awaited), True
        if returns and self._placement and not _apart(sighting.pose, self._placement):
            self._placement = None
        return sighting

    def _publish(self, sighting: Sighting, stamp: int) -> None:
        msg = PoseWithCovarianceStamped()
        msg.header.stamp, msg.header.frame_id = self._shifted(stamp), TABLE
        msg.pose.pose = pose_to_msg(sighting.pose)
        covariance = UNMEASURED * np.eye(6)
        covariance[np.ix_((0, 1, 5), (0, 1, 5))] = sighting.covariance
        msg.pose.covariance = covariance.ravel()
        if not self._required_subscribers.missing:
            self._pose_out.publish(msg)
        self._latency = (self.get_clock().now().nanoseconds - stamp) / 1e9

    def _publish_overlay(self, frame: Image, stamp: int) -> None:
        """Publish the frame with the object as it was seen, or the reason why it was not, and where it is to be placed."""
        self._overlay_time = time.monotonic()
        overlay, seen = Overlay(frame, self._camera, self._object.outline, self._height), self._sighting
        overlay.table()
        if seen is not None:
            overlay.seen(seen.pose)
        if self._ghost is not None:
            overlay.ghost(self._ghost, seen and seen.pose, self._placed)
        overlay.say(f"{seen.residual_px:.2f} px" if seen else self._reason.partition(":")[0])
        _, jpeg = cv2.imencode(".jpg", overlay.picture)
        msg = CompressedImage(format="jpeg", data=array.array("B", jpeg.tobytes()))
        msg.header.stamp, msg.header.frame_id = self._shifted(stamp), CAMERA
        self._overlay_out.publish(msg)

    def _shifted(self, stamp: int) -> Any:
        return stamp_to_msg(stamp + round(self._config.time_offset * 1e9))

    def _refuse(self, why: str) -> None:
        self._counts["unusable frames"] += 1
        self._sighting, self._reason, self._in_sight = None, why, False
        self._complain(f"frames are unusable: {why}")

    def _complain(self, text: str) -> None:
        """Log a line once."""
        if text not in self._complaints:
            self._complaints.add(text)
            self.get_logger().error(text)

    def _health(self) -> Health:
        now = time.monotonic()
        then, frames_before, seen_before = self._reported
        self._reported = now, self._counts["frames"], self._counts["seen"]
        frames, seen = self._counts["frames"] - frames_before, self._counts["seen"] - seen_before
        values = {
            "object": self._object.name,
            "frames/s": round(frames / max(now - then, 1e-9), 1),
            **self._counts,
            "last reason": self._reason,
            "latency [s]": round(self._latency, 4),
        }
        if self._sighting is not None:
            values |= {
                "residual [px]": round(self._sighting.residual_px, 3),
                "orientations": self._sighting.orientations,
                "visible": round(self._sighting.visible_fraction, 2),
            }
        if self._device is not None:
            values["device frames dropped"] = self._device.dropped
        values[NO_POSE] = why = self._without_pose(frames, seen)
        if why:
            level = Level.WARN if frames else Level.ERROR
            return Health(level, f"not seen: {why}" if frames and not seen else why, values)
        if self._sighting is not None and self._sighting.doubt:
            return Health(Level.WARN, f"seen, but {self._sighting.doubt}", values)
        return Health(Level.OK, "seen", values)

    def _without_pose(self, frames: int, seen: int) -> str:
        """Why these frames gave no pose; empty if they did."""
        if not frames:
            return f"no frames from {self._source}"
        if not seen:
            return self._reason
        missing = self._required_subscribers.missing
        return f"waiting for {', '.join(missing)} to receive the poses" if missing else ""


def grey_from_msg(msg: ImageMsg) -> Image:
    """The image (height, width) in grey levels, mono8.

    Mono16 gives its upper byte, YUV its luminance as it is. If the message holds contiguous grey values, the image shares the
    memory of the message.

    Raises:
        ValueError: the encoding is not in `TO_GREY`, or the sizes do not fit the data.
    """
    if msg.encoding not in TO_GREY:
        raise ValueError(f"encoding must be {', '.join(TO_GREY)}, got {msg.encoding!r}")
    pixel_size, conversion = TO_GREY[msg.encoding]
    data, what = np.frombuffer(msg.data, np.uint8), f"{msg.width} x {msg.height} {msg.encoding}"
    if not msg.width * msg.height:
        raise ValueError(f"an image must have pixels, got {what}")
    if msg.step < msg.width * pixel_size:
        raise ValueError(f"{what} must have a step of {msg.width * pixel_size} or more, got {msg.step}")
    size = msg.step * math.ceil(msg.height * PLANES.get(msg.encoding, 1))
    if len(data) != size:
        raise ValueError(f"{what} with step {msg.step} must have {size} bytes, got {len(data)}")
    rows = data[: msg.height * msg.step].reshape(msg.height, msg.step)[:, : msg.width * pixel_size]
    if pixel_size == 1 and conversion is None:
        return rows
    pixels = rows.reshape(msg.height, msg.width, pixel_size)
    if conversion is None:
        return np.asarray(cv2.extractChannel(pixels, 0 if msg.is_bigendian else 1))
    return np.asarray(cv2.cvtColor(pixels, conversion))


def _same(frame: Image, other: Image) -> bool:
    """Whether two images are equal. The noise of a working camera already shows in a few rows, so these are compared first."""
    return np.array_equal(frame[::16], other[::16]) and np.array_equal(frame, other)


def _apart(a: Pose, b: Pose) -> bool:
    return bool(np.hypot(a.x - b.x, a.y - b.y) > REPLACED)


def main() -> None:
    run_node(TrackerNode)


if __name__ == "__main__":
    executable.main()
