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

import numpy as np

from pushfric_core.geometry.outline import Outline, Touch
from pushfric_core.geometry.planar import inverse, rotation, transform
from pushfric_core.trajectories.clocks import Clocks, Lag, Lags
from pushfric_core.trajectories.course import UNPLANNED, Course, Planned
from pushfric_core.trajectories.following import Apart, Following, Rest
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
from pushfric_core.trajectories.run import STEADY, Run
from pushfric_core.trajectories.samples import ContactFrame, PoseSample, PusherSample, TrajectoryConfig
from pushfric_core.trajectories.stream import NANOSECONDS, Stream, seconds

REMEMBERED = 10_000
"""Number of pusher states kept while no frame comes, and of frames while no pusher state comes."""


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
        self.config = config or TrajectoryConfig()
        self._poses: Stream[PoseSample] = Stream()
        self._states: Stream[PusherSample] = Stream(distinct=False)
        self._waiting: deque[PoseSample] = deque()  # frames for which no later pusher state is known yet
        self._pushers: deque[PusherSample] = deque()  # from the last judged frame on
        self._course = Course()
        self._lags = Lags(outline)
        self._clocks = Clocks()  # of the poses and of the pusher states
        self._partners = 0  # of the first of them, how many lie next to a frame of a push: 0, 1 or 2
        self._judged = -1  # stamp of the last judged frame [ns]
        self._fate = NO_PARTNER  # why the last judged frame is not in a run
        self._tells_speed = False  # whether the pusher has ever reported a speed other than 0
        self._rest = Rest(self.config.contact_tolerance)
        self._following = Following(outline, tolerance, self._rest)
        self._run = Run(outline, self.config, self._poses.account)

    @property
    def contradiction(self) -> str | None:
        """How the poses contradict the newest push, in words; None if the object was seen to follow the tip."""
        return self._following.contradiction

    @property
    def apart(self) -> Apart | None:
        """The pushes in which the tip seems not to touch the object that it moves; None unless that happens often."""
        return self._following.apart

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
    def pushes(self) -> set[int]:
        """The pushes that the pusher states tell of."""
        return {one.push_id for one in self._course.pushes}

    @property
    def lag(self) -> Lag | None:
        """How late the poses are stamped against the pusher states; None until five pushes of a tip on its line show it."""
        return self._lags.lag

    def ledger(self, planned: Planned = UNPLANNED, numbered: bool = True, ended: bool = True) -> Ledger:
        """The account of all samples so far, if no more were to follow, and what the streams lack.

        Args:
            planned: the plan of the pushes, as far as it is known.
            numbered: numbers show that no message is missing.
            ended: no more samples follow, so that what they end with is the end.
        """
        ledger = Ledger()
        self._poses.close(ledger, POSES, self._states.last)
        self._states.close(ledger, STATES, self._poses.last)
        poses, states = ledger.accounts[POSES], ledger.accounts[STATES]
        poses.end(NO_PARTNER, sum(sample.stamp != self._run.taken for sample in self._waiting))
        poses.end(TOO_FEW, self._run.open)
        for number, state in enumerate(self._pushers):
            states.end(self._fate_of(state, number < self._partners, math.inf))
        ledger.pushes = self.pushes
        for since, until in self._following.frozen.items():
            text = f"poses stayed the same to the last bit for {seconds(until - since)} of a push: the tracker stood still"
            ledger.doubt(DoubtCode.POSES_FROZEN, text, since)
        if (step := self._clocks.step) is not None:
            late = "later" if step.size > 0 else "earlier"
            text = f"the clocks step: from here on, poses are stamped {abs(step.size):.3f} s {late} against the pusher states"
            ledger.doubt(DoubtCode.CLOCKS_STEP, text, step.received)
        elif (lag := self.lag) is not None and lag.is_large:
            late = "late" if lag.mean > 0 else "early"
            text = f"the motion shows that poses are stamped {abs(lag.mean):.3f} s too {late} against the pusher states"
            text = f"{text} (90 %: within {lag.radius:.3f} s); pose_lag: {self.config.pose_lag + lag.mean:.3f} corrects it"
            ledger.doubt(DoubtCode.CLOCKS_DIFFER, text, self._poses.first or 0)
        clocks_are_wrong = {DoubtCode.CLOCKS_STEP, DoubtCode.CLOCKS_DIFFER} & {one.code for one in ledger.doubts}
        for doubt in self._course.doubts(self._poses, self._states, self.config, planned, numbered, ended):
            if doubt.code is not DoubtCode.FEW_OBSERVATIONS or not clocks_are_wrong:  # which is why they are few
                ledger.doubt(*doubt)
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
                self._poses.account.end(NO_PARTNER, self._waiting.popleft().stamp != self._run.taken)
            self._waiting.append(known)
            found += self._settle()
        return found

    def add_pusher(self, sample: PusherSample, received: int | None = None) -> list[Observation]:
        """Take a pusher state, received as in `add_pose`, and return the observations that became certain.

        `Stream` says which states count. One with the stamp of the last does: it is the newer one where a clock stood still.

        Raises:
            ValueError: position or speed are not finite.
        """
        if not math.isfinite(sample.position + sample.speed):
            raise ValueError(f"a pusher state must be finite, got position {sample.position} m and speed {sample.speed} m/s")
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
            found += self._run.foresee(sample)
            if not self._pushers or sample.stamp > self._pushers[-1].stamp:
                break
            self._waiting.popleft()
            self._lags.add_pose(sample)
            frame = self._pushing(sample)
            self._judged = sample.stamp
            kept = self._run.at_speed(sample, frame)
            if kept is None and frame is not None:
                self._rest.begin(sample.pose)
            found += self._run.extend(sample, kept, self._fate)
        for one in found:
            self._course.push_at(one.stamp).made += 1
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

    def _pushing(self, sample: PoseSample) -> ContactFrame | None:
        """A frame with the pusher at its time; None if it was not pushing an edge of the object."""
        while len(self._pushers) > 1 and self._pushers[1].stamp < sample.stamp:  # frames are judged in order of time
            self._leave(sample.stamp)
        self._fate = NO_PARTNER
        # whether a state follows one with the frame's own stamp is not known yet if that is the first of all
        if len(self._pushers) < 2 or self._pushers[0].stamp >= sample.stamp:
            self._following.pause()
            return None
        before, after = self._pushers[0], self._pushers[1]
        self._course.see(before, after, sample, self.outline.reach)
        if before.push_id is None or before.push_id != after.push_id or before.stamp == after.stamp:
            self._fate = BETWEEN_PUSHES
            self._following.pause()
            return None
        self._fate, self._partners = NOT_PUSHED, 2
        self._following.push(before.push_id)
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
        self._following.note_pose(sample, tip, depth >= -self.config.contact_tolerance)
        if self._following.leaps(sample, tip, max(abs(before.speed), abs(after.speed), abs(mean))):
            return None
        self._following.compare(sample, depth)
        self._tells_speed |= before.speed != 0 or after.speed != 0
        slow, fast = sorted((before.speed, after.speed) if self._tells_speed else (mean, mean))
        near = touch is not None and touch.edge is not None and depth >= -self.config.contact_tolerance
        if not near:
            self._rest.begin(sample.pose)
            if touch is not None and touch.edge is not None:
                approach = 1.0 if free else -float(rotation(sample.pose.theta) @ touch.normal @ before.line.direction)
                self._following.stays_away(sample.pose, touch, -depth * approach, before.push_id)
            return None
        self._following.touches()
        assert touch is not None
        if not self._rest.has_ended(sample.pose, touch):
            return None
        steady = slow > 0 and (free or slow >= (1 - STEADY) * fast)
        return ContactFrame(*sample, before, tip, (slow + fast) / 2, (fast - slow) / 2, steady, free)
