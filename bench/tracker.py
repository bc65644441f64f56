"""The speed of the contour tracker, compared with bare OpenCV on the same frames in the same run."""

import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from pushfric_core import Pose
from pushfric_core.simulated.camera import SimulatedCamera
from pushfric_core.vision.camera import Camera, Image
from pushfric_core.vision.contour_tracker import ContourTracker

FRAMES = 120
STEPS = ROUNDS = 9
HEIGHT = 0.01
OUTLINE = np.array(((-1, -1), (1, -1), (1, 1), (-1, 1))) * (0.0635, 0.032)
"""The paper's rectangle [m]; its length covers a quarter of the width of a 640 x 480 image."""


def measure(progress: Callable[[str], None]) -> dict[str, Any]:
    """Frames per second of thread CPU time, and the time of a frame divided by that of bare OpenCV.

    `tracked`: the object is close to where it was in the last frame. `found`: nothing is known about where it is. Bare OpenCV
    runs blur, Otsu's threshold, findContours and minAreaRect. The ratio is the median over rounds in which the three take
    turns, so that a busy machine slows all alike.
    """
    camera = Camera.looking_down(640, 480, (0.1, 0.05), 0.000625, distortion=(-0.2, 0.05, 0.001, -0.001, 0.0))
    simulation = SimulatedCamera(camera, OUTLINE, HEIGHT, np.random.default_rng(0), noise_sigma=8.0, shadow=(1.0, 0.3, 380.0))
    truths = [Pose(0.08 + 0.0004 * i, 0.05 + 0.0001 * i, 0.3 + 0.01 * i) for i in range(FRAMES)]
    frames = [simulation.render(truth) for truth in truths]
    tracker = ContourTracker(camera, OUTLINE, HEIGHT)

    def tracked() -> None:
        last = truths[0]
        for frame in frames:
            last = tracker.track(frame, last).pose

    def found() -> None:
        for frame in frames:
            tracker.track(frame)

    def bare() -> None:
        for frame in frames:
            _bare_opencv(frame)

    ways = {"tracked": tracked, "found": found, "bare": bare}
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        for number in range(ROUNDS):
            progress(f"tracker: round {number + 1} of {ROUNDS}")
            for name, way in ways.items():
                start = time.thread_time()
                way()
                seconds[name].append((time.thread_time() - start) / FRAMES)
    finally:
        cv2.setNumThreads(threads)
    figures: dict[str, Any] = {f"{name}_fps": 1 / float(np.median(seconds[name])) for name in ways}
    for name in ("tracked", "found"):
        figures[f"{name}_ratio"] = float(np.median(np.divide(seconds[name], seconds["bare"])))
    return figures


def _bare_opencv(frame: Image) -> Any:
    """The least that a plain tracker would do: the rotated box around the largest blob."""
    _, bright = cv2.threshold(cv2.GaussianBlur(frame, (5, 5), 0), 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    contours, _ = cv2.findContours(bright, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    return cv2.minAreaRect(max(contours, key=cv2.contourArea))
