"""The estimate from a bag or CSV."""

import pathlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pushfric_core.bags.recorded import Recorded
from pushfric_core.estimation.estimate import Estimate
from pushfric_core.estimation.estimate_report import EstimateReport
from pushfric_core.estimation.estimator import Estimator, Warn, last, usable_by
from pushfric_core.files.estimator_settings import ChosenSettings, EstimatorSettings
from pushfric_core.files.model_file import ModelFile, make_model
from pushfric_core.files.object_file import ObjectModel
from pushfric_core.offline.inputs import object_of, with_support
from pushfric_core.trajectories.ledger import Ledger
from pushfric_core.trajectories.observation import Observation


@dataclass(frozen=True)
class Choices:
    """The caller's choices, the same for every input."""

    object_name: str = ""  # name of the object, or path of its YAML; empty: the one next to the bag
    grid: tuple[int, int] | None = None
    support_points: pathlib.Path | None = None
    settings: ChosenSettings = field(default_factory=ChosenSettings)
    partial: bool = False  # accept a bag from which messages are missing
    namespace: str | None = None  # of the cell; None: a bag has only one


class Estimation(NamedTuple):
    """The estimate, and what it was made from."""

    recorded: Recorded
    model: ObjectModel
    settings: EstimatorSettings
    estimator: Estimator
    data: list[Observation]  # all that were taken, in order of arrival, also those of pushes that are left out
    course: tuple[Estimate, ...]  # the last estimate, or the estimates after each of them
    ledger: Ledger  # what became of every message
    planned: int | None  # pushes that were to be made; None: nobody says

    @property
    def result(self) -> Estimate:
        """The last estimate."""
        return self.course[-1]

    def figures(self) -> dict[str, Any]:
        """All numbers, as the command line's JSON names them."""
        slipping = [observation.push_id in self.settings.slipping for observation in self.estimator.observations]
        return EstimateReport.of(self.result, self.model.name, self.result.belief, slipping, self.result.verdict).to_dict()

    def to_model(self) -> ModelFile:
        """The model to keep."""
        return make_model(self.model, self.result, str(self.recorded.path), self.settings)


def estimate_from(
    source: pathlib.Path,
    choices: Choices,
    warn: Warn,
    whole_course: bool = False,
    on_estimate: Callable[[ObjectModel, Observation, Estimate], None] = lambda model, observation, estimate: None,
) -> Estimation:
    """The estimate with which a live run over the same data would end.

    Args:
        source: the bag or the CSV.
        choices: what the caller chose.
        warn: called with a line for each refused message or observation, note of the verdict, and contradiction.
        whole_course: keep the estimates after each observation.
        on_estimate: with the whole course, called with each observation as it is read, and the estimate after it.
    Raises:
        InvalidInput: the input, or a file that the choices name, is unusable.
        DamagedBag: messages are missing from the bag.
    """
    recorded = Recorded(source, choices.namespace)
    settings = choices.settings.over(recorded.settings)
    model, _ = object_of(source, choices.object_name, warn)
    model = with_support(model, choices.grid, choices.support_points)
    estimator = settings.new_estimator(model.support_points)
    data: list[Observation] = []
    course: list[Estimate] = []

    def take(observation: Observation) -> None:
        if observation.push_id in settings.excluded or not usable_by(estimator, [observation], warn):
            return
        data.append(observation)
        if whole_course:
            course.append(estimator.add(observation))
            on_estimate(model, observation, course[-1])

    recorded.on_observation = take
    reading = recorded.read(model, settings, warn, choices.partial)
    last(data)
    course[-1:] = [estimator.estimate() if whole_course else estimator.add(data)]
    reading.settle(estimator)
    for note in course[-1].verdict.notes:
        warn(note.text)
    return Estimation(recorded, model, settings, estimator, data, tuple(course), reading.ledger, reading.plan.planned.number)
