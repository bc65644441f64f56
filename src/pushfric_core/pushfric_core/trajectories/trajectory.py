"""Stamped poses and pusher states -> observations: smoothed, differenced and subsampled as in section 4.

The result depends only on the stamps, not on the order in which poses and pusher states arrive, because a frame is judged only
once a later pusher state is known. So a replay gives exactly the observations of the live run. There is one exception: the last
frame of an observation need not wait if it shows that the object moves on as before, because only the pusher moves it.

A tip that keeps to one straight line, as a stage's does, meets the outline where that line does. A tip that moves freely, as an
arm's does, reports another line each time; then the contact is the point of the outline nearest to the tip, whose place at a
frame lies between two reports.

An observation is the mean of one motion. So its window has no frame from before the contact was seen to move, and none in which
the tip may have been at rest or on its way to another speed. A tip that moves freely also keeps its direction there. The poses
show when the push of the object begins, because a busy machine puts late stamps on what the pusher reports, and reports little.
For the same reason, the velocity of a tip on its line is made of the speeds that it reports, and not of its places.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.contact import PushingLine
from pushfric_core.geometry.outline import Outline, Touch
from pushfric_core.geometry.planar import Array, Pose, Twist, inverse, rotation, transform, wrap
from pushfric_core.settings import check_ranges, setting
from pushfric_core.trajectories.clocks import Clocks, Lag, Lags
from pushfric_core.trajectories.course import Course, Planned
from pushfric_core.trajectories.ledger import (
    BETWEEN_FRAMES,
    BETWEEN_PUSHES,
    NO_PARTNER,
    NOT_PUSHED,
    NOT_SEEN,
    POSES,
    STATES,
    TOO_FEW,
    USED,
    DoubtCode,
    Ledger,
)
from pushfric_core.trajectories.observation import Observation
from pushfric_core.trajectories.stream import NANOSECONDS, Stream

STEADY = 0.25
"""The object moves on as before if its velocity differs from the mean of earlier frames by at most this fraction. This shows a
push that ended before the last quarter of the time between two frames. Likewise for the speeds in two reports of the pusher."""

UNSURE = 0.02
"""The tip's velocity is not known where reports of different speeds leave more than this fraction of it open."""

FEWEST_FRAMES = 2
"""Number of frames that show how the object moves: where reports differ, whether it moves on as before decides."""

STRAIGHT = 0.25
"""A tip turns if its unit directions in two halves differ by more than this fraction of their sum, which is 28 degrees."""

LEAP = 0.005
"""A pose may differ from the one before it by this much [m] more than the tip's speed allows."""

PERSISTS = 3
"""This many impossible poses in a row contradict the pusher; fewer may come from a single report with a late stamp."""

LEAPS = 5.0
"""In a push, no point of an object moves faster than this multiple of the tip's speed."""

APART_SHARE = 0.2
"""If the tip seems not to touch the object in less than this share of the pushes, single late stamps may be the cause."""

FOLLOWED = 0.005
"""An object whose contact has moved inward by this much [m] is pushed, whether or not the tip seems to touch it."""

REMEMBERED = 10_000
"""Number of pusher states kept while no frame comes, and of frames while no pusher state comes."""


class PoseSample(NamedTuple):
    """Where the object was seen.

    Example:
        >>> from pushfric_core import Pose, PoseSample
        >>> PoseSample(stamp=1_000_000_000, pose=Pose(0.1, 0.2, 0.0)).pose.x
        0.1
    """

    stamp: int  # of the image [ns]
    pose: Pose  # of the object in the table frame


