"""A saved model, as a YAML file: what was learned about an object, to predict with and to continue from."""

import importlib.metadata
import pathlib
import platform
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import pydantic
import yaml

from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.estimation.estimate import Estimate, friction_model
from pushfric_core.files.disk import as_named_here, make_folder, write_whole
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.object_file import ObjectFile, ObjectModel, Point, SupportFile, make_object, within
from pushfric_core.files.yaml_files import Strict, read_yaml
from pushfric_core.geometry.planar import Pose, Twist
from pushfric_core.mechanics.prediction import FrictionModel, Kind
from pushfric_core.mechanics.quasi_static import SUM
from pushfric_core.plausible import STRONGEST
from pushfric_core.records import plain
from pushfric_core.trajectories.observation import PUSH_IDS, Observation
from pushfric_core.wording import data_of, shortened

SUFFIXES = (".yaml", ".yml")

DUMPER: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # the first writes the same, in a third of the time
FORMAT = 3
VERSIONED = ("pushfric_core", "numpy", "scipy")
"""Packages whose versions a model names."""

FIELDS = {"contact": "contact_point", "normal": "contact_normal"}
"""The fields of an observation whose keys have other names."""

KEYS = {field: key for key, field in FIELDS.items()} | {"the twist": "twist"}

Share = Annotated[float, pydantic.Field(ge=0, le=1)]
Positive = Annotated[float, pydantic.Field(ge=0)]


class ContactFrictionFile(Strict):
    """mu_c."""

    model_config = pydantic.ConfigDict(use_enum_values=True)

    value: Positive | None = None  # None: it is only bounded
    interval: tuple[Positive, Annotated[float, pydantic.Field(ge=0, allow_inf_nan=True)]]  # holds the truth with 90 %
    kind: Kind


class SampleFile(Strict):
    """A sample of the possible w and mu_c."""

    w: list[Share]
    mu_c: Positive
    weight: Share


class ObservationEntry(Strict):
    """An observation, object frame, SI units."""

    contact: Point
    normal: Point
    twist: tuple[float, float, float]
    push_id: int
    half_width: Positive = 0.0
    duration: Positive | None = None  # [s]
    stamp: int = 0
    pose: tuple[float, float, float] | None = None  # in the table frame
    force: tuple[float, float] | None = None
    tip_velocity: tuple[float, float] | None = None
    depth: float | None = None


class BeliefFile(Strict):
    """The belief, under the same names as in the JSON of `estimate`."""

    center_of_friction: Point  # p_CF [m]
    covariance: tuple[Point, Point] | None = None  # of p_CF [m^2]
    radius: Positive | None = None  # about p_CF, holds the true one with 90 % [m]
    w: Annotated[list[Share], pydantic.Field(min_length=1)]  # the mean
    mu_c: ContactFrictionFile | None = None  # None: nothing was measured
    misfit: Positive  # see pushfric_core.FrictionModel
    sliding_misfit: Positive
    stroke_misfit: Positive
    samples: Annotated[tuple[SampleFile, ...], pydantic.Field(min_length=1)]  # what predictions use


class MadeFile(Strict):
    """How a model was made."""

    source: str  # the bag, the CSV or the node it was made from
    data_points: Annotated[int, pydantic.Field(ge=1)]
    pushes: Annotated[int, pydantic.Field(ge=1)]
    fit_error: Positive  # optimum of the program [m times unit force]; with the loss l2 squared
    status: str
    verdict: tuple[str, ...] | None = None  # why the estimate must not be used; empty: it may be used; None: not known
    settings: dict[str, Any] = pydantic.Field(default_factory=dict)  # the estimator's, by name of its parameters


