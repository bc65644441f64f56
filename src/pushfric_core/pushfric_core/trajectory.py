"""Stamped poses and pusher states -> observations: smoothed, differenced and subsampled as in section 4.

The result depends only on the stamps, not on the order in which poses and pusher states arrive, because a frame is judged only
once a later pusher state is known. So a replay gives exactly the observations of the live run. There is one exception: the last
frame of an observation need not wait if it shows that the object moves on as before, because only the pusher moves it.

A tip that keeps to one straight line, as a stage's does, meets the outline where that line does. A tip that moves freely, as an
arm's does, reports another line each time; then the contact is the point of the outline nearest to the tip, whose place at a
frame lies between two reports.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pushfric_core.contact import PushingLine
from pushfric_core.observation import Observation
from pushfric_core.outline import Outline, Touch
from pushfric_core.planar import Array, Pose, Twist, inverse, rotation, transform, wrap
from pushfric_core.settings import check_ranges, setting

NANOSECONDS = 1e9

STEADY = 0.25
"""The object moves on as before if its velocity differs from the mean of earlier frames by at most this fraction. This shows a
push that ended before the last quarter of the time between two frames."""

LEAP = 0.005
"""A pose may differ from the one before it by this much [m] more than the tip's speed allows."""

PERSISTS = 3
"""This many impossible poses in a row contradict the pusher; fewer may come from a single report with a late stamp."""

LEAPS = 5.0
"""In a push, no point of an object moves faster than this multiple of the tip's speed."""

REMEMBERED = 10_000
"""Number of pusher states kept while no frame comes."""


class PoseSample(NamedTuple):
    """Where the object was seen."""

    stamp: int  # of the image [ns]
    pose: Pose  # of the object in the table frame


class PusherSample(NamedTuple):
    """A report of the pusher."""

    stamp: int  # [ns]
    position: float  # stroke [m]
    speed: float  # along the line [m/s]
    line: PushingLine  # of a tip that moves freely: through the tip, along its velocity
    push_id: int | None  # None between pushes and while retracting

    @property
    def tip(self) -> Array:
        """The centre of the tip (2,), table frame [m]."""
        return np.asarray(self.line.origin) + self.position * np.asarray(self.line.direction)


class _Frame(NamedTuple):
    """A frame in contact, and the tip that pushed."""

    stamp: int
    pose: Pose
    pusher: PusherSample  # the report before it
    tip: Array  # (2,) where it was, table frame [m]
    free: bool  # whether the reports before and after differ in their lines


@dataclass(frozen=True)
class TrajectoryConfig:
    """How poses become observations; the defaults are the paper's."""

    window: int = setting(5, "frames in the centred window that smooths the poses; odd", 1, 101)
    stride: int = setting(5, "frames from one observation of a push to the next", 1, 1000)
    contact_tolerance: float = setting(0.001, "the tip counts as touching up to this far from the outline [m]", 0.0, 0.1)
    minimum_speed: float = setting(0.002, "the object counts as moving if its fastest corner is this fast [m/s]", 0.0, 10.0)
    longest_gap: float = setting(0.5, "frames further apart than this end a run of observations [s]", 0.0, 60.0)

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.window % 2 == 0:
            raise ValueError(f"window must be odd, to be centred on a frame, got {self.window}")


