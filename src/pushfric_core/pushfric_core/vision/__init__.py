"""From an image to the object's pose: cameras, calibration, frame sources and trackers."""

import os
from importlib.util import find_spec

from pushfric_core.errors import MissingPackage, installing

PIXEL_LIMIT = 10**8
"""Largest number of pixels of a picture that is decoded."""

if find_spec("cv2") is None:  # not imported here: a process that only writes a calibration needs none of its 13 MB
    raise MissingPackage(f"vision needs the package cv2 (opencv-python-headless): {installing('vision')}")

# OpenCV reads it as it is loaded, which is after this; it would otherwise allocate 2^30 bytes for a picture of 74
os.environ["OPENCV_IO_MAX_IMAGE_PIXELS"] = str(PIXEL_LIMIT)
