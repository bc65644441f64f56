"""From an image to the object's pose: cameras, calibration, frame sources and trackers."""

import os

PIXEL_LIMIT = 10**8
"""Largest number of pixels of a picture that is decoded."""

# OpenCV reads it as it is loaded, which is after this; it would otherwise allocate 2^30 bytes for a picture of 74
os.environ["OPENCV_IO_MAX_IMAGE_PIXELS"] = str(PIXEL_LIMIT)