class Trajectory:
    """Collects the samples of one object and returns observations as soon as they are certain.

    Args:
        outline: of the object.
        config: how poses become observations; TrajectoryConfig() by default.
        tolerance: a pose that differs by more than this [m] from what the pusher makes possible contradicts it.
    """

    def __init__(self, outline: Outline, config: TrajectoryConfig | None = None, tolerance: float = math.inf) -> None:
        self.outline = outline
        self._tolerance = tolerance
        self.config = config or TrajectoryConfig()
        self._reach = float(np.hypot(*outline.vertices.T).max())  # of the corners from the origin [m]
        self._margin = self.config.window // 2 + 1  # frames needed on either side: half a window, and a neighbour
        self._waiting: deque[PoseSample] = deque()  # frames for which no later pusher state is known yet
        self._pushers: deque[PusherSample] = deque(maxlen=REMEMBERED)  # from the last judged frame on
        self._latest_pose = -1
        self._run: list[_Frame] = []  # consecutive frames of one push, in contact
        self._pusher: PusherSample | None = None  # of the run's newest frame
        self._next = self._margin  # index in the run of the next observation
        self._before: PoseSample | None = None  # the frame before, of the same push
        self._parted: PoseSample | None = None  # the first of the consecutive frames in which the tip is away from the object
        self._wrong = 0  # number of wrong poses in a row
        self._contradiction: str | None = None

    @property
    def contradiction(self) -> str | None:
        """How the poses contradict the newest push, in words; None if the object was seen to follow the tip."""
        return self._contradiction

    @property
    def settled(self) -> int:
        """All frames up to this time [ns] have been judged; -1 until both poses and pusher states have come."""
        return min(self._latest_pose, self._pushers[-1].stamp) if self._pushers else -1

    def add_pose(self, sample: PoseSample) -> list[Observation]:
        """Take a pose and return the observations that became certain, often none. A pose older than the last is ignored.

        Raises:
            ValueError: the pose is not finite.
        """
        if not np.isfinite(sample.pose).all():
            raise ValueError(f"a pose must be finite, got {tuple(map(float, sample.pose))}")
        if sample.stamp <= self._latest_pose:
            return []
        self._latest_pose = sample.stamp
        self._waiting.append(sample)
        return self._settle()

    def add_pusher(self, sample: PusherSample) -> list[Observation]:
        """Take a pusher state and return the observations that became certain. A state older than the last is ignored."""
        if self._pushers and sample.stamp <= self._pushers[-1].stamp:
            return []
        self._pushers.append(sample)
        return self._settle()

    def _settle(self) -> list[Observation]:
        """Judge the frames before the newest pusher state; the frame after them may already complete an observation."""
        found = []
        while self._waiting:
            sample = self._waiting[0]
            # frame by frame in this order, whatever arrived first
            if self._moves_on(sample):
                assert self._pusher is not None
                found += self._complete(_Frame(*sample, self._pusher, self._pusher.tip, free=False))
            if not self._pushers or sample.stamp > self._pushers[-1].stamp:
                break
            self._waiting.popleft()
            found += self._extend(sample, self._pushing(sample))
        return found

    def _pushing(self, sample: PoseSample) -> _Frame | None:
        """A frame with the pusher at its time; None if it was not pushing an edge of the object."""
        while len(self._pushers) > 1 and self._pushers[1].stamp < sample.stamp:  # frames are judged in order of time
            self._pushers.popleft()
        if len(self._pushers) < 2 or self._pushers[0].stamp > sample.stamp:
            self._before = self._parted = None
            return None
        before, after = self._pushers[0], self._pushers[1]
        if before.push_id is None or before.push_id != after.push_id:
            self._before = self._parted = None
            return None
        share = (sample.stamp - before.stamp) / (after.stamp - before.stamp)
        tip = before.tip + share * (after.tip - before.tip)
        free = before.line != after.line
        position = before.position + share * (after.position - before.position)
        if free:
            touch: Touch | None = self.outline.nearest(transform(inverse(sample.pose), tip))
            assert touch is not None
            depth, mean = before.line.tip_radius - touch.distance, float(np.hypot(*(after.tip - before.tip)))
        else:
            touch = before.line.touch(self.outline, sample.pose)
            depth, mean = -math.inf if touch is None else position - touch.distance, after.position - before.position
        mean = mean * NANOSECONDS / (after.stamp - before.stamp)
        if self._leaps(sample, max(abs(before.speed), abs(after.speed), abs(mean))):
            return None
        self._compare(sample, depth)
        if touch is None or touch.edge is None or depth < -self.config.contact_tolerance:
            return None
        return _Frame(*sample, before, tip, free)

    def _nearest(self, tip: Array, radius: float, pose: Pose) -> Touch | None:
        """Where a tip touches an edge of the object; None if it touches a corner or nothing."""
        touch = self.outline.nearest(transform(inverse(pose), tip))
        return None if touch.edge is None or touch.distance > radius + self.config.contact_tolerance else touch

    def _leaps(self, sample: PoseSample, speed: float) -> bool:
        """Whether a pose differs from the one before it, of the same push, by more than the tip's speed allows."""
        before, self._before = self._before, sample
        if before is None:  # a new push
            self._contradiction, self._wrong = None, 0
            return False
        moved = self._moved(before, sample)
        if moved <= LEAP + LEAPS * speed * (sample.stamp - before.stamp) / NANOSECONDS:
            return False
        self._contradiction = f"the object leaps by {moved * 1e3:.0f} mm from one image to the next"
        return True

    def _compare(self, sample: PoseSample, depth: float) -> None:
        """Compare a pose with the tip, which is `depth` [m] beyond where it first touches the object."""
        if depth >= -self._tolerance:
            self._parted = None
        elif self._parted is None:
            self._parted = sample
        if depth > self._tolerance:
            wrong = f"the object does not follow the pusher: the tip would be {depth * 1e3:.0f} mm inside it"
        elif self._parted is not None and self._moved(self._parted, sample) > self._tolerance:
            wrong = f"the object moves though the tip is more than {min(-depth, 1.0) * 1e3:.0f} mm away from it"
        else:
            self._wrong = 0
            return
        self._wrong += 1
        if self._wrong >= PERSISTS:
            self._contradiction = wrong

    def _moved(self, start: PoseSample, end: PoseSample) -> float:
        """How far the fastest corner has moved at most, from one frame to another [m]."""
        a, b = start.pose, end.pose
        return float(np.hypot(b.x - a.x, b.y - a.y) + abs(wrap(b.theta - a.theta)) * self._reach)

    def _touch(self, line: PushingLine, pose: Pose) -> Touch | None:
        """Where the tip meets an edge of the object; None if it meets a corner or nothing."""
        touch = line.touch(self.outline, pose)
        return None if touch is None or touch.edge is None else touch

    def _extend(self, sample: PoseSample, frame: _Frame | None) -> list[Observation]:
        """Let a frame continue the run, or end it."""
        pusher = None if frame is None else frame.pusher
        if pusher is None or self._pusher is None or pusher.push_id != self._pusher.push_id or self._after_a_gap(sample):
            self._run, self._next = [], self._margin
        self._pusher = pusher
        if frame is None:
            return []
        found = self._complete(frame)
        self._run.append(frame)
        return found

    def _after_a_gap(self, sample: PoseSample) -> bool:
        return bool(self._run) and sample.stamp - self._run[-1].stamp > self.config.longest_gap * NANOSECONDS

    def _moves_on(self, sample: PoseSample) -> bool:
        """Whether a frame that would complete the next observation already shows that the push goes on."""
        before = self._run[self._next - self._margin :]
        if len(before) < 2 * self._margin or self._after_a_gap(sample) or any(frame.free for frame in before):
            return False
        assert self._pusher is not None
        mean, last = _velocity(before[0], before[-1]), _velocity(before[-1], sample)
        change = self._speed(Twist(*np.subtract(last, mean).tolist()))
        return change <= STEADY * self._speed(mean) and self._touch(self._pusher.line, sample.pose) is not None

    def _complete(self, newest: _Frame) -> list[Observation]:
        """The observation that the run and the frame after it complete, if there is one."""
        frames = [*self._run[self._next - self._margin :], newest]
        if len(frames) <= 2 * self._margin:
            return []
        observation = self._observe(frames)
        if observation is None:  # the object rests or the tip meets a corner; later frames of the push may give one
            self._next += 1
            return []
        self._next += self.config.stride
        return [observation]

    def _observe(self, frames: list[_Frame]) -> Observation | None:
        """The observation in the middle of some frames; None if the object rests or the smoothed contact is not on an edge."""
        assert self._pusher is not None
        assert self._pusher.push_id is not None
        middle = self._margin
        previous, pose, following = (self._smoothed(frames, middle + shift) for shift in (-1, 0, 1))
        duration = (frames[middle + 1].stamp - frames[middle - 1].stamp) / NANOSECONDS
        velocity = rotation(-pose.theta) @ (following.x - previous.x, following.y - previous.y) / duration
        twist = Twist(float(velocity[0]), float(velocity[1]), (following.theta - previous.theta) / duration)
        if not any(twist) or self._speed(twist) < self.config.minimum_speed:
            return None
        if any(frame.free for frame in frames):
            first, at, last = (self._smoothed_tip(frames, middle + shift) for shift in (-1, 0, 1))
            touch = self._nearest(at, self._pusher.line.tip_radius, pose)
            tip = rotation(-pose.theta) @ (last - first) / duration
        else:
            touch = self._touch(self._pusher.line, pose)
            tip = self._pusher.speed * rotation(-pose.theta) @ np.asarray(self._pusher.line.direction)
        if touch is None:
            return None
        return Observation(
            contact_point=(float(touch.point[0]), float(touch.point[1])),
            contact_normal=(float(touch.normal[0]), float(touch.normal[1])),
            twist=twist,
            push_id=self._pusher.push_id,
            duration=duration,
            stamp=frames[middle].stamp,
            pose=pose,
            tip_velocity=(float(tip[0]), float(tip[1])),
        )

    def _speed(self, twist: Twist) -> float:
        """Approximate speed of the fastest corner [m/s]."""
        return float(np.hypot(twist.vx, twist.vy) + abs(twist.omega) * self._reach)

    def _smoothed_tip(self, frames: list[_Frame], index: int) -> Array:
        """Mean place (2,) of the tip in the window centred on a frame, table frame [m]."""
        half = self.config.window // 2
        return np.asarray(np.mean([frame.tip for frame in frames[index - half : index + half + 1]], axis=0))

    def _smoothed(self, frames: list[_Frame], index: int) -> Pose:
        """Mean pose of the window centred on a frame, with angles unwrapped around that of the frame in the middle [rad]."""
        half, reference = self.config.window // 2, frames[self._margin].pose.theta
        window = [sample.pose for sample in frames[index - half : index + half + 1]]
        x, y = (float(np.mean(values)) for values in list(zip(*window, strict=True))[:2])
        return Pose(x, y, reference + float(np.mean([wrap(pose.theta - reference) for pose in window])))


def _velocity(start: PoseSample | _Frame, end: PoseSample | _Frame) -> Twist:
    """Velocity from one frame to another, in the table frame [m/s, m/s, rad/s]."""
    duration = (end.stamp - start.stamp) / NANOSECONDS
    a, b = start.pose, end.pose
    return Twist((b.x - a.x) / duration, (b.y - a.y) / duration, wrap(b.theta - a.theta) / duration)
