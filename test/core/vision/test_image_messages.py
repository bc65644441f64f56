"""Images of every encoding that cameras send, as grey pictures."""

import array
import re

import cv2
import numpy as np
import pytest
from sensor_msgs.msg import Image

from pushfric_core.vision.image_messages import TO_GREY, grey_from_msg


def picture():
    """A colour picture, (24, 32, 3) BGR; smooth, because mosaics and YUV have fewer pixels for colour than for grey."""
    row, column = np.mgrid[0:24, 0:32]
    return np.stack((90 + 3 * column, 200 - 4 * row, 60 + 2 * row + 2 * column), axis=2).astype(np.uint8)


def rows_of(bgr, encoding):
    """A picture (height, width, 3) as the rows of bytes of a message in this encoding."""
    height, width = bgr.shape[:2]
    grey = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)
    if encoding in ("yuyv", "yuv422_yuy2"):
        return cv2.cvtColor(bgr, cv2.COLOR_BGR2YUV_YUY2).reshape(height, -1)
    if encoding in ("uyvy", "yuv422"):
        return cv2.cvtColor(bgr, cv2.COLOR_BGR2YUV_UYVY).reshape(height, -1)
    if encoding in ("nv12", "nv21"):
        planar = cv2.cvtColor(bgr, cv2.COLOR_BGR2YUV_I420)
        u, v = planar[height:].reshape(2, height // 2, width // 2)
        colours = (u, v) if encoding == "nv12" else (v, u)
        return np.vstack((planar[:height], np.stack(colours, axis=2).reshape(height // 2, width)))
    if encoding == "nv24":  # OpenCV cannot encode it; any colours will do
        luminance = cv2.cvtColor(bgr, cv2.COLOR_BGR2YUV_I420)[:height]
        return np.vstack((luminance, np.full((2 * height, width), 77, np.uint8)))
    if encoding.startswith("bayer"):
        mosaic = np.empty((height, width), np.uint8)
        for number, colour in enumerate(encoding.removeprefix("bayer_")[:4]):
            row, column = divmod(number, 2)
            mosaic[row::2, column::2] = bgr[row::2, column::2, "bgr".index(colour)]
        return mosaic
    if encoding == "mono8":
        return grey
    bgra = np.dstack((bgr, np.full((height, width), 255, np.uint8)))
    return bgra[..., ["bgra".index(colour) for colour in encoding[:-1]]].reshape(height, -1)


def message(rows, height, width, encoding, padding=0, **fields):
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=255)
    data = array.array("B", rows.tobytes())
    return Image(height=height, width=width, encoding=encoding, step=rows.shape[1], data=data, **fields)


EIGHT_BIT = [encoding for encoding in TO_GREY if encoding != "mono16"]


@pytest.mark.parametrize("padding", [0, 6])
@pytest.mark.parametrize("encoding", EIGHT_BIT)
def test_every_encoding_gives_the_grey_picture(encoding, padding):
    grey = cv2.cvtColor(picture(), cv2.COLOR_BGR2GRAY)
    seen = grey_from_msg(message(rows_of(picture(), encoding), 24, 32, encoding, padding))
    assert (seen.shape, seen.dtype) == (grey.shape, np.uint8)
    if encoding.startswith(("yu", "uy", "nv")):
        grey = 16 + grey * (219 / 255)  # luminance has video range, 16 to 235 (BT.601)
    inner = np.s_[1:-1, 1:-1] if encoding.startswith("bayer") else np.s_[:]  # pixels at the border lack neighbours
    np.testing.assert_allclose(seen[inner].astype(float), grey[inner], atol=2 if encoding.startswith("bayer") else 1)


@pytest.mark.parametrize("padding", [0, 6])
@pytest.mark.parametrize(("big", "order"), [(0, "<u2"), (1, ">u2")])
def test_the_upper_8_of_16_bits_are_used_in_either_byte_order(big, order, padding):
    values = np.arange(24 * 32).reshape(24, 32) * 80 + 123
    rows = values.astype(order).view(np.uint8)
    np.testing.assert_array_equal(grey_from_msg(message(rows, 24, 32, "mono16", padding, is_bigendian=big)), values // 256)


@pytest.mark.parametrize("encoding", EIGHT_BIT)
def test_images_cut_short_are_refused(encoding):
    rows = rows_of(picture(), encoding)
    msg = message(rows, 24, 32, encoding)
    msg.data.pop()
    text = f"32 x 24 {encoding} with step {rows.shape[1]} must have {rows.size} bytes, got {rows.size - 1}"
    with pytest.raises(ValueError, match=re.escape(text)):
        grey_from_msg(msg)
    msg.step = 1
    with pytest.raises(ValueError, match=f"32 x 24 {encoding} must have a step of {32 * TO_GREY[encoding][0]} or more, got 1"):
        grey_from_msg(msg)


def test_an_odd_number_of_rows_needs_one_more_row_of_colours():
    rows = rows_of(picture(), "nv12")
    seen = grey_from_msg(message(np.vstack((rows[:23], rows[24:])), 23, 32, "nv12"))
    np.testing.assert_array_equal(seen, rows[:23])


def test_padded_rows_are_read_without_a_copy():
    rows = np.arange(24, dtype=np.uint8).reshape(3, 8)
    msg = Image(height=3, width=5, encoding="mono8", step=8, data=array.array("B", rows.tobytes()))
    grey = grey_from_msg(msg)
    np.testing.assert_array_equal(grey, rows[:, :5])
    msg.data[0] = 99
    assert grey[0, 0] == 99