class PusherSample(NamedTuple):
    """A report of the pusher.

    Example:
        >>> from pushfric_core import PusherSample, PushingLine
        >>> line = PushingLine(origin=(0.0, -0.1), direction=(0.0, 1.0), tip_radius=0.003)
        >>> PusherSample(1_000_000_000, 0.075, 0.02, line, push_id=0).tip.round(3).tolist()
        [0.0, -0.025]
    """

    stamp: int  # [ns]
    position: float  # stroke [m]
    speed: float  # along the line [m/s]
    line: PushingLine  # of a tip that moves freely: through the tip, along its velocity
    push_id: int | None  # None between pushes and while retracting

    @property
    def tip(self) -> Array:
        """The centre of the tip (2,), table frame [m]."""
        (x, y), (along_x, along_y) = self.line.origin, self.line.direction
        return np.array((x + self.position * along_x, y + self.position * along_y))


class _Frame(NamedTuple):
    """A frame in contact, and the tip that pushed."""

    stamp: int
    pose: Pose
    pusher: PusherSample  # the report before it
    tip: Array  # (2,) where it was, table frame [m]
    speed: float  # of the tip along its line [m/s]
    doubt: float  # the reports leave that open by this much [m/s]
    steady: bool  # whether the reports before and after have the same speed
    free: bool  # whether the reports before and after differ in their lines


class Apart(NamedTuple):
    """Pushes in which the object moves although the tip stays too far away from the outline to touch it."""

    pushes: int
    of: int  # all pushes so far
    distance: float  # the mean [m]