class ModelFile(Strict):
    """The file. All but the object follows from the observations; it stands here for readers that only predict."""

    format: int = FORMAT
    object: ObjectFile  # with the support points that the weights belong to
    w: Annotated[list[Share], pydantic.Field(min_length=1)]  # of the program
    center_of_friction: Point  # ... and its p_CF [m]
    belief: BeliefFile
    total_friction: Annotated[float, pydantic.Field(ge=0), within(STRONGEST, "N")] | None = (
        None  # [N]; only from observations with measured forces
    )
    made: MadeFile
    versions: dict[str, str] = pydantic.Field(default_factory=dict)
    data_points: tuple[ObservationEntry, ...] = ()

    @pydantic.model_validator(mode="before")
    @classmethod
    def _of_this_version(cls, content: Any) -> Any:
        # before the keys, which may be others in another version
        if isinstance(content, dict) and not {"format", "w"} & {*content}:
            raise ValueError("not a model, as `estimate --save` writes it")
        if isinstance(content, dict) and content.get("format", FORMAT) != FORMAT:
            raise ValueError(f"expected a model of format {FORMAT}, got format {shortened(content['format'])}")
        return content

    @pydantic.model_validator(mode="after")
    def _fits(self) -> "ModelFile":
        if self.object.support.points is None:
            raise ValueError("expected the support of the object as points")
        n = len(self.object.support.points)
        samples = [(f"belief.samples.{k}.w", sample.w) for k, sample in enumerate(self.belief.samples)]
        for name, w in [("w", self.w), ("belief.w", self.belief.w), *samples]:
            if len(w) != n or abs(sum(w) - 1) > SUM / 2:  # stricter than FrictionModel, in whatever order it adds
                raise ValueError(f"expected {name} of {n} weights with sum 1, got {len(w)} with sum {sum(w):g}")
        if abs(sum(sample.weight for sample in self.belief.samples) - 1) > SUM / 2:
            raise ValueError("expected the weights of belief.samples to have the sum 1")
        return self

    def __str__(self) -> str:
        """A line: the file itself is long."""
        x, y = (1e3 * value for value in self.belief.center_of_friction)
        made = f"{data_of(self.made.data_points, self.made.pushes)} in {self.made.source}"
        return f"model of {self.object.name}: p_CF ({x:z.2f}, {y:z.2f}) mm, from {made}"

    __repr__ = __str__

    def friction(self) -> FrictionModel:
        """The model that predicts."""
        belief, points = self.belief, np.array(self.object.support.points)
        covariance = None if belief.covariance is None else np.array(belief.covariance)
        kind = None if belief.mu_c is None else Kind(belief.mu_c.kind)
        w, mu_c, share = (np.array([getattr(sample, name) for sample in belief.samples]) for name in ("w", "mu_c", "weight"))
        misfits = belief.misfit, belief.sliding_misfit, belief.stroke_misfit
        return FrictionModel(points, w, mu_c, share, *misfits, covariance, kind, self.made.data_points)

    @property
    def rests_on(self) -> str:
        """The origin of the model, and whether it may be used, in words."""
        made = self.made
        verdict = "no verdict" if made.verdict is None else "; ".join(made.verdict) or "may be used"
        return f"{self.object.name}: {data_of(made.data_points, made.pushes)} from {made.source}; verdict: {verdict}"

    def observations(self) -> list[Observation]:
        """The observations that the model was made from, in order."""
        return [
            Observation(
                **{FIELDS.get(key, key): getattr(point, key) for key in ObservationEntry.model_fields}
                | {"twist": Twist(*point.twist), "pose": None if point.pose is None else Pose(*point.pose)}
            )
            for point in self.data_points
        ]


