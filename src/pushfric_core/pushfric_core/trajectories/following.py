"""Whether an object follows the tip that pushes it: when it begins to, and whether its poses are possible.

A busy machine puts late stamps on what the pusher reports, so it takes several poses, or pushes, to contradict it.
"""

from typing import NamedTuple

import numpy as np

from pushfric_core.geometry.outline import Outline, Touch
from pushfric_core.geometry.planar import Array, Pose, rotation, transform, wrap
from pushfric_core.trajectories.samples import PoseSample
from pushfric_core.trajectories.stream import NANOSECONDS

LEAP = 0.005
"""A pose may differ from the one before it by this much [m] more than the tip's speed and way allow."""

PERSISTS = 3
"""This many impossible poses in a row contradict the pusher; fewer may come from a single report with a late stamp."""

LEAPS = 5.0
"""In a push, no point of an object moves faster, nor farther, than this multiple of the tip's speed and way."""

APART_SHARE = 0.2
"""If the tip seems not to touch the object in less than this share of the pushes, single late stamps may be the cause."""

FROZEN = 0.005
"""A pose that stays the same to the last bit while the tip of a push goes farther than this [m] is no news of the object."""

FOLLOWED = 0.005
"""An object whose contact has moved inward by this much [m] is pushed, whether or not the tip seems to touch it."""


class Apart(NamedTuple):
    """Pushes in which the object moves although the tip stays too far away from the outline to touch it."""

    pushes: int
    of: int  # all pushes so far
    distance: float  # the mean [m]


class Rest:
    """The object waits for the tip until its contact is seen to move by a tolerance [m]."""

    def __init__(self, tolerance: float) -> None:
        self._tolerance = tolerance
        self.forget()

    def forget(self) -> None:
        """A new push: nothing was seen of it yet."""
        self._frames, self._pose, self._ended = 0, Pose(0.0, 0.0, 0.0), False

    def begin(self, pose: Pose) -> None:
        """The object is taken to rest in this pose."""
        self._frames, self._pose, self._ended = 1, pose, False

    def has_ended(self, pose: Pose, touch: Touch) -> bool:
        """Whether the contact has left the place where it rested, the mean of these poses."""
        if self._ended:
            return True
        if self._frames:
            moved = transform(pose, touch.point) - transform(self._pose, touch.point)
            self._ended = float(rotation(pose.theta) @ touch.normal @ moved) <= -self._tolerance
        self._frames += 1
        self._pose = _between(self._pose, pose, 1 / self._frames)
        return self._ended


class Following:
    """Judges the poses of push after push.

    Args:
        outline: of the object.
        tolerance: a pose that differs by more than this [m] from what the tip makes possible contradicts it.
        rest: is forgotten at each new push.
    Attributes:
        contradiction: how the poses contradict the newest push, in words; None if the object was seen to follow the tip.
        frozen: since when the object was seen in one pose although the tip went on, and until when [ns].
    """

    def __init__(self, outline: Outline, tolerance: float, rest: Rest) -> None:
        self._outline, self._tolerance, self._rest = outline, tolerance, rest
        self.contradiction: str | None = None
        self._before: PoseSample | None = None  # the frame before, of the same push
        self._tip = np.zeros(2)  # where the tip was then
        self._parted: PoseSample | None = None  # the first of the consecutive frames in which the tip is away from the object
        self._wrong = 0  # number of wrong poses in a row
        self._away: Pose | None = None  # where the object was when the tip, in this push, was first seen away from it
        self._apart, self._distance = 0, 0.0  # pushes in which the tip stayed away, and how far in the mean [m]
        self._apart_in: int | None = None  # the newest of them
        self._newest: int | None = None  # the newest push
        self._pushes = 0
        self.frozen: dict[int, int] = {}
        self._same = (-1, np.zeros(2))  # since when it is seen in one pose [ns], and where the tip was then

    @property
    def apart(self) -> Apart | None:
        """The pushes in which the tip seems not to touch the object that it moves; None unless that happens often."""
        if self._apart < max(PERSISTS, APART_SHARE * self._pushes):
            return None
        return Apart(self._apart, self._pushes, self._distance)

    def pause(self) -> None:
        """There is no push."""
        self._before = self._parted = None

    def push(self, push_id: int) -> None:
        """A frame of this push comes."""
        self._pushes += push_id != self._newest
        self._newest = push_id

    def note_pose(self, sample: PoseSample, tip: Array, near: bool) -> None:
        """Note whether the object is seen in the same pose as before, while the tip (2,) [m] near it goes on."""
        if self._before is None or sample.pose != self._before.pose or not near:
            self._same = sample.stamp, tip
        elif np.hypot(*(tip - self._same[1])) > FROZEN:
            self.frozen[self._same[0]] = sample.stamp

    def touches(self) -> None:
        """The tip touches the object."""
        self._away = None

    def stays_away(self, pose: Pose, touch: Touch, distance: float, push_id: int) -> None:
        """The tip of this push is at a distance [m] from the outline: count the push if the object moves all the same."""
        if self._away is None:
            self._away = pose
        moved = transform(pose, touch.point) - transform(self._away, touch.point)
        if push_id != self._apart_in and float(rotation(pose.theta) @ touch.normal @ moved) <= -FOLLOWED:
            self._apart, self._apart_in = self._apart + 1, push_id
            self._distance += (distance - self._distance) / self._apart

    def leaps(self, sample: PoseSample, tip: Array, speed: float) -> bool:
        """Whether a pose differs from the one before it, of the same push, by more than the tip allows.

        Args:
            sample: the pose.
            tip: (2,) where the tip is [m]; it may have gone there since the pose before, and rest by now.
            speed: of the tip [m/s].
        """
        before, self._before = self._before, sample
        tip_before, self._tip = self._tip, tip
        if before is None:  # a new push
            self.contradiction, self._wrong = None, 0
            self._away = None
            self._rest.forget()
            return False
        way = moved(before.pose, sample.pose, self._outline.reach)
        tips_way = max(speed * (sample.stamp - before.stamp) / NANOSECONDS, float(np.hypot(*(tip - tip_before))))
        if way <= LEAP + LEAPS * tips_way:
            return False
        self.contradiction = f"the object leaps by {way * 1e3:.0f} mm from one image to the next"
        return True

    def compare(self, sample: PoseSample, depth: float) -> None:
        """Compare a pose with the tip, which is `depth` [m] beyond where it first touches the object."""
        if depth >= -self._tolerance:
            self._parted = None
        elif self._parted is None:
            self._parted = sample
        if depth > self._tolerance:
            wrong = f"the object does not follow the pusher: the tip would be {depth * 1e3:.0f} mm inside it"
        elif self._parted is not None and moved(self._parted.pose, sample.pose, self._outline.reach) > self._tolerance:
            wrong = f"the object moves though the tip is more than {min(-depth, 1.0) * 1e3:.0f} mm away from it"
        else:
            self._wrong = 0
            return
        self._wrong += 1
        if self._wrong >= PERSISTS:
            self.contradiction = wrong


def moved(start: Pose, end: Pose, reach: float) -> float:
    """How far the fastest corner has moved at most, if it is this far from the origin [m]."""
    return float(np.hypot(end.x - start.x, end.y - start.y) + abs(wrap(end.theta - start.theta)) * reach)


def _between(start: Pose, end: Pose, share: float) -> Pose:
    """A pose a share of the way from one to another."""
    turn = wrap(end.theta - start.theta)
    return Pose(start.x + share * (end.x - start.x), start.y + share * (end.y - start.y), start.theta + share * turn)
