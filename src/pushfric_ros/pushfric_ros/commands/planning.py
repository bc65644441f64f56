"""Shared by the commands `predict` and `stable`: a model from a file, or from the data points of a bag or a CSV."""

import pathlib
from collections.abc import Callable
from typing import Annotated, NamedTuple

import typer

from pushfric_core.errors import InvalidInput
from pushfric_core.estimator import Estimator
from pushfric_core.outline import Outline
from pushfric_core.prediction import FrictionModel, model_of
from pushfric_ros.bags import data_points
from pushfric_ros.commands.inputs import object_of
from pushfric_ros.files.model_file import SUFFIXES, load_model

ModelArgument = Annotated[
    pathlib.Path,
    typer.Argument(metavar="MODEL", help="Model YAML (from estimate --save), bag, or CSV of observations.", show_default=False),
]


class Known(NamedTuple):
    """What is known of an object."""

    outline: Outline
    friction: FrictionModel


def known(source: pathlib.Path, object_name: str, warn: Callable[[str], None]) -> Known:
    """The model in a file, or estimated from the data points of a bag or a CSV with the recorded settings.

    Args:
        source: the file or the bag.
        object_name: name or file of the object; empty for a model, which has its own.
        warn: gets a line for each message or data point that is refused.
    Raises:
        InvalidInput: the source cannot be read, or it does not say which object was pushed.
    """
    if source.suffix in SUFFIXES:
        if object_name:
            raise InvalidInput(f"{source}: a model brings its object; give --object with a bag or a CSV only")
        file, model = load_model(source)
        return Known(model.outline, file.friction())
    (model, _), settings = object_of(source, object_name), data_points.recorded_settings(source)
    estimator = Estimator(model.support_points, settings.estimator)
    data = data_points.observations(source, model, settings, warn)
    estimate = data_points.estimate(estimator, data, warn)
    if estimate.contradiction is not None:
        raise InvalidInput(f"{source}: {estimate.contradiction}")
    return Known(model.outline, model_of(estimate, estimator.observations))