@dataclass(frozen=True)
class TrajectoryConfig:
    """How poses become observations; the defaults are the paper's.

    Example:
        >>> from pushfric_core import Outline, Trajectory, TrajectoryConfig
        >>> trajectory = Trajectory(Outline.rectangle(0.12, 0.06), TrajectoryConfig(window=7))
        >>> trajectory.config.stride
        5
    """

    window: int = setting(5, "frames in the centred window that smooths the poses; odd", 1, 101)
    stride: int = setting(5, "frames from one observation of a push to the next", 1, 1000)
    contact_tolerance: float = setting(0.001, "the tip counts as touching up to this far from the outline [m]", 0.0, 0.1)
    minimum_speed: float = setting(0.002, "the object counts as moving if its fastest corner is this fast [m/s]", 0.0, 10.0)
    longest_gap: float = setting(0.5, "frames further apart than this end a run of observations [s]", 0.0, 60.0)
    pose_lag: float = setting(0.0, "poses are stamped this much too late against the pusher states [s]", -1.0, 1.0)

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

    Example:
        >>> from pushfric_core import Outline, Pose, PoseSample, Trajectory
        >>> trajectory = Trajectory(Outline.rectangle(0.12, 0.06))
        >>> trajectory.add_pose(PoseSample(stamp=1_000_000_000, pose=Pose(0.0, 0.0, 0.0)))
        []
    """

    def __init__(self, outline: Outline, config: TrajectoryConfig | None = None, tolerance: float = math.inf) -> None:
        self.outline = outline
        self._tolerance = tolerance
        self.config = config or TrajectoryConfig()
        self._reach = float(np.hypot(*outline.vertices.T).max())  # of the corners from the origin [m]
        self._margin = self.config.window // 2 + 1  # frames needed on either side: half a window, and a neighbour
        self._poses: Stream[PoseSample] = Stream()
        self._states: Stream[PusherSample] = Stream(distinct=False)
        self._waiting: deque[PoseSample] = deque()  # frames for which no later pusher state is known yet
        self._pushers: deque[PusherSample] = deque()  # from the last judged frame on
        self._course = Course()
        self._lags = Lags(outline)
        self._clocks = Clocks()  # of the poses and of the pusher states
        self._partners = 0  # of the first of them, how many lie next to a frame of a push: 0, 1 or 2
        self._judged = -1  # stamp of the last judged frame [ns]
        self._taken = -1  # stamp of the frame that completed an observation before it was judged [ns]
        self._entered = 0  # frames of the run whose account is known
        self._fate = NO_PARTNER  # why the last judged frame is not in a run
        self._run: list[_Frame] = []  # consecutive frames of one push, in contact
        self._pusher: PusherSample | None = None  # of the run's newest frame
        self._next = self._margin  # index in the run of the next observation
        self._before: PoseSample | None = None  # the frame before, of the same push
        self._resting = 0  # number of frames in which the object waits for the tip
        self._rest = Pose(0.0, 0.0, 0.0)  # their mean
        self._pushed = False  # whether the contact was seen to move since
        self._tells_speed = False  # whether the pusher has ever reported a speed other than 0
        self._parted: PoseSample | None = None  # the first of the consecutive frames in which the tip is away from the object
        self._wrong = 0  # number of wrong poses in a row
        self._contradiction: str | None = None
        self._away: Pose | None = None  # where the object was when the tip, in this push, was first seen away from it
        self._apart, self._distance = 0, 0.0  # pushes in which the tip stayed away, and how far in the mean [m]
        self._apart_in: int | None = None  # the newest of them
        self._newest: int | None = None  # the newest push
        self._pushes = 0

    @property
    def contradiction(self) -> str | None:
        """How the poses contradict the newest push, in words; None if the object was seen to follow the tip."""
        return self._contradiction

    @property
    def apart(self) -> Apart | None:
        """The pushes in which the tip seems not to touch the object that it moves; None unless that happens often."""
        if self._apart < max(PERSISTS, APART_SHARE * self._pushes):
            return None
        return Apart(self._apart, self._pushes, self._distance)

    @property
    def settled(self) -> int:
        """All frames up to this time [ns] have been judged; -1 until both poses and pusher states have come."""
        pose, state = self._poses.last, self._states.last
        return -1 if pose is None or state is None else min(pose, state)

    @property
    def skew(self) -> float:
        """How far the stamps of the poses are ahead of those of the pusher states [s]; 0 until both have come."""
        pose, state = self._poses.last, self._states.last
        return 0.0 if pose is None or state is None else (pose - state) / NANOSECONDS

    @property
    def lag(self) -> Lag | None:
        """How late the poses are stamped against the pusher states; None until five pushes of a tip on its line show it."""
        return self._lags.lag

    def ledger(self, planned: Planned | None = None, numbered: bool = True, ended: bool = True) -> Ledger:
        """The account of all samples so far, if no more were to follow, and what the streams lack.

        Args:
            planned: the plan of the pushes, if it is known.
            numbered: numbers show that no message is missing.
            ended: no more samples follow, so that what they end with is the end.
        """
        ledger = Ledger()
        self._poses.close(ledger, POSES, self._states.last)
        self._states.close(ledger, STATES, self._poses.last)
        poses, states = ledger.accounts[POSES], ledger.accounts[STATES]
        poses.end(NO_PARTNER, sum(sample.stamp != self._taken for sample in self._waiting))
        poses.end(TOO_FEW, max(0, len(self._run) - self._entered))
        for number, state in enumerate(self._pushers):
            states.end(self._fate_of(state, number < self._partners, math.inf))
        for doubt in self._course.doubts(self._poses, self._states, self.config, planned, numbered, ended):
            ledger.doubt(*doubt)
        if (step := self._clocks.step) is not None:
            late = "later" if step.size > 0 else "earlier"
            text = f"the clocks step: from here on, poses are stamped {abs(step.size):.3f} s {late} against the pusher states"
            ledger.doubt(DoubtCode.CLOCKS_STEP, text, step.received)
        elif (lag := self.lag) is not None and lag.is_large:
            late = "late" if lag.mean > 0 else "early"
            text = f"the motion shows that poses are stamped {abs(lag.mean):.3f} s too {late} against the pusher states"
            text = f"{text} (90 %: within {lag.radius:.3f} s); pose_lag: {lag.mean:.3f} corrects it"
            ledger.doubt(DoubtCode.CLOCKS_DIFFER, text, self._poses.first or 0)
        return ledger

    def add_pose(self, sample: PoseSample, received: int | None = None) -> list[Observation]:
        """Take a pose and return the observations that became certain, often none. `Stream` says which poses count.

        Args:
            sample: the pose.
            received: when it was received or recorded [ns]; it shows whether clocks step.
        Raises:
            ValueError: the pose is not finite.
        """
        if not all(map(math.isfinite, sample.pose)):
            raise ValueError(f"a pose must be finite, got {tuple(map(float, sample.pose))}")
        if received is not None:
            self._clocks.add(0, sample.stamp, received)
        sample = sample._replace(stamp=sample.stamp - round(self.config.pose_lag * NANOSECONDS))
        found = []
        for known in self._poses.take(sample):
            if len(self._waiting) == REMEMBERED:
                self._poses.account.end(NO_PARTNER, self._waiting.popleft().stamp != self._taken)
            self._waiting.append(known)
            found += self._settle()
        return found

    def add_pusher(self, sample: PusherSample, received: int | None = None) -> list[Observation]:
        """Take a pusher state, received as in `add_pose`, and return the observations that became certain.

        `Stream` says which states count. One with the stamp of the last does: it is the newer one where a clock stood still.
        """
        if received is not None:
            self._clocks.add(1, sample.stamp, received)
        found = []
        for known in self._states.take(sample):
            self._course.add(known)
            self._lags.add_state(known)
            if len(self._pushers) == REMEMBERED:
                self._leave(math.inf)
            self._pushers.append(known)
            found += self._settle()
        return found

    def _settle(self) -> list[Observation]:
        """Judge the frames before the newest pusher state; the frame after them may already complete an observation."""
        found = []
        while self._waiting:
            sample = self._waiting[0]
            # frame by frame in this order, whatever arrived first
            if self._moves_on(sample):
                assert self._pusher is not None
                last = self._run[-1]
                found += self._complete(
                    _Frame(*sample, self._pusher, self._pusher.tip, last.speed, last.doubt, True, free=False)
                )
            if not self._pushers or sample.stamp > self._pushers[-1].stamp:
                break
            self._waiting.popleft()
            self._lags.add_pose(sample)
            frame = self._pushing(sample)
            self._judged = sample.stamp
            found += self._extend(sample, frame)
        return found

    def _leave(self, following: float) -> None:
        """The oldest pusher state is no longer needed; the frame after it has this stamp [ns]."""
        state = self._pushers.popleft()
        self._states.account.end(self._fate_of(state, self._partners > 0, following))
        self._partners = max(0, self._partners - 1)

    def _fate_of(self, state: PusherSample, partner: bool, following: float) -> str:
        if partner:
            return USED
        if state.push_id is None:
            return BETWEEN_PUSHES
        nearest = min(state.stamp - self._judged if self._judged >= 0 else math.inf, following - state.stamp)
        return BETWEEN_FRAMES if nearest <= self.config.longest_gap * NANOSECONDS else NOT_SEEN

    def _pushing(self, sample: PoseSample) -> _Frame | None:
        """A frame with the pusher at its time; None if it was not pushing an edge of the object."""
        while len(self._pushers) > 1 and self._pushers[1].stamp < sample.stamp:  # frames are judged in order of time
            self._leave(sample.stamp)
        self._fate = NO_PARTNER
        # whether a state follows one with the frame's own stamp is not known yet if that is the first of all
        if len(self._pushers) < 2 or self._pushers[0].stamp >= sample.stamp:
            self._before = self._parted = None
            return None
        before, after = self._pushers[0], self._pushers[1]
        if before.push_id is None or before.push_id != after.push_id or before.stamp == after.stamp:
            self._fate = BETWEEN_PUSHES
            self._before = self._parted = None
            return None
        self._fate, self._partners = NOT_PUSHED, 2
        self._pushes += before.push_id != self._newest
        self._newest = before.push_id
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
        self._tells_speed |= before.speed != 0 or after.speed != 0
        slow, fast = sorted((before.speed, after.speed) if self._tells_speed else (mean, mean))
        near = touch is not None and touch.edge is not None and depth >= -self.config.contact_tolerance
        if not near:
            self._wait(sample.pose)
            if touch is not None and touch.edge is not None:
                approach = 1.0 if free else -float(rotation(sample.pose.theta) @ touch.normal @ before.line.direction)
                self._stays_away(sample.pose, touch, -depth * approach, before.push_id)
            return None
        self._away = None
        assert touch is not None
        if not self._has_pushed(sample.pose, touch):
            return None
        steady = slow > 0 and (free or slow >= (1 - STEADY) * fast)
        return _Frame(*sample, before, tip, (slow + fast) / 2, (fast - slow) / 2, steady, free)

    def _stays_away(self, pose: Pose, touch: Touch, distance: float, push_id: int) -> None:
        """The tip of this push is at a distance [m] from the outline: count the push if the object moves all the same."""
        if self._away is None:
            self._away = pose
        moved = transform(pose, touch.point) - transform(self._away, touch.point)
        if push_id != self._apart_in and float(rotation(pose.theta) @ touch.normal @ moved) <= -FOLLOWED:
            self._apart, self._apart_in = self._apart + 1, push_id
            self._distance += (distance - self._distance) / self._apart

    def _wait(self, pose: Pose) -> None:
        """The pose in which the object is taken to rest until its contact is seen to move."""
        self._resting, self._rest, self._pushed = 1, pose, False

    def _has_pushed(self, pose: Pose, touch: Touch) -> bool:
        """Whether the contact has left the place where it rested."""
        if self._pushed:
            return True
        if self._resting:
            moved = transform(pose, touch.point) - transform(self._rest, touch.point)
            self._pushed = float(rotation(pose.theta) @ touch.normal @ moved) <= -self.config.contact_tolerance
        self._resting += 1
        self._rest = _between(self._rest, pose, 1 / self._resting)
        return self._pushed

    def _nearest(self, tip: Array, radius: float, pose: Pose) -> Touch | None:
        """Where a tip touches an edge of the object; None if it touches a corner or nothing."""
        touch = self.outline.nearest(transform(inverse(pose), tip))
        return None if touch.edge is None or touch.distance > radius + self.config.contact_tolerance else touch

    def _leaps(self, sample: PoseSample, speed: float) -> bool:
        """Whether a pose differs from the one before it, of the same push, by more than the tip's speed allows."""
        before, self._before = self._before, sample
        if before is None:  # a new push
            self._contradiction, self._wrong = None, 0
            self._away = None
            self._resting, self._pushed = 0, False
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
            self._end_run()
        self._pusher = pusher
        if frame is not None and not self._keeps_its_speed(frame):
            # with late reports, a tip that is said to rest may still move; with early stamps, one that is said to move may rest
            if frame.pusher.speed >= frame.speed and self._as_before(sample):
                frame = frame._replace(speed=self._run[-1].speed)
            elif frame.pusher.speed > frame.speed and len(self._run) < FEWEST_FRAMES:
                frame = frame._replace(speed=frame.pusher.speed)
            else:
                frame = None
                self._wait(sample.pose)
        if frame is None:
            self._end_run()
            self._poses.account.end(self._fate, sample.stamp != self._taken)
            return []
        found = self._complete(frame)
        self._run.append(frame)
        if sample.stamp == self._taken:
            self._entered = len(self._run)
        return found

    def _end_run(self) -> None:
        self._poses.account.end(TOO_FEW, max(0, len(self._run) - self._entered))
        self._run, self._next, self._entered = [], self._margin, 0

    def _keeps_its_speed(self, frame: _Frame) -> bool:
        """Whether the reports around a frame say that the tip moves as before."""
        if frame.free or not self._run:
            return frame.steady
        slow, fast = sorted((self._run[-1].speed, frame.speed))
        return frame.steady and slow >= (1 - STEADY) * fast

    def _after_a_gap(self, sample: PoseSample) -> bool:
        return bool(self._run) and sample.stamp - self._run[-1].stamp > self.config.longest_gap * NANOSECONDS

    def _moves_on(self, sample: PoseSample) -> bool:
        """Whether a frame that would complete the next observation already shows that the push goes on."""
        before = self._run[self._next - self._margin :]
        if len(before) < 2 * self._margin or any(frame.free for frame in before) or not self._as_before(sample):
            return False
        assert self._pusher is not None
        return self._touch(self._pusher.line, sample.pose) is not None

    def _as_before(self, sample: PoseSample) -> bool:
        """Whether the object moves on in a frame as in the last ones of the run."""
        before = self._run[-2 * self._margin :]
        if len(before) < FEWEST_FRAMES or self._after_a_gap(sample):
            return False
        mean, last = _velocity(before[0], before[-1]), _velocity(before[-1], sample)
        change = self._speed(Twist(*np.subtract(last, mean).tolist()))
        return change <= STEADY * self._speed(mean)

    def _complete(self, newest: _Frame) -> list[Observation]:
        """The observation that the run and the frame after it complete, if there is one."""
        frames = [*self._run[self._next - self._margin :], newest]
        if len(frames) <= 2 * self._margin:
            return []
        observation = self._observe(frames)
        if observation is None:  # the object rests or the tip meets a corner; later frames of the push may give one
            self._next += 1
            return []
        begin = max(self._entered, self._next - self._margin)
        self._poses.account.end(TOO_FEW, begin - self._entered)
        self._entered = len(self._run) + 1
        self._poses.account.end(USED, self._entered - begin)
        self._taken = newest.stamp
        self._next += self.config.stride
        return [observation]

    def _observe(self, frames: list[_Frame]) -> Observation | None:
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
        duration = time / self.config.window / NANOSECONDS
        velocity = rotation(-pose.theta) @ (following.x - previous.x, following.y - previous.y) / duration
        twist = Twist(float(velocity[0]), float(velocity[1]), (following.theta - previous.theta) / duration)
        if not any(twist) or self._speed(twist) < self.config.minimum_speed:
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
            stamp=start + round(sum(frame.stamp - start for frame in windows[1]) / self.config.window),
            pose=pose,
            tip_velocity=None if tip is None else (float(tip[0]), float(tip[1])),
            depth=line.tip_radius - float((transform(inverse(pose), at) - touch.point) @ touch.normal),
        )

    def _window(self, frames: list[_Frame], index: int) -> list[_Frame]:
        """The frames whose mean is the smoothed one at an index."""
        half = self.config.window // 2
        return frames[index - half : index + half + 1]

    def _speed(self, twist: Twist) -> float:
        """Approximate speed of the fastest corner [m/s]."""
        return float(np.hypot(twist.vx, twist.vy) + abs(twist.omega) * self._reach)

    def _mean_travel(self, frames: list[_Frame], speeds: Sequence[float]) -> float:
        """How far something at these speeds in some frames moves from the mean of one window to that of the other [m]."""
        times = [(after.stamp - before.stamp) / NANOSECONDS for before, after in pairwise(frames)]
        steps = [0.5 * (a + b) * time for (a, b), time in zip(pairwise(speeds), times, strict=True)]
        travelled = np.concatenate(((0.0,), np.cumsum(steps)))
        return float(_average(travelled[-self.config.window :]) - _average(travelled[: self.config.window]))

    def _turns(self, frames: list[_Frame]) -> bool:
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


def _between(start: Pose, end: Pose, share: float) -> Pose:
    """A pose a share of the way from one to another."""
    turn = wrap(end.theta - start.theta)
    return Pose(start.x + share * (end.x - start.x), start.y + share * (end.y - start.y), start.theta + share * turn)


def _velocity(start: PoseSample | _Frame, end: PoseSample | _Frame) -> Twist:
    """Velocity from one frame to another, in the table frame [m/s, m/s, rad/s]."""
    duration = (end.stamp - start.stamp) / NANOSECONDS
    a, b = start.pose, end.pose
    return Twist((b.x - a.x) / duration, (b.y - a.y) / duration, wrap(b.theta - a.theta) / duration)
