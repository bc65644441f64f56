"""The tracker node: camera images -> the object's pose on the table."""

import functools
import time
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage
from sensor_msgs.msg import Image as ImageMsg

from pushfric_core.bags.samples import pose_from_msg, stamp_from_msg
from pushfric_core.cell.node_settings import CameraConfig, FrameConfig, ObjectConfig, RequiredSubscribersConfig
from pushfric_core.errors import blaming
from pushfric_core.files.object_file import load_object
from pushfric_core.geometry.planar import TABLE
from pushfric_core.plugins import chosen_tracker, tracker_kinds
from pushfric_core.vision.camera import Image, load_camera
from pushfric_core.vision.frame_source import TOPICS, Device
from pushfric_core.vision.image_messages import image_from_msg
from pushfric_core.vision.sighting import UNMEASURED
from pushfric_msgs.msg import PlanProgress
from pushfric_ros.messages.conversions import pose_to_msg, stamp_to_msg
from pushfric_ros.node_kit.diagnostics import NO_POSE, Diagnostics, Health, Level
from pushfric_ros.node_kit.heartbeat import Heartbeat
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE
from pushfric_ros.node_kit.required_subscribers import RequiredSubscribers
from pushfric_ros.node_kit.transforms import TransformBroadcaster, camera_transform
from pushfric_ros.nodes.tracker.pictures import KeyframeRecording, OverlayDrawing
from pushfric_ros.nodes.tracker.watch import Watch

IMAGE_QUEUE = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Holds more than a second of frames, so that none is lost in a busy moment."""

MESSAGES: dict[str, type[Any]] = {"topic": ImageMsg, "compressed": CompressedImage}
"""Types of the messages of `TOPICS`."""


class TrackerNode(Node):
    """Publishes the object's pose for every frame that shows it, and nothing for the others."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("tracker", **kwargs)
        name = declare(self, ObjectConfig).object
        prefix = declare(self, FrameConfig).within(self.get_namespace())
        config = declare(self, CameraConfig)
        with blaming(self.get_fully_qualified_name()):
            driver = chosen_tracker([declare(self, kind) for kind in tracker_kinds(config.tracker)])
        model, camera = load_object(name), load_camera(config.calibration)
        height = config.object_height or model.height
        self._object = model.name
        self._offset = round(config.time_offset * 1e9)  # added to the stamps of what is published [ns]
        self._complain = functools.cache(self.get_logger().error)  # a line once, however often it is true
        self._watch = Watch(camera, driver.open_tracker(camera, model, height), self._complain)
        self._placed = False  # whether the object lies in place for a push
        self._reported = (time.monotonic(), 0, 0)
        self._latency = 0.0

        topics = Diagnostics(self, self._health, prefix)
        Heartbeat(self)
        self._pose_out = topics.advertise(PoseWithCovarianceStamped, "object_pose", RELIABLE)
        heard_by = declare(self, RequiredSubscribersConfig).heard_by
        self._required_subscribers = RequiredSubscribers(self, self._pose_out, heard_by)
        self._drawing = OverlayDrawing(topics, camera, model.outline, height)
        self._recording = KeyframeRecording(self, topics)
        topics.subscribe(PoseStamped, "placement", self._on_placement, LATCHED)
        self.create_subscription(PlanProgress, "plan_progress", self._on_plan, LATCHED)
        self._transforms = TransformBroadcaster(self, prefix, fixed=True)  # late subscribers receive from it, too
        self._transforms.broadcast(camera_transform(*camera.pose()))
        self._source = TOPICS.get(config.source, config.source)
        self._device: Device | None = None
        if config.source in TOPICS:
            topics.subscribe(MESSAGES[config.source], self._source, self._on_image, IMAGE_QUEUE)
            return
        arrived, size = self.create_guard_condition(self._on_device_frames), (camera.width, camera.height)
        self._device = Device(config.source, size, lambda: self.get_clock().now().nanoseconds, arrived.trigger)
        self._device.start()

    def destroy_node(self) -> None:
        """Release the camera, too."""
        if self._device is not None:
            self._device.close()
        super().destroy_node()

    def _on_placement(self, msg: PoseStamped) -> None:
        try:
            self._watch.place(pose_from_msg(msg.pose), stamp_from_msg(msg.header.stamp))
        except ValueError as error:
            self._complain(f"placement ignored: {error}")

    def _on_plan(self, msg: PlanProgress) -> None:
        """Draw where the object is to be placed, while a person places it."""
        self._placed = msg.in_place
        try:
            self._drawing.ghost = pose_from_msg(msg.placement) if msg.phase == PlanProgress.PHASE_PLACING else None
        except ValueError:  # the topic placement has the same pose, and its callback complains
            self._drawing.ghost = None

    def _on_image(self, msg: ImageMsg | CompressedImage) -> None:
        try:
            frame = image_from_msg(msg)
        except ValueError as error:
            self._watch.refuse(str(error))
        else:
            self._on_frame(stamp_from_msg(msg.header.stamp), frame)

    def _on_device_frames(self) -> None:
        while self._device is not None and self._device.frames:
            self._on_frame(*self._device.frames.popleft())

    def _on_frame(self, stamp: int, frame: Image) -> None:
        watch, published = self._watch, stamp + self._offset
        if not watch.take(frame, stamp):
            return
        if watch.sighting is not None:
            msg = PoseWithCovarianceStamped()
            msg.header.stamp, msg.header.frame_id = stamp_to_msg(published), TABLE
            msg.pose.pose = pose_to_msg(watch.sighting.pose)
            covariance = UNMEASURED * np.eye(6)
            covariance[np.ix_((0, 1, 5), (0, 1, 5))] = watch.sighting.covariance
            msg.pose.covariance = covariance.ravel()
            if not self._required_subscribers.missing:
                self._pose_out.publish(msg)
            self._latency = (self.get_clock().now().nanoseconds - stamp) / 1e9
        self._recording.take(frame, published, self._placed, watch.sighting is not None)
        self._drawing.show(frame, published, watch, self._placed)

    def _health(self) -> Health:
        now, watch = time.monotonic(), self._watch
        then, frames_before, seen_before = self._reported
        self._reported = now, watch.counts["frames"], watch.counts["seen"]
        frames, seen = watch.counts["frames"] - frames_before, watch.counts["seen"] - seen_before
        values = {
            "object": self._object,
            "frames/s": round(frames / max(now - then, 1e-9), 1),
            **watch.counts,
            "last reason": watch.reason,
            "latency [s]": round(self._latency, 4),
        }
        if (sighting := watch.sighting) is not None:
            values |= {"residual [px]": round(sighting.residual_px, 3), "orientations": sighting.orientations}
            values["visible"] = round(sighting.visible_fraction, 2)
        if self._device is not None:
            values["device frames dropped"] = self._device.dropped
        values[NO_POSE] = why = self._without_pose(frames, seen)
        if why:
            level = Level.WARN if frames else Level.ERROR
            return Health(level, f"not seen: {why}" if frames and not seen else why, values)
        if sighting is not None and sighting.doubt:
            return Health(Level.WARN, f"seen, but {sighting.doubt}", values)
        return Health(Level.OK, "seen", values)

    def _without_pose(self, frames: int, seen: int) -> str:
        """Why these frames gave no pose; empty if they did."""
        if not frames:
            return f"no frames from {self._source}"
        if not seen:
            return self._watch.reason
        missing = self._required_subscribers.missing
        return f"waiting for {', '.join(missing)} to receive the poses" if missing else ""


def main() -> None:
    run_node(TrackerNode, images=True)
