"""Shared by the commands `predict` and `stable`: a model from a file, or from the data points of a bag or a CSV."""

import pathlib
from collections.abc import Callable
from typing import Annotated, NamedTuple

import typer

from pushfric_core.errors import InvalidInput
from pushfric_core.files.model_file import SUFFIXES, load_model
from pushfric_core.geometry.outline import Outline
from pushfric_core.mechanics.prediction import FrictionModel, friction_model
from pushfric_core.offline.estimation import Choices, estimate_from

ModelArgument = Annotated[
    pathlib.Path,
    typer.Argument(metavar="MODEL", help="Model YAML (from estimate --save), bag, or CSV of observations.", show_default=False),
]


class Known(NamedTuple):
    """What is known of an object."""

    outline: Outline
    friction: FrictionModel


def known(source: pathlib.Path, object_name: str, namespace: str | None, warn: Callable[[str], None]) -> Known:
    """The model in a file, or estimated from the data points of a bag or a CSV with the recorded settings.

    Args:
        source: the file or the bag.
        object_name: name or file of the object; empty for a model, which has its own.
        namespace: of the cell; None: a bag has only one.
        warn: gets a line for each message or data point that is refused.
    Raises:
        InvalidInput: the source cannot be read, or it does not say which object was pushed.
    """
    if source.suffix in SUFFIXES:
        if object_name:
            raise InvalidInput(f"{source}: a model has its own object; give --object only with a bag or a CSV")
        file, model = load_model(source)
        return Known(model.outline, file.friction())
    estimation = estimate_from(source, Choices(object_name, namespace=namespace), warn)
    if estimation.result.contradiction is not None:
        raise InvalidInput(f"{source}: {estimation.result.contradiction}")
    return Known(estimation.model.outline, friction_model(estimation.result))
