"""Observations from what a cell measures: poses and pusher states, and the measured forces where these are needed."""

from pushfric_core.geometry.outline import Outline
from pushfric_core.trajectories.course import UNPLANNED, Planned
from pushfric_core.trajectories.ledger import OBSERVATIONS, WAITING, Ledger
from pushfric_core.trajectories.observation import Observation
from pushfric_core.trajectories.samples import PoseSample, PusherSample, TrajectoryConfig
from pushfric_core.trajectories.sensed_force import ForceMatcher, ForceSample
from pushfric_core.trajectories.trajectory import Trajectory


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

    def add_pose(self, sample: PoseSample, received: int | None = None) -> list[Observation]:
        """Take a pose, and return the observations that became complete; arguments and errors as `Trajectory.add_pose`."""
        return self._with_forces(self.trajectory.add_pose(sample, received))

    def add_pusher(self, sample: PusherSample, received: int | None = None) -> list[Observation]:
        """Take a pusher state, and return the observations that became complete."""
        return self._with_forces(self.trajectory.add_pusher(sample, received))

    def add_force(self, sample: ForceSample) -> list[Observation]:
        """Take a sample of the force, and return the observations that became complete.

        Raises:
            ValueError: the force is not finite, or observations are made without forces.
        """
        if self._forces is None:
            raise ValueError("observations are made without forces here")
        return self._forces.add_force(sample)

    def _with_forces(self, made: list[Observation]) -> list[Observation]:
        if self._forces is None:
            return made
        return [complete for observation in made for complete in self._forces.add_observation(observation)]