def make_model(model: ObjectModel, estimate: Estimate, source: str, settings: EstimatorSettings) -> ModelFile:
    """The file of an estimate.

    Args:
        model: the object.
        estimate: from at least one observation.
        source: where they came from.
        settings: of the estimator.
    """
    friction = friction_model(estimate)
    points = [(float(x), float(y)) for x, y in estimate.support_points]
    x, y = estimate.center_of_friction.tolist()
    made = MadeFile(
        source=source.encode(errors="backslashreplace").decode(),  # a path may have bytes that are no text
        data_points=estimate.data_points,
        pushes=estimate.pushes,
        fit_error=estimate.solution.objective,
        status=estimate.status.value,
        verdict=tuple(map(str, estimate.verdict.reasons)),
        settings=settings.parameters(),
    )
    return ModelFile(
        object=model.file.model_copy(update={"support": SupportFile(points=points)}),
        w=np.clip(estimate.w, 0.0, 1.0).tolist(),
        center_of_friction=(x, y),
        belief=_belief(friction),
        total_friction=estimate.total_friction,
        made=made,
        versions={"python": platform.python_version()} | {name: importlib.metadata.version(name) for name in VERSIONED},
        data_points=tuple(map(_entry, estimate.observations)),
    )


def _belief(friction: FrictionModel) -> BeliefFile:
    said = {"radius": friction.confidence, "w": friction.support.weights, "mu_c": friction.known_mu_c}
    keys = BeliefFile.model_fields
    return BeliefFile.model_validate({key: plain(said[key] if key in said else getattr(friction, key)) for key in keys})


def _entry(observation: Observation) -> ObservationEntry:
    keys = ObservationEntry.model_fields
    return ObservationEntry.model_validate({key: getattr(observation, FIELDS.get(key, key)) for key in keys})


def load_model(path: pathlib.Path, content: Any = None) -> tuple[ModelFile, ObjectModel]:
    """A model, and the object that it describes; `content` as for `read_yaml`.

    Raises:
        InvalidInput: the file cannot be read or is not a model; one line says what is wrong, where, and what was expected.
    """
    file = read_yaml(path, ModelFile, content)
    model = make_object(file.object, str(path))
    try:
        for observation in file.observations():
            observation.check_contact(model.outline)
    except (ValueError, PushfricError) as error:
        raise InvalidInput(f"{path}: data_points: {as_named_here(error, KEYS)}") from error
    return file, model


def prior(path: pathlib.Path, pushed: ObjectModel) -> list[Observation]:
    """The observations of a model, for an estimate of the same object that goes on from it.

    The pushes of the model get the highest push ids, so that they differ from those of later pushes.

    Raises:
        InvalidInput: as for `load_model`; or the model's object has another name or outline, or the model no observations.
    """
    file, model = load_model(path)
    if model.name != pushed.name:
        raise InvalidInput(f"{path}: is a model of {model.name}, expected a model of {pushed.name}")
    if model.outline != pushed.outline:
        raise InvalidInput(f"{path}: has another outline of {model.name} than the pushed object")
    data = file.observations()
    if not data:
        raise InvalidInput(f"{path}: has no data_points, expected those that the estimate is to go on from")
    pushes = list(dict.fromkeys(observation.push_id for observation in data))
    numbers = {push_id: PUSH_IDS - len(pushes) + number for number, push_id in enumerate(pushes)}
    return [replace(observation, push_id=numbers[observation.push_id]) for observation in data]


def check_name(path: pathlib.Path) -> None:
    """Check that a model can be written there, and make its folder.

    Raises:
        InvalidInput: the name is not that of a YAML file, or its folder cannot be made.
    """
    if path.suffix not in SUFFIXES or path.is_dir():
        raise InvalidInput(f"{path}: expected the name of a file that ends with {' or '.join(SUFFIXES)}")
    make_folder(path.parent)


def save_model(file: ModelFile, path: pathlib.Path) -> None:
    """Write the file, whole or not at all.

    Raises:
        InvalidInput: the file cannot be written there.
    """
    check_name(path)
    write_whole(path, as_yaml(file))


def as_yaml(file: ModelFile) -> str:
    """The text of the file."""
    content = file.model_dump(exclude_none=True, exclude_defaults=True)
    return str(yaml.dump({"format": FORMAT} | content, Dumper=DUMPER, sort_keys=False, default_flow_style=None, width=128))
