"""A run of frames in which the tip pushes -> observations: smoothed, differenced and subsampled as in section 4.

An observation is the mean of one motion. So its window has no frame from before the contact was seen to move, and none in which
the tip may have been at rest or on its way to another speed. A tip that moves freely also keeps its direction there. The poses
show when the push of the object begins, because a busy machine puts late stamps on what the pusher reports, and reports little.
For the same reason, the velocity of a tip on its line is made of the speeds that it reports, and not of its places.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.contact import PushingLine
from pushfric_core.geometry.outline import Outline, Touch
from pushfric_core.geometry.planar import Array, Pose, Twist, inverse, rotation, transform, wrap
from pushfric_core.trajectories.ledger import TOO_FEW, USED, Account
from pushfric_core.trajectories.observation import Observation
from pushfric_core.trajectories.samples import ContactFrame, PoseSample, PusherSample, TrajectoryConfig
from pushfric_core.trajectories.stream import NANOSECONDS

STEADY = 0.25
"""The object moves on as before if its velocity differs from the mean of earlier frames by at most this fraction. This shows a
push that ended before the last quarter of the time between two frames. Likewise for the speeds in two reports of the pusher."""

UNSURE = 0.02
"""The tip's velocity is not known where reports of different speeds leave more than this fraction of it open."""

FEWEST_FRAMES = 2
"""Number of frames that show how the object moves: where reports differ, whether it moves on as before decides."""

STRAIGHT = 0.25
"""A tip turns if its unit directions in two halves differ by more than this fraction of their sum, which is 28 degrees."""


