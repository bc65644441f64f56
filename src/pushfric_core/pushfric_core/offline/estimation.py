"""One estimate from one bag or CSV."""

import pathlib
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pushfric_core.bags.recorded import Recorded
from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.estimation import batch
from pushfric_core.estimation.batch import Warn
from pushfric_core.estimation.estimate import Estimate
from pushfric_core.estimation.estimate_report import EstimateReport
from pushfric_core.estimation.estimator import Estimator, free_radii
from pushfric_core.estimation.refinement import Refined, candidate_grid, refine
from pushfric_core.estimation.verdict import Verdict
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.model_file import ModelFile, make_model
from pushfric_core.files.object_file import ObjectModel
from pushfric_core.geometry.planar import Array
from pushfric_core.offline.chosen_settings import ChosenSettings
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
    refine: float | None = None  # supports may be this far from one another, anywhere on the object [m]; None: as hypothesised


class Estimation(NamedTuple):
    """The estimate, and what it was made from."""

    source: pathlib.Path
    model: ObjectModel
    settings: EstimatorSettings
    estimator: Estimator
    data: list[Observation]  # all that were taken, in order of arrival, also those of pushes that are left out
    course: tuple[Estimate, ...]  # the last estimate, or the estimates after each of them
    verdict: Verdict
    ledger: Ledger  # what became of every message
    refined: Refined | None = None  # of all places on the object, if supports may be anywhere

    @property
    def result(self) -> Estimate:
        """The last estimate."""
        return self.course[-1]

    def figures(self, posterior: bool = False) -> dict[str, Any]:
        """All numbers, as the command line's JSON names them; with those of the posterior, which takes about a second."""
        slipping = [observation.push_id in self.settings.slipping for observation in self.estimator.observations]
        figures = EstimateReport.of(
            self.result, self.model.name, slipping, self.verdict, posterior=self.result.posterior if posterior else None
        ).to_dict()
        if self.refined is not None:
            solution = self.refined.solution
            figures["refined"] = {
                "candidates": self.refined.candidates,
                "objective": solution.objective,
                "lower_bound": solution.lower_bound,
                "status": solution.status.value,
            }
        return figures

    def to_model(self, posterior: bool = False) -> ModelFile:
        """The model to keep."""
        sampled = self.result.posterior if posterior else None
        return make_model(self.model, self.result, str(self.source), self.settings, sampled)


def estimate_from(source: pathlib.Path, choices: Choices, warn: Warn, whole_course: bool = False) -> Estimation:
    """The estimate with which a live run over the same data would end.

    Args:
        source: the bag or the CSV.
        choices: what the caller chose.
        warn: called with a line for each refused message or observation, note of the verdict, and contradiction.
        whole_course: keep the estimates after each observation.
    Raises:
        InvalidInput: the input, or a file that the choices name, is unusable.
        DamagedBag: messages are missing from the bag.
    """
    recorded = Recorded(source, choices.namespace)
    settings = choices.settings.over(recorded.settings)
    model, _ = object_of(source, choices.object_name)
    model = with_support(model, choices.grid, choices.support_points)
    candidates = None if choices.refine is None else _candidates(model, choices.refine)
    reading = recorded.read(model, settings, warn, choices.partial)
    estimator = settings.new_estimator(model.support_points)
    data = batch.usable_by(estimator, reading.observations, warn)
    course = _course(estimator, data, whole_course)
    refined = None
    if candidates is not None:
        refined = _refined(estimator, candidates)
        estimator = settings.new_estimator(refined.points, free_radii(estimator.support_points, settings.estimator))
        course = _course(estimator, data, whole_course)
    verdict = estimator.verdict(course[-1])
    reading.settle(estimator)
    for line in (*(note.text for note in verdict.notes), *(f"{source}: {doubt}" for doubt in reading.ledger.doubts)):
        warn(line)
    return Estimation(source, model, settings, estimator, data, course, verdict, reading.ledger, refined)


def _course(estimator: Estimator, data: list[Observation], whole: bool) -> tuple[Estimate, ...]:
    """The last estimate, or the estimates after each observation."""
    batch.last(data)
    if not whole:
        return (estimator.add(data),)
    course = [estimator.add(one) for one in data]
    return (*course[:-1], estimator.estimate())


def _candidates(model: ObjectModel, spacing: float) -> Array:
    try:
        return candidate_grid(model.outline, spacing)
    except ValueError as error:
        raise InvalidInput(f"--refine: {error}") from error


def _refined(estimator: Estimator, candidates: Array) -> Refined:
    try:
        return refine(estimator.observations, estimator.support_points, candidates, estimator.config)
    except (ValueError, PushfricError) as error:
        raise InvalidInput(f"--refine: {error}") from error
