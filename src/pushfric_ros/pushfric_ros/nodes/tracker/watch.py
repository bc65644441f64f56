"""The search for the object in frame after frame."""

from collections.abc import Callable

import numpy as np

from pushfric_core.geometry.planar import Pose
from pushfric_core.trajectories.stream import DISORDER
from pushfric_core.vision.camera import Camera, Image
from pushfric_core.vision.sighting import NotSeen, Sighting, Tracker

REPLACED = 0.03
"""An object that moves farther than this [m] between two frames was moved by hand."""

UNWATCHED = 0.2
"""In a gap of this length [s] between frames, a person can turn the object: its last orientation then no longer decides among
those that look alike."""

FROZEN_FRAMES = 3
"""This many identical frames in a row mean that the camera is frozen."""


class Watch:
    """Knows where the object is in the newest frame, or why it is not seen there.

    Args:
        camera: whose frames come.
        tracker: of the object.
        complain: of the node; it is told why frames are unusable.
    Attributes:
        placement: where the object is to be placed, until it is seen there.
        sighting: in the newest frame; None: it is not seen.
        reason: why it was not seen when it last was not.
        counts: numbers of frames, by what became of them.
    """

    def __init__(self, camera: Camera, tracker: Tracker, complain: Callable[[str], None]) -> None:
        self._camera, self._tracker, self._complain = camera, tracker, complain
        self._stamp = 0  # of the newest frame [ns]
        self._frame: Image | None = None  # the newest
        self._alike = 1  # number of identical frames in a row, up to the newest
        self._last: Pose | None = None  # where the object was last seen
        self._since = 0  # stamp of the frame since which it is in sight without a break [ns]; 0: it is not
        self.placement: Pose | None = None
        self.sighting: Sighting | None = None
        self.reason = "no frame yet"
        self.counts = dict.fromkeys(("frames", "seen", "late frames dropped", "unusable frames"), 0)

    def place(self, pose: Pose, stamp: int) -> None:
        """The object is to be placed there, as was said at this time [ns]."""
        self.placement = pose
        if 0 < stamp < self._since:  # it came later than frames that show the object placed
            self._since = 0

    def take(self, frame: Image, stamp: int) -> bool:
        """Look for the object in a frame of this time [ns]; False: the frame is unusable, or came late."""
        width, height = self._camera.width, self._camera.height
        if frame.shape != (height, width):
            image = f"the image has {frame.shape[1]} x {frame.shape[0]}"
            self.refuse(f"the camera is calibrated for {width} x {height} px, {image}")
        elif not stamp:
            self.refuse("the images carry no time stamp")
        elif -DISORDER < stamp - self._stamp <= 0:
            self.counts["late frames dropped"] += 1
        else:
            self._look(frame, stamp)
            return True
        return False

    def refuse(self, why: str) -> None:
        """Count a frame that is unusable."""
        self.counts["unusable frames"] += 1
        self._lose(why)
        self._complain(f"frames are unusable: {why}")

    def _lose(self, why: str) -> None:
        self.sighting, self.reason, self._since = None, why, 0

    def _look(self, frame: Image, stamp: int) -> None:
        if not 0 < stamp - self._stamp <= UNWATCHED * 1e9:
            self._since = 0
        self._stamp = stamp
        self.counts["frames"] += 1
        self._alike = self._alike + 1 if self._frame is not None and _same(frame, self._frame) else 1
        self._frame = frame
        try:
            if self._alike >= FROZEN_FRAMES:
                raise NotSeen("frozen frame")
            self.sighting = self._find(frame)
        except NotSeen as reason:
            self._lose(str(reason))
        else:
            self.counts["seen"] += 1
            self._last, self._since = self.sighting.pose, self._since or stamp

    def _find(self, frame: Image) -> Sighting:
        """Find the object, and choose among orientations that look the same.

        While the object stays in sight, its last pose decides; when it returns, the pose in which it was to be placed does.
        """
        awaited, followed = self.placement or self._last, self._last if self._since else None
        sighting = self._tracker.track(frame, followed or awaited)
        if followed and _apart(sighting.pose, followed):
            sighting, followed = self._tracker.track(frame, awaited), None
        if self.placement and not followed and not _apart(sighting.pose, self.placement):
            self.placement = None
        return sighting


def _same(frame: Image, other: Image) -> bool:
    """Whether two images are equal. The noise of a working camera already shows in a few rows, so these are compared first."""
    return np.array_equal(frame[::16], other[::16]) and np.array_equal(frame, other)


def _apart(a: Pose, b: Pose) -> bool:
    return bool(np.hypot(a.x - b.x, a.y - b.y) > REPLACED)
