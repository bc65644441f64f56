"""The settings of an estimation from a file: those recorded with it, except for those that the user chose."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pushfric_core.errors import InvalidInput
from pushfric_core.estimation.estimator import EstimatorConfig
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.settings import plain, read


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
        try:
            (config,) = read(plain(recorded.estimator) | given, EstimatorConfig)
            trajectory = dataclasses.replace(recorded.trajectory, pose_lag=lag)
        except ValueError as error:
            raise InvalidInput(str(error)) from error
        slipping = tuple(sorted({*recorded.slipping, *self.slipping}))
        kept = tuple(sorted({*recorded.kept, *self.kept}))
        settings = recorded.without(self.excluded)
        return dataclasses.replace(settings, estimator=config, trajectory=trajectory, slipping=slipping, kept=kept)
