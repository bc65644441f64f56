"""How a cell estimates, as one set of values: in its file, as the estimator's parameters, and in the bag for its replay."""

import dataclasses
import json
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

import pydantic

from pushfric_core.estimator import EstimatorConfig
from pushfric_core.region import RegionConfig
from pushfric_core.settings import AUTO
from pushfric_core.trajectory import TrajectoryConfig
from pushfric_ros.files.object_file import complaint

TOPIC = "estimator_settings"
EXCLUDED, SLIPPING = "exclude_pushes", "slipping_pushes"

Config = TypeVar("Config")


@dataclass(frozen=True)
class EstimatorSettings:
    """All that decides which estimate comes of given poses, beside the object."""

    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)
    trajectory: TrajectoryConfig = field(default_factory=TrajectoryConfig)
    excluded: tuple[int, ...] = ()  # pushes whose data points are left out
    region: RegionConfig = field(default_factory=RegionConfig)
    slipping: tuple[int, ...] = ()  # pushes whose contact is known to slip

    @property
    def with_forces(self) -> bool:
        """Whether one of the terms needs measured forces."""
        return self.estimator.needs_force

    def without(self, pushes: Iterable[int]) -> "EstimatorSettings":
        """The same, with these pushes left out as well."""
        return dataclasses.replace(self, excluded=tuple(sorted({*self.excluded, *pushes})))

    @classmethod
    def from_parameters(cls, values: Mapping[str, Any]) -> "EstimatorSettings":
        """From node parameters, any of them; `auto` stands for None.

        Raises:
            ValueError: one is unknown, of another type or out of range.
        """
        rest = {name: None if value == AUTO else value for name, value in values.items()}
        estimator, trajectory = _taken_from(rest, EstimatorConfig), _taken_from(rest, TrajectoryConfig)
        region = _taken_from(rest, RegionConfig)
        pushes = pydantic.TypeAdapter(dict[str, tuple[int, ...]])
        chosen = pushes.validate_python({name: rest.pop(name, ()) for name in (EXCLUDED, SLIPPING)})
        if rest:
            known = (*cls().parameters(), EXCLUDED, SLIPPING)
            raise ValueError(f"expected any of the estimator's parameters {', '.join(known)}, got {', '.join(map(str, rest))}")
        return cls(estimator, trajectory, chosen[EXCLUDED], region, chosen[SLIPPING])

    def parameters(self, names: Iterable[str] | None = None) -> dict[str, Any]:
        """All or those named, as a node's parameters are: a list for a tuple, left out where empty, and `auto` for None."""
        values = {EXCLUDED: self.excluded, SLIPPING: self.slipping}
        for config in (self.estimator, self.trajectory, self.region):
            values |= dataclasses.asdict(config)
        wanted = values if names is None else {name: values[name] for name in names}
        plain = {n: AUTO if v is None else list(v) if isinstance(v, tuple) else v for n, v in wanted.items()}
        return {name: value for name, value in plain.items() if value != []}

    def to_text(self) -> str:
        """As the estimator publishes them."""
        return json.dumps(self.parameters())

    @classmethod
    def from_text(cls, text: str) -> "EstimatorSettings":
        """What `to_text` wrote.

        Raises:
            ValueError: it did not.
        """
        values = json.loads(text)
        if not isinstance(values, dict):
            raise ValueError(f"the estimator's settings must be a JSON object, got {text!r}")
        try:
            return cls.from_parameters(values)
        except pydantic.ValidationError as error:
            raise ValueError(complaint(error)) from error


def _taken_from(values: dict[str, Any], config: type[Config]) -> Config:
    """A config from those of the values that are its fields, which are taken out."""
    hints = typing.get_type_hints(config)
    own = {each.name: values.pop(each.name) for each in dataclasses.fields(config) if each.name in values}  # type: ignore[arg-type]
    # a model of the fields, as the dataclass itself may hold what pydantic does not know: constraints of one's own
    fields: Any = {name: (hints[name], ...) for name in own}
    known = pydantic.create_model(config.__name__, __config__={"arbitrary_types_allowed": True}, **fields)
    checked = known.model_validate(own)
    return config(**{name: getattr(checked, name) for name in own})
