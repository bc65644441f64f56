"""The pictures that the tracker node publishes: keyframes for a bag, and the overlay."""

import array
import time

import cv2
import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage

from pushfric_core.bags.run_record import KEYFRAMES
from pushfric_core.cell.node_settings import Images, ImagesConfig
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import CAMERA, Array, Pose, transform
from pushfric_core.vision.camera import Camera, Image
from pushfric_core.vision.keyframes import Keyframes, RunState
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


class KeyframeRecording:
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


class OverlayDrawing:
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


SEEN, GHOST, PLACED, AXES = (0, 200, 0), (0, 140, 255), (255, 200, 80), (255, 255, 255)  # BGR
DASH, AXIS = 0.006, 0.03
"""Lengths of a dash and of an axis of the table or of the object [m]."""

FINE = 4  # binary places of a drawn coordinate
FONT = cv2.FONT_HERSHEY_SIMPLEX


class Overlay:
    """A picture in colours with the table's axes, to draw on; all that is drawn on the table is given in the table frame [m].

    Args:
        frame: the camera's picture (height, width) in grey levels.
        camera: its calibration.
        outline: of the object.
        height: of the outline above the table [m].
    Attributes:
        picture: (height, width, 3), BGR.
    """

    def __init__(self, frame: Image, camera: Camera, outline: Outline, height: float) -> None:
        self.picture = cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR)
        self._camera, self._outline, self._height = camera, outline, height
        self._size = max(1, round(frame.shape[1] / 640))  # of lines [px]
        self._axes(Pose(0.0, 0.0, 0.0), 0.0)

    def seen(self, pose: Pose) -> None:
        """The object where it is seen."""
        self._line(transform(pose, self._outline.vertices), SEEN, True)
        self._axes(pose, self._height)

    def ghost(self, place: Pose, seen: Pose | None, in_place: bool) -> None:
        """Where the object is to be placed: dashed, with an arrow from where it is seen, or whole once it lies there."""
        corners = transform(place, self._outline.vertices)
        if in_place:
            self._line(corners, PLACED, True)
            self._write("in place", (place.x, place.y), PLACED)
            return
        for begin, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            count = max(1, round(float(np.linalg.norm(end - begin)) / DASH / 2))
            for dash in range(count):
                self._line(np.array([begin + (dash + share) / count * (end - begin) for share in (0.0, 0.5)]), GHOST)
        self._axes(place, self._height, GHOST)
        if seen is not None:
            way = np.array(((seen.x, seen.y), (place.x, place.y)))
            self._arrow(way, self._height, GHOST)
            distance = float(np.linalg.norm(way[1] - way[0]))
            self._write(f"{distance * 1e3:.0f} mm", tuple(way.mean(axis=0)), GHOST)

    def say(self, text: str) -> None:
        """A line of text in the corner."""
        cv2.putText(self.picture, text, (8, 20), FONT, 0.5 * self._size, (0, 200, 255), self._size, cv2.LINE_AA)

    def _axes(self, pose: Pose, height: float, colour: tuple[int, int, int] = AXES) -> None:
        for tip, name in (((AXIS, 0.0), "x"), ((0.0, AXIS), "y")):
            ends = transform(pose, np.array(((0.0, 0.0), tip)))
            self._arrow(ends, height, colour)
            self._write(name, tuple(ends[1]), colour, height)

    def _pixels(self, points: Array, height: float) -> Array:
        seen = self._camera.project(points, height)
        return np.rint(np.clip(seen, -1e4, 1e4) * (1 << FINE)).astype(np.int32)

    def _line(self, points: Array, colour: tuple[int, int, int], closed: bool = False) -> None:
        pixels = self._pixels(points, self._height)
        cv2.polylines(self.picture, [pixels], closed, colour, self._size, cv2.LINE_AA, FINE)

    def _arrow(self, ends: Array, height: float, colour: tuple[int, int, int]) -> None:
        begin, end = (tuple(map(int, pixel)) for pixel in self._pixels(ends, height))
        for shade, thickness in (((0, 0, 0), 3 * self._size), (colour, self._size)):  # seen on dark and bright ground
            cv2.arrowedLine(self.picture, begin, end, shade, thickness, cv2.LINE_AA, FINE, 0.15)

    def _write(self, text: str, point: tuple[float, ...], colour: tuple[int, int, int], height: float | None = None) -> None:
        (u, v), size = self._pixels(np.array([point]), self._height if height is None else height)[0] >> FINE, self._size
        for shade, thickness in (((0, 0, 0), 3 * size), (colour, size)):
            cv2.putText(self.picture, text, (int(u) + 4, int(v) - 4), FONT, 0.5 * size, shade, thickness, cv2.LINE_AA)
