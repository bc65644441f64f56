"""Images in messages: sensor_msgs/Image in many encodings, and sensor_msgs/CompressedImage."""

import math
from typing import Any

import cv2
import numpy as np

from pushfric_core.vision.camera import Image, picture_from

TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
"""The types of messages that hold an image."""

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


def image_from_msg(msg: Any) -> Image:
    """The image (height, width) in grey levels of a message of one of TYPES.

    Raises:
        ValueError: the message holds no picture.
    """
    return grey_from_msg(msg) if hasattr(msg, "encoding") else picture_from(np.frombuffer(msg.data, np.uint8), msg.format)


def grey_from_msg(msg: Any) -> Image:
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
