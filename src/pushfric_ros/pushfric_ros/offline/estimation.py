"""One estimate from one bag or CSV."""

import pathlib
from collections import deque
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.estimate import Estimate
from pushfric_core.estimator import Estimator, free_radii
from pushfric_core.planar import Array
from pushfric_core.refinement import Refined, candidate_grid, refine
from pushfric_core.verdict import Verdict
from pushfric_ros.bags import data_points
from pushfric_ros.bags.data_points import Warn
from pushfric_ros.files.estimator_settings import EstimatorSettings
from pushfric_ros.files.model_file import ModelFile, make_model
from pushfric_ros.files.object_file import ObjectModel
from pushfric_ros.messages.conversions import estimate_to_msg
from pushfric_ros.offline.chosen_settings import ChosenSettings
from pushfric_ros.offline.inputs import object_of, with_support
from pushfric_ros.report.report import report


@dataclass(frozen=True)
class Choices:
    """What the caller chose, the same for every input."""

    object_name: str = ""  # name of the object, or path of its YAML; empty: the one next to the bag
    grid: tuple[int, int] | None = None
    support_points: pathlib.Path | None = None
    settings: ChosenSettings = field(default_factory=ChosenSettings)
    partial: bool = False  # accept a bag from which messages are missing
    refine: float | None = None  # supports may be this far from one another, anywhere on the object [m]; None: as hypothesised


class Estimation(NamedTuple):
    """The estimate, and what it was made from."""

    source: pathlib.Path
    model: ObjectModel
    settings: EstimatorSettings
    estimator: Estimator
    course: tuple[Estimate, ...]  # the last estimate, or the estimates after each data point
    verdict: Verdict
    refined: Refined | None = None  # of all places on the object, if supports may be anywhere

    @property
    def result(self) -> Estimate:
        """The last estimate."""
        return self.course[-1]

    def figures(self) -> dict[str, Any]:
        """All numbers, as the command line's JSON names them."""
        slipping = [observation.push_id in self.settings.slipping for observation in self.estimator.observations]
        figures = report(estimate_to_msg(self.result, self.model.name, slipping, self.verdict))
        if self.refined is not None:
            solution = self.refined.solution
            figures["refined"] = {
                "candidates": self.refined.candidates,
                "objective": solution.objective,
                "lower_bound": solution.lower_bound,
                "status": solution.status.value,
            }
        return figures

    def to_model(self) -> ModelFile:
        """The model to keep."""
        return make_model(self.model, self.result, self.estimator.observations, str(self.source), self.settings)


def estimate_from(source: pathlib.Path, choices: Choices, warn: Warn, whole_course: bool = False) -> Estimation:
    """The estimate with which a live run over the same data would end.

    Args:
        source: the bag or the CSV.
        choices: what the caller chose.
        warn: called with a line for each message or data point that is refused, and for each note of the verdict.
        whole_course: keep the estimates after each data point.
    Raises:
        InvalidInput: the input, or a file that the choices name, is unusable.
        DamagedBag: messages are missing from the bag.
    """
    settings = choices.settings.of(source)
    model, _ = object_of(source, choices.object_name)
    model = with_support(model, choices.grid, choices.support_points)
    candidates = None if choices.refine is None else _candidates(model, choices.refine)
    data = data_points.observations(source, model, settings, warn, choices.partial)
    estimator = settings.new_estimator(model.support_points)
    kept = None if whole_course else 1
    course = deque(data_points.taken(estimator.take, data, warn), maxlen=kept)
    result = data_points.last(course)
    refined = None
    if candidates is not None:
        refined = _refined(estimator, candidates)
        estimator = settings.new_estimator(refined.points, free_radii(estimator.support_points, settings.estimator))
        course = deque(data_points.taken(estimator.take, data, warn), maxlen=kept)
        result = data_points.last(course)
    verdict = estimator.verdict(result)
    for note in verdict.notes:
        warn(note)
    return Estimation(source, model, settings, estimator, tuple(course), verdict, refined)


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