class Run:
    """Consecutive frames of one push, in contact.

    Args:
        outline: of the object.
        config: how poses become observations.
        account: of the poses.
    Attributes:
        taken: stamp of the frame that completed an observation before it was judged [ns]; -1: none did.
    """

    def __init__(self, outline: Outline, config: TrajectoryConfig, account: Account) -> None:
        self._outline, self._config, self._account = outline, config, account
        self._margin = config.window // 2 + 1  # frames needed on either side: half a window, and a neighbour
        self._frames: list[ContactFrame] = []
        self._pusher: PusherSample | None = None  # of the newest frame
        self._next = self._margin  # index in the run of the next observation
        self._entered = 0  # frames whose account is known
        self.taken = -1

    @property
    def open(self) -> int:
        """Number of frames whose account is not known yet."""
        return max(0, len(self._frames) - self._entered)

    def foresee(self, sample: PoseSample) -> list[Observation]:
        """The observation that a frame completes before it is judged, because it shows that the push goes on."""
        if not self._moves_on(sample):
            return []
        assert self._pusher is not None
        last = self._frames[-1]
        return self._complete(ContactFrame(*sample, self._pusher, self._pusher.tip, last.speed, last.doubt, True, free=False))

    def at_speed(self, sample: PoseSample, frame: ContactFrame | None) -> ContactFrame | None:
        """Begin another run if the frame is of another push; the frame with the speed that its tip must have had.

        None if it is none of a push, or its tip may have been at rest or on its way to another speed.
        """
        pusher = None if frame is None else frame.pusher
        if pusher is None or self._pusher is None or pusher.push_id != self._pusher.push_id or self._after_a_gap(sample):
            self._end()
        self._pusher = pusher
        if frame is None or self._keeps_its_speed(frame):
            return frame
        # with late reports, a tip that is said to rest may still move; with early stamps, one that is said to move may rest
        if frame.pusher.speed >= frame.speed and self._as_before(sample):
            return frame._replace(speed=self._frames[-1].speed)
        if frame.pusher.speed > frame.speed and len(self._frames) < FEWEST_FRAMES:
            return frame._replace(speed=frame.pusher.speed)
        return None

    def extend(self, sample: PoseSample, frame: ContactFrame | None, fate: str) -> list[Observation]:
        """Let a frame continue the run, or end it; `fate`: of a sample that is none of a push."""
        if frame is None:
            self._end()
            self._account.end(fate, sample.stamp != self.taken)
            return []
        found = self._complete(frame)
        self._frames.append(frame)
        if sample.stamp == self.taken:
            self._entered = len(self._frames)
        return found

    def _end(self) -> None:
        self._account.end(TOO_FEW, self.open)
        self._frames, self._next, self._entered = [], self._margin, 0

    def _keeps_its_speed(self, frame: ContactFrame) -> bool:
        """Whether the reports around a frame say that the tip moves as before."""
        if frame.free or not self._frames:
            return frame.steady
        slow, fast = sorted((self._frames[-1].speed, frame.speed))
        return frame.steady and slow >= (1 - STEADY) * fast

    def _after_a_gap(self, sample: PoseSample) -> bool:
        return bool(self._frames) and sample.stamp - self._frames[-1].stamp > self._config.longest_gap * NANOSECONDS

    def _moves_on(self, sample: PoseSample) -> bool:
        """Whether a frame that would complete the next observation already shows that the push goes on."""
        before = self._frames[self._next - self._margin :]
        if len(before) < 2 * self._margin or any(frame.free for frame in before) or not self._as_before(sample):
            return False
        assert self._pusher is not None
        return self._touch(self._pusher.line, sample.pose) is not None

    def _as_before(self, sample: PoseSample) -> bool:
        """Whether the object moves on in a frame as in the last ones of the run."""
        before = self._frames[-2 * self._margin :]
        if len(before) < FEWEST_FRAMES or self._after_a_gap(sample):
            return False
        mean, last = _velocity(before[0], before[-1]), _velocity(before[-1], sample)
        change = self._speed(Twist(*np.subtract(last, mean).tolist()))
        return change <= STEADY * self._speed(mean)

    def _complete(self, newest: ContactFrame) -> list[Observation]:
        """The observation that the run and the frame after it complete, if there is one."""
        frames = [*self._frames[self._next - self._margin :], newest]
        if len(frames) <= 2 * self._margin:
            return []
        observation = self._observe(frames)
        if observation is None:  # the object rests or the tip meets a corner; later frames of the push may give one
            self._next += 1
            return []
        begin = max(self._entered, self._next - self._margin)
        self._account.end(TOO_FEW, begin - self._entered)
        self._entered = len(self._frames) + 1
        self._account.end(USED, self._entered - begin)
        self.taken = newest.stamp
        self._next += self._config.stride
        return [observation]

    def _observe(self, frames: list[ContactFrame]) -> Observation | None:
        """The observation in the middle of some frames.

        None if the object rests, the smoothed contact is not on an edge, or the tip turns.
        """
        assert self._pusher is not None
        assert self._pusher.push_id is not None
        windows = [self._window(frames, self._margin + shift) for shift in (-1, 0, 1)]
        previous, pose, following = (
            _mean([frame.pose for frame in window], frames[self._margin].pose.theta) for window in windows
        )
        # as much time as lies between the means, also where images come irregularly
        time = sum(after.stamp - before.stamp for before, after in zip(windows[0], windows[2], strict=True))
        duration = time / self._config.window / NANOSECONDS
        velocity = rotation(-pose.theta) @ (following.x - previous.x, following.y - previous.y) / duration
        twist = Twist(float(velocity[0]), float(velocity[1]), (following.theta - previous.theta) / duration)
        if not any(twist) or self._speed(twist) < self._config.minimum_speed:
            return None
        first, at, last = (_average([frame.tip for frame in window]) for window in windows)
        line = self._pusher.line
        tip: Array | None = None
        if any(frame.free for frame in frames):
            if self._turns(frames):
                return None
            touch = self._nearest(at, line.tip_radius, pose)
            tip = rotation(-pose.theta) @ (last - first) / duration
        else:
            touch = self._touch(line, pose)
            speeds = ([frame.speed for frame in frames], [frame.doubt for frame in frames])
            travel, doubt = (self._mean_travel(frames, some) for some in speeds)
            if doubt <= UNSURE * travel:
                tip = travel / duration * rotation(-pose.theta) @ np.asarray(line.direction)
        if touch is None:
            return None
        start = frames[0].stamp
        return Observation(
            contact_point=(float(touch.point[0]), float(touch.point[1])),
            contact_normal=(float(touch.normal[0]), float(touch.normal[1])),
            twist=twist,
            push_id=self._pusher.push_id,
            duration=duration,
            stamp=start + round(sum(frame.stamp - start for frame in windows[1]) / self._config.window),
            pose=pose,
            tip_velocity=None if tip is None else (float(tip[0]), float(tip[1])),
            depth=line.tip_radius - float((transform(inverse(pose), at) - touch.point) @ touch.normal),
        )

    def _window(self, frames: list[ContactFrame], index: int) -> list[ContactFrame]:
        """The frames whose mean is the smoothed one at an index."""
        half = self._config.window // 2
        return frames[index - half : index + half + 1]

    def _touch(self, line: PushingLine, pose: Pose) -> Touch | None:
        """Where the tip meets an edge of the object; None if it meets a corner or nothing."""
        touch = line.touch(self._outline, pose)
        return None if touch is None or touch.edge is None else touch

    def _nearest(self, tip: Array, radius: float, pose: Pose) -> Touch | None:
        """Where a tip touches an edge of the object; None if it touches a corner or nothing."""
        touch = self._outline.nearest(transform(inverse(pose), tip))
        return None if touch.edge is None or touch.distance > radius + self._config.contact_tolerance else touch

    def _speed(self, twist: Twist) -> float:
        """Approximate speed of the fastest corner [m/s]."""
        return float(np.hypot(twist.vx, twist.vy) + abs(twist.omega) * self._outline.reach)

    def _mean_travel(self, frames: list[ContactFrame], speeds: Sequence[float]) -> float:
        """How far something at these speeds in some frames moves from the mean of one window to that of the other [m]."""
        times = [(after.stamp - before.stamp) / NANOSECONDS for before, after in pairwise(frames)]
        steps = [0.5 * (a + b) * time for (a, b), time in zip(pairwise(speeds), times, strict=True)]
        travelled = np.concatenate(((0.0,), np.cumsum(steps)))
        return float(_average(travelled[-self._config.window :]) - _average(travelled[: self._config.window]))

    def _turns(self, frames: list[ContactFrame]) -> bool:
        """Whether a free tip moves in one direction in the first half of some frames and in another in the second."""
        first, middle, last = (frames[index].tip for index in (0, self._margin, -1))
        lengths = [float(np.hypot(*half)) for half in (middle - first, last - middle)]
        if not min(lengths) > 0:
            return True
        before, after = (middle - first) / lengths[0], (last - middle) / lengths[1]
        return float(np.hypot(*(after - before))) > STRAIGHT * float(np.hypot(*(after + before)))


def _mean(poses: list[Pose], reference: float) -> Pose:
    """Mean of some poses, with angles unwrapped around a reference [rad]."""
    x, y = (float(_average([pose[axis] for pose in poses])) for axis in (0, 1))
    return Pose(x, y, reference + float(_average([wrap(pose.theta - reference) for pose in poses])))


def _average(values: npt.ArrayLike) -> Array:
    """The mean over the first axis; np.mean takes three times as long for few values, to the same bits."""
    array = np.asarray(values)
    return np.asarray(np.add.reduce(array) / len(array))


def _velocity(start: PoseSample | ContactFrame, end: PoseSample | ContactFrame) -> Twist:
    """Velocity from one frame to another, in the table frame [m/s, m/s, rad/s]."""
    duration = (end.stamp - start.stamp) / NANOSECONDS
    a, b = start.pose, end.pose
    return Twist((b.x - a.x) / duration, (b.y - a.y) / duration, wrap(b.theta - a.theta) / duration)
