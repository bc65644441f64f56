"""The tracker node: camera images -> the object's pose on the table."""

import array
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
from pushfric_core.cell.node_settings import (
    CameraConfig,
    FrameConfig,
    Images,
    ImagesConfig,
    ObjectConfig,
    RequiredSubscribersConfig,
)
from pushfric_core.errors import InvalidInput
from pushfric_core.files.object_file import load_object
from pushfric_core.geometry.frames import CAMERA, TABLE
from pushfric_core.geometry.planar import Pose
from pushfric_core.plugins import chosen_tracker, tracker_kinds
from pushfric_core.vision.camera import Image, load_camera
from pushfric_core.vision.frame_source import TOPICS, Device
from pushfric_core.vision.image_messages import image_from_msg
from pushfric_core.vision.keyframes import KEYFRAMES, Keyframes, RunState
from pushfric_core.vision.overlay import Overlay
from pushfric_core.vision.sighting import UNMEASURED, NotSeen, Sighting, Tracker
from pushfric_msgs.msg import PlanProgress, PusherState
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

DISORDER = 1_000_000_000
"""Frames that are late by up to this [ns] are dropped; a longer step back means that the clock was reset."""

REPLACED = 0.03
"""An object that moves farther than this [m] between two frames was moved by hand."""

UNWATCHED = 0.2
"""In a gap of this length [s] between frames, a person can turn the object: its last orientation then no longer decides among
those that look alike."""

FROZEN_FRAMES = 3
"""This many identical frames in a row mean that the camera is frozen."""

JPEG_QUALITY = 95
"""Quality of recorded images."""

MOST_KEYFRAMES = 15e6
"""Size of all keyframes of a run [byte]."""

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
        self._images = declare(self, ImagesConfig).images
        self._keyframes = Keyframes(self._images is Images.ALL) if self._images is not Images.OFF else None
        self._pushes, self._recorded = False, 0  # whether a push is under way; bytes of keyframes
        if self._keyframes is not None:
            self._keyframe_out = topics.advertise(CompressedImage, KEYFRAMES, RELIABLE)
            self.create_subscription(PusherState, "pusher_state", self._on_pusher_state, SENSOR_DATA)
        topics.subscribe(PoseStamped, "placement", self._on_placement, LATCHED)
        self.create_subscription(PlanProgress, "plan_progress", self._on_plan, LATCHED)
        self._transforms = TransformBroadcaster(self, prefix, fixed=True)
        self._transforms.broadcast(camera_transform(*self._camera.pose()))
        self._device: Device | None = None
        self._source = TOPICS.get(config.source, config.source)
        if config.source == "topic":
            topics.subscribe(ImageMsg, self._source, self._on_image, IMAGE_QUEUE)
        elif config.source == "compressed":
            topics.subscribe(CompressedImage, self._source, self._on_image, IMAGE_QUEUE)
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

    def _on_image(self, msg: ImageMsg | CompressedImage) -> None:
        try:
            frame = image_from_msg(msg)
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
        if self._keyframes is not None:
            self._record(self._keyframes.take(frame, stamp, self._moment()))
        if self._overlay_out.get_subscription_count() and time.monotonic() - self._overlay_time >= OVERLAY_PERIOD:
            self._publish_overlay(frame, stamp)

    def _moment(self) -> RunState:
        return RunState(self._pushes, self._placed, self._in_sight)

    def _record(self, chosen: list[tuple[int, Image]]) -> None:
        """Publish images for the bag."""
        for stamp, frame in chosen:
            _, jpeg = cv2.imencode(".jpg", frame, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))
            self._recorded += len(jpeg)
            if self._images is Images.KEYFRAMES and self._recorded > MOST_KEYFRAMES:
                self._complain(f"no more keyframes are recorded: the bag has {MOST_KEYFRAMES / 1e6:g} MB of them")
                self._keyframes = None
                return
            msg = CompressedImage(format="jpeg", data=array.array("B", jpeg.tobytes()))
            msg.header.stamp, msg.header.frame_id = self._shifted(stamp), CAMERA
            self._keyframe_out.publish(msg)

    def _on_pusher_state(self, msg: PusherState) -> None:
        self._pushes = msg.push_id != PusherState.NO_PUSH

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


def _same(frame: Image, other: Image) -> bool:
    """Whether two images are equal. The noise of a working camera already shows in a few rows, so these are compared first."""
    return np.array_equal(frame[::16], other[::16]) and np.array_equal(frame, other)


def _apart(a: Pose, b: Pose) -> bool:
    return bool(np.hypot(a.x - b.x, a.y - b.y) > REPLACED)


def main() -> None:
    run_node(TrackerNode)


if __name__ == "__main__":
    executable.main()
