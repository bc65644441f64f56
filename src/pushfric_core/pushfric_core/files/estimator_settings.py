"""All settings of an estimate as one record, for files, nodes and bags; and what a user chooses instead of recorded ones."""

import dataclasses
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy.typing as npt

from pushfric_core.errors import blaming
from pushfric_core.estimation.estimator import Estimator, EstimatorConfig, Warn, usable_by
from pushfric_core.estimation.region import RegionConfig
from pushfric_core.geometry.outline import Outline
from pushfric_core.settings import merged, plain, read, setting
from pushfric_core.trajectories.observation import Observation
from pushfric_core.trajectories.samples import TrajectoryConfig
from pushfric_core.wording import shortened

TOPIC = "estimator_settings"
START_TOPIC = "estimation_start"
"""The topics on which an estimator publishes its settings, and which object it estimates since when."""


@dataclass(frozen=True)
class PushesConfig:
    """Knowledge about single pushes."""

    exclude_pushes: tuple[int, ...] = setting((), "pushes that are excluded from the start")
    slipping_pushes: tuple[int, ...] = setting((), "pushes known to slip, whose lower bounds are mu_c itself")
    keep_pushes: tuple[int, ...] = setting((), "pushes that outlier rejection keeps")


@dataclass(frozen=True)
class EstimatorSettings:
    """Everything, except the object, that decides which estimate follows from given poses. Section `estimator`."""

    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)
    trajectory: TrajectoryConfig = field(default_factory=TrajectoryConfig)
    excluded: tuple[int, ...] = ()  # ids of pushes whose observations are left out
    region: RegionConfig = field(default_factory=RegionConfig)
    slipping: tuple[int, ...] = ()  # ids of pushes whose contact is known to slip
    kept: tuple[int, ...] = ()  # ids of pushes that outlier rejection keeps

    PARTS: ClassVar = (EstimatorConfig, TrajectoryConfig, RegionConfig, PushesConfig)
    """The dataclasses whose fields are the parameters."""

    @classmethod
    def of(
        cls, estimator: EstimatorConfig, trajectory: TrajectoryConfig, region: RegionConfig, pushes: PushesConfig
    ) -> "EstimatorSettings":
        """The settings made from instances of PARTS."""
        return cls(estimator, trajectory, pushes.exclude_pushes, region, pushes.slipping_pushes, pushes.keep_pushes)

    @property
    def with_forces(self) -> bool:
        """Whether a term needs measured forces."""
        return self.estimator.needs_force

    def new_estimator(self, support_points: npt.ArrayLike, outline: Outline | None = None) -> Estimator:
        """An estimator without observations.

        Args:
            support_points: (n, 2) hypothesised supports in the object frame [m].
            outline: see `Estimator`.
        """
        estimator = Estimator(support_points, self.estimator, outline=outline)
        if self.kept:
            estimator.keep(*self.kept)
        return estimator

    def relied_on(self, data: Iterable[Observation], support_points: npt.ArrayLike, warn: Warn) -> list[Observation]:
        """The observations that the estimate of a live run would rest on: without those of pushes that are unlike the others.

        `warn` is called with a line for each push, and for each single observation, that is left out.
        """
        config = dataclasses.replace(self.estimator, tie_break=False)  # they leave out no push
        estimator = dataclasses.replace(self, estimator=config).new_estimator(support_points)
        estimator.add(usable_by(estimator, data, warn))
        for push in estimator.rejected:
            warn(f"push_id {push.push_id} is left out: {push.reason}")
        return list(estimator.observations)

    def without(self, pushes: Iterable[int]) -> "EstimatorSettings":
        """The same settings, with these pushes left out as well."""
        return dataclasses.replace(self, excluded=tuple(sorted({*self.excluded, *pushes})))

    @classmethod
    def from_parameters(cls, values: Mapping[str, Any]) -> "EstimatorSettings":
        """The settings that these parameters of the node give; all others have their defaults. `auto` stands for None.

        Raises:
            ValueError: a parameter is unknown, of another type or out of range.
        """
        return cls.of(*read(values, *cls.PARTS))

    def parameters(self) -> dict[str, Any]:
        """The parameters of the node: a list for a tuple (left out if empty), and `auto` for None."""
        return merged((self.estimator, self.trajectory, self.region, PushesConfig(self.excluded, self.slipping, self.kept)))

    def to_text(self) -> str:
        """The text that the estimator publishes."""
        return json.dumps(self.parameters())

    @classmethod
    def from_text(cls, text: str) -> "EstimatorSettings":
        """The settings that `to_text` wrote.

        Raises:
            ValueError: `to_text` did not write this text.
        """
        try:
            values = json.loads(text)
        except RecursionError as error:
            raise ValueError("the estimator's settings must be a JSON object, got lists within lists") from error
        if not isinstance(values, dict):
            raise ValueError(f"the estimator's settings must be a JSON object, got {shortened(text)}")
        return cls.from_parameters(values)


@dataclass(frozen=True)
class ChosenSettings:
    """The user's choices; everything else is as recorded."""

    estimator: Mapping[str, Any] = field(default_factory=dict)  # fields of EstimatorConfig, and pose_lag
    excluded: tuple[int, ...] = ()  # pushes that are left out, in addition to those of the recorded run
    slipping: tuple[int, ...] = ()  # pushes known to slip, in addition to those of the recorded run
    kept: tuple[int, ...] = ()  # pushes kept even if they are unlike the others, in addition to those of the recorded run

    def over(self, recorded: EstimatorSettings) -> EstimatorSettings:
        """The recorded settings, except for those that the user chose.

        Raises:
            InvalidInput: a chosen value is out of range.
        """
        given = dict(self.estimator)
        lag = given.pop("pose_lag", recorded.trajectory.pose_lag)
        if "cone" not in recorded.estimator.terms:
            given.setdefault("mu_bound", EstimatorConfig.mu_bound)  # a bound that the run did not use says nothing about mu_c
        with blaming():
            (config,) = read(plain(recorded.estimator) | given, EstimatorConfig)
            trajectory = dataclasses.replace(recorded.trajectory, pose_lag=lag)
        slipping = tuple(sorted({*recorded.slipping, *self.slipping}))
        kept = tuple(sorted({*recorded.kept, *self.kept}))
        settings = dataclasses.replace(recorded, estimator=config, trajectory=trajectory, slipping=slipping, kept=kept)
        return dataclasses.replace(settings, excluded=tuple(sorted({*recorded.excluded} - {*self.kept} | {*self.excluded})))
