"""The pictures that the tracker node publishes: keyframes for a bag, and the overlay."""

import array
import time

import cv2
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage

from pushfric_core.cell.node_settings import Images, ImagesConfig
from pushfric_core.geometry.frames import CAMERA
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Pose
from pushfric_core.vision.camera import Camera, Image
from pushfric_core.vision.keyframes import KEYFRAMES, Keyframes, RunState
from pushfric_core.vision.overlay import Overlay
from pushfric_msgs.msg import PusherState
from pushfric_ros.messages.conversions import stamp_to_msg
from pushfric_ros.node_kit.diagnostics import Diagnostics
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.qos import RELIABLE, SENSOR_DATA
from pushfric_ros.nodes.tracker.watch import Watch

JPEG_QUALITY = 95
"""Quality of recorded images."""

MOST_KEYFRAMES = 15e6
"""Size of all keyframes of a run [byte]."""

OVERLAY_PERIOD = 0.2
"""Least time between overlays [s]."""


class Recording:
    """Publishes the images that a bag is to hold.

    Args:
        node: the tracker's.
        topics: of the node.
    """

    def __init__(self, node: Node, topics: Diagnostics) -> None:
        self._images, self._log = declare(node, ImagesConfig).images, node.get_logger()
        self._keyframes = Keyframes(self._images is Images.ALL) if self._images is not Images.OFF else None
        self._pushes, self._size = False, 0  # whether a push is under way; bytes of keyframes
        if self._keyframes is not None:
            self._out = topics.advertise(CompressedImage, KEYFRAMES, RELIABLE)
            node.create_subscription(PusherState, "pusher_state", self._on_pusher_state, SENSOR_DATA)

    def take(self, frame: Image, stamp: int, placed: bool, in_sight: bool) -> None:
        """Publish what is to be kept now that a new frame has come: this one, an earlier one, both or none.

        Args:
            frame: the new one.
            stamp: its time, as published [ns].
            placed: whether the object lies in place for a push.
            in_sight: whether the frame shows it.
        """
        now = RunState(self._pushes, placed, in_sight)
        for taken, picture in self._keyframes.take(frame, stamp, now) if self._keyframes is not None else ():
            msg = _jpeg(picture, taken, cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY)
            self._size += len(msg.data)
            if self._images is Images.KEYFRAMES and self._size > MOST_KEYFRAMES:
                self._log.error(f"no more keyframes are recorded: the bag has {MOST_KEYFRAMES / 1e6:g} MB of them")
                self._keyframes = None
                return
            self._out.publish(msg)

    def _on_pusher_state(self, msg: PusherState) -> None:
        self._pushes = msg.push_id != PusherState.NO_PUSH


class Drawing:
    """Publishes the overlay, if anybody looks.

    Args:
        topics: of the node.
        camera: whose frames are drawn on.
        outline: of the object.
        height: of the outline above the table [m].
    Attributes:
        ghost: where a person is to place the object now; None: nowhere.
    """

    def __init__(self, topics: Diagnostics, camera: Camera, outline: Outline, height: float) -> None:
        self._camera, self._outline, self._height = camera, outline, height
        self._out = topics.advertise(CompressedImage, "overlay/compressed", SENSOR_DATA)
        self._time = 0.0  # of the last one, by time.monotonic() [s]
        self.ghost: Pose | None = None

    def show(self, frame: Image, stamp: int, watch: Watch, placed: bool) -> None:
        """Publish the frame with the object as it is seen, or the reason why it is not, and where it is to be placed.

        Args:
            frame: the new one.
            stamp: its time, as published [ns].
            watch: it has looked at the frame.
            placed: whether the object lies in place for a push.
        """
        if not self._out.get_subscription_count() or time.monotonic() - self._time < OVERLAY_PERIOD:
            return
        self._time = time.monotonic()
        overlay, seen = Overlay(frame, self._camera, self._outline, self._height), watch.sighting
        overlay.table()
        if seen is not None:
            overlay.seen(seen.pose)
        if self.ghost is not None:
            overlay.ghost(self.ghost, seen and seen.pose, placed)
        overlay.say(f"{seen.residual_px:.2f} px" if seen else watch.reason.partition(":")[0])
        self._out.publish(_jpeg(overlay.picture, stamp))


def _jpeg(picture: Image, stamp: int, *options: int) -> CompressedImage:
    _, jpeg = cv2.imencode(".jpg", picture, options)
    msg = CompressedImage(format="jpeg", data=array.array("B", jpeg.tobytes()))
    msg.header.stamp, msg.header.frame_id = stamp_to_msg(stamp), CAMERA
    return msg
