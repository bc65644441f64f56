"""Observations from what a cell measures: poses and pusher states, and the measured forces where these are needed."""

from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import rotation
from pushfric_core.trajectories.course import UNPLANNED, Planned
from pushfric_core.trajectories.ledger import NO_OBSERVATION, OBSERVATIONS, USED, WAITING, WRENCHES, Ledger
from pushfric_core.trajectories.observation import Observation
from pushfric_core.trajectories.samples import PoseSample, PusherSample, TrajectoryConfig
from pushfric_core.trajectories.stream import Stream
from pushfric_core.trajectories.trajectory import Trajectory

REMEMBERED = 100_000
"""Number of samples kept while no observation comes: 100 s of a sensor at 1 kHz."""


class ForceSample(NamedTuple):
    """A sample of the force sensor."""

    stamp: int  # [ns]
    force: tuple[float, float]  # of the pusher ON the object, table frame [N]


class ForceMatcher:
    """Gives observations their forces.

    An observation waits until a sample from after its motion has come. So only the stamps matter, not the order of arrival.
    """

    def __init__(self) -> None:
        self._stream: Stream[ForceSample] = Stream(distinct=False)
        self._samples: deque[ForceSample] = deque()
        self._used_until = -1  # the last stamp that an observation has used [ns]; those before its motion are gone
        self._waiting: deque[Observation] = deque()

    @property
    def waiting_since(self) -> int | None:
        """Stamp of the oldest waiting observation [ns]; None if no observation waits."""
        return self._waiting[0].stamp if self._waiting else None

    @property
    def waiting(self) -> int:
        """Observations that wait."""
        return len(self._waiting)

    def add_force(self, sample: ForceSample) -> list[Observation]:
        """Take a sample and return the observations that became complete. `Stream` says which samples count.

        Raises:
            ValueError: the force is not finite.
        """
        if not np.isfinite(sample.force).all():
            raise ValueError(f"a force must be finite, got {tuple(map(float, sample.force))}")
        found = []
        for known in self._stream.take(sample):
            if len(self._samples) == REMEMBERED:
                self._leave()
            self._samples.append(known)
            found += self._complete()
        return found

    def enter(self, ledger: Ledger, until: int) -> None:
        """Enter what became of all samples so far, if no more were to follow; `until` as for `Stream.close`."""
        self._stream.close(ledger, WRENCHES, until)
        account = ledger.accounts[WRENCHES]
        for sample in self._samples:
            account.end(self._fate_of(sample))

    def _leave(self) -> None:
        self._stream.account.end(self._fate_of(self._samples.popleft()))

    def _fate_of(self, sample: ForceSample) -> str:
        return USED if sample.stamp <= self._used_until else NO_OBSERVATION

    def add_observation(self, observation: Observation) -> list[Observation]:
        """Take an observation and return the observations that became complete.

        Raises:
            ValueError: the observation has no pose, so the force cannot be expressed in the object frame.
        """
        if observation.pose is None:
            raise ValueError("an observation needs its pose to be given a force")
        self._waiting.append(observation)
        return self._complete()

    def _complete(self) -> list[Observation]:
        found = []
        while self._waiting and self._samples:
            observation = self._waiting[0]
            half = round((observation.duration or 0.0) * 5e8)
            if self._samples[-1].stamp <= observation.stamp + half:
                break
            while self._samples[0].stamp < observation.stamp - half:  # observations come in order of time
                self._leave()
            during = [sample.force for sample in self._samples if sample.stamp <= observation.stamp + half]
            self._used_until = observation.stamp + half
            found.append(self._with_force(self._waiting.popleft(), during))
        return found

    @staticmethod
    def _with_force(observation: Observation, during: list[tuple[float, float]]) -> Observation:
        """The observation with the mean force in the object frame; unchanged if nothing was measured."""
        if not during:
            return observation
        assert observation.pose is not None
        x, y = rotation(-observation.pose.theta) @ np.mean(during, axis=0)
        return replace(observation, force=(float(x), float(y)))


class ObservationMaker:
    """Makes observations, live and from a bag alike, in order of time. Only the stamps of the samples matter, not their order.

    Args:
        outline: of the object.
        config: how poses become observations; TrajectoryConfig() by default.
        with_forces: an observation waits until its force has been measured.
    Attributes:
        trajectory: what makes them but for the forces.
    """

    def __init__(self, outline: Outline, config: TrajectoryConfig | None = None, with_forces: bool = False) -> None:
        self.trajectory = Trajectory(outline, config)
        self._forces = ForceMatcher() if with_forces else None

    @property
    def settled(self) -> int:
        """Time up to which all samples have become observations [ns]; 0 before the first one."""
        since = None if self._forces is None else self._forces.waiting_since
        settled = self.trajectory.settled
        return max(0, settled if since is None else min(settled, since - 1))

    @property
    def waiting(self) -> int | None:
        """Number of observations that wait for their force; None if none needs one."""
        return None if self._forces is None else self._forces.waiting

    def ledger(self, planned: Planned = UNPLANNED, numbered: bool = True, ended: bool = True) -> Ledger:
        """The account of all samples so far, as `Trajectory.ledger`. Observations that were made have no end here."""
        ledger = self.trajectory.ledger(planned, numbered, ended)
        if self._forces is not None:
            self._forces.enter(ledger, self.trajectory.settled)
            ledger.accounts[OBSERVATIONS].enter(WAITING, self._forces.waiting)
        return ledger

    def add(
        self, sample: PoseSample | PusherSample | ForceSample | Observation, received: int | None = None
    ) -> list[Observation]:
        """Take what a message holds, and return the observations that became complete; an observation is one.

        Args:
            sample: from the message; of the force only if observations are made with forces.
            received: as for `Trajectory.add_pose`.
        Raises:
            ValueError: the sample is impossible, or not on the object.
        """
        if isinstance(sample, Observation):
            sample.check_contact(self.trajectory.outline)
            return [sample]
        if isinstance(sample, ForceSample):
            if self._forces is None:
                raise ValueError("observations are made without forces here")
            return self._forces.add_force(sample)
        if isinstance(sample, PoseSample):
            made = self.trajectory.add_pose(sample, received)
        else:
            made = self.trajectory.add_pusher(sample, received)
        if self._forces is None:
            return made
        return [complete for observation in made for complete in self._forces.add_observation(observation)]
