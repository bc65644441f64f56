"""From an image to the object's pose: cameras, calibration, frame sources and trackers."""
