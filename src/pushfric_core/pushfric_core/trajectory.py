"""Stamped poses and pusher states -> observations: smoothed, differenced and subsampled as in section 4.

The result depends on the stamps alone, not on how poses and pusher states interleave when they arrive: a frame is judged
only once a pusher state from after it is known. So a replay gives exactly the observations of the live run.
"""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pushfric_core.contact import PushingLine
from pushfric_core.observation import Observation
from pushfric_core.outline import Outline
from pushfric_core.planar import Pose, Twist, rotation, wrap
from pushfric_core.settings import check_ranges, setting

NANOSECONDS = 1e9

REMEMBERED = 10_000
"""Pusher states kept while no frame comes."""


class PoseSample(NamedTuple):
    """Where the object was seen."""

    stamp: int  # of the image [ns]
    pose: Pose  # of the object in the table frame


class PusherSample(NamedTuple):
    """What the pusher said of itself."""

    stamp: int  # [ns]
    position: float  # stroke [m]
    speed: float  # along the line [m/s]
    line: PushingLine
    push_id: int | None  # None between pushes and while retracting


@dataclass(frozen=True)
class TrajectoryConfig:
    """How poses become observations; the defaults are the paper's."""

    window: int = setting(5, "frames in the centred window that smooths the poses; odd", 1, 101)
    stride: int = setting(5, "frames from one observation of a push to the next", 1, 1000)
    contact_tolerance: float = setting(0.001, "the tip counts as touching up to this far from the outline [m]", 0.0, 0.1)
    minimum_speed: float = setting(0.002, "the object counts as moving when its fastest corner does this much [m/s]", 0.0, 10.0)
    longest_gap: float = setting(0.5, "frames further apart than this end a run of observations [s]", 0.0, 60.0)

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.window % 2 == 0:
            raise ValueError(f"window must be odd, to be centred on a frame, got {self.window}")


class Trajectory:
    """Collects the samples of one object and gives observations as soon as they are certain."""

    def __init__(self, outline: Outline, config: TrajectoryConfig | None = None) -> None:
        self.outline = outline
        self.config = config or TrajectoryConfig()
        self._margin = self.config.window // 2 + 1  # frames needed on either side: half a window, and a neighbour
        self._waiting: deque[PoseSample] = deque()  # seen, but no later pusher state is known yet
        self._pushers: deque[PusherSample] = deque(maxlen=REMEMBERED)  # from the last judged frame on
        self._latest_pose = -1
        self._run: list[PoseSample] = []  # consecutive frames of one push, in contact
        self._pusher: PusherSample | None = None  # of the run's newest frame
        self._next = self._margin  # index in the run of the next observation

    @property
    def settled(self) -> int:
        """All frames up to this time [ns] were judged; -1 before both poses and pusher states came."""
        return min(self._latest_pose, self._pushers[-1].stamp) if self._pushers else -1

    def add_pose(self, sample: PoseSample) -> list[Observation]:
        """Take a pose; returns the observations that became certain, often none. A pose older than the last is ignored.

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
        """Take a pusher state; returns the observations that became certain. A state older than the last is ignored."""
        if self._pushers and sample.stamp <= self._pushers[-1].stamp:
            return []
        self._pushers.append(sample)
        return self._settle()

    def _settle(self) -> list[Observation]:
        """Judge the frames from before the newest pusher state."""
        found = []
        while self._waiting and self._pushers and self._waiting[0].stamp <= self._pushers[-1].stamp:
            sample = self._waiting.popleft()
            found += self._extend(sample, self._pushing(sample))
        return found

    def _pushing(self, sample: PoseSample) -> PusherSample | None:
        """The pusher at the time of a frame; None where it was not pushing an edge of the object forward."""
        while len(self._pushers) > 1 and self._pushers[1].stamp < sample.stamp:  # frames are judged in order of time
            self._pushers.popleft()
        if len(self._pushers) < 2 or self._pushers[0].stamp > sample.stamp:
            return None
        before, after = self._pushers[0], self._pushers[1]
        if before.push_id is None or before.push_id != after.push_id or before.line != after.line:
            return None
        share = (sample.stamp - before.stamp) / (after.stamp - before.stamp)
        position = before.position + share * (after.position - before.position)
        touch = before.line.touch(self.outline, sample.pose)
        if touch is None or touch.edge is None or position < touch.distance - self.config.contact_tolerance:
            return None
        return before

    def _extend(self, sample: PoseSample, pusher: PusherSample | None) -> list[Observation]:
        """Let a frame continue the run, or end it."""
        gap = self._run and (sample.stamp - self._run[-1].stamp) > self.config.longest_gap * NANOSECONDS
        if pusher is None or self._pusher is None or pusher.push_id != self._pusher.push_id or gap:
            self._run, self._next = [], self._margin
        self._pusher = pusher
        if pusher is None:
            return []
        self._run.append(sample)
        if len(self._run) <= self._next + self._margin:
            return []
        observation = self._observe(pusher)
        if observation is None:  # the object rests, or a corner is met: later frames of the push may still serve
            self._next += 1
            return []
        self._next += self.config.stride
        return [observation]

    def _observe(self, pusher: PusherSample) -> Observation | None:
        """The observation at the run's next index; None where the object does not move or the smoothed contact is no edge."""
        assert pusher.push_id is not None
        sample = self._run[self._next]
        previous, middle, following = (self._smoothed(self._next + shift, sample.pose.theta) for shift in (-1, 0, 1))
        duration = (self._run[self._next + 1].stamp - self._run[self._next - 1].stamp) / NANOSECONDS
        velocity = rotation(-middle.theta) @ (following.x - previous.x, following.y - previous.y) / duration
        twist = Twist(float(velocity[0]), float(velocity[1]), (following.theta - previous.theta) / duration)
        reach = float(np.hypot(*self.outline.vertices.T).max())
        touch = pusher.line.touch(self.outline, middle)
        if touch is None or touch.edge is None:
            return None
        if not any(twist) or np.hypot(twist.vx, twist.vy) + abs(twist.omega) * reach < self.config.minimum_speed:
            return None
        return Observation(
            contact_point=(float(touch.point[0]), float(touch.point[1])),
            contact_normal=(float(touch.normal[0]), float(touch.normal[1])),
            twist=twist,
            push_id=pusher.push_id,
            duration=duration,
            stamp=sample.stamp,
            pose=middle,
        )

    def _smoothed(self, index: int, reference: float) -> Pose:
        """Mean pose of the window centred on a frame of the run, with angles unwrapped around `reference` [rad]."""
        half = self.config.window // 2
        window = [sample.pose for sample in self._run[index - half : index + half + 1]]
        x, y = (float(np.mean(values)) for values in list(zip(*window, strict=True))[:2])
        return Pose(x, y, reference + float(np.mean([wrap(pose.theta - reference) for pose in window])))
