"""Video files for the tests of what reads them."""

import cv2


def save_video(path, frames, rate) -> None:
    """Write grey frames of one size."""
    video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), rate, frames[0].shape[::-1], isColor=False)
    for frame in frames:
        video.write(frame)
    video.release()
