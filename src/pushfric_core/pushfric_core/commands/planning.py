"""Shared by the commands `predict`, `stable` and `export`: a model from a file, or from the observations of a bag or a CSV."""

import contextlib
import pathlib
from collections.abc import Iterator
from typing import Annotated

import typer

from pushfric_core.commands.console import warn
from pushfric_core.errors import InvalidInput
from pushfric_core.files.model_file import SUFFIXES, ModelFile, load_model
from pushfric_core.files.object_file import ObjectModel
from pushfric_core.offline.estimation import Choices, estimate_from

ModelArgument = Annotated[
    pathlib.Path,
    typer.Argument(metavar="MODEL", help="Model YAML (from estimate --save), bag, or CSV of observations.", show_default=False),
]


@contextlib.contextmanager
def known(
    source: pathlib.Path, object_name: str, namespace: str | None, partial: bool
) -> Iterator[tuple[ModelFile, ObjectModel]]:
    """The model in a file with its object, or estimated from the observations of a bag or a CSV with the recorded settings.

    What a command prints within is in doubt, and it ends with exit code 1, if the bag is.

    Args:
        source: the file or the bag.
        object_name: name or file of the object; empty for a model, which has its own.
        namespace: of the cell; None: a bag has only one.
        partial: accept a bag from which messages may be missing.
    Raises:
        InvalidInput: the source cannot be read, or it does not say which object was pushed.
    """
    if source.suffix in SUFFIXES:
        if object_name:
            raise InvalidInput(f"{source}: a model has its own object; give --object only with a bag or a CSV")
        yield load_model(source)
        return
    estimation = estimate_from(source, Choices(object_name, partial=partial, namespace=namespace), warn)
    if estimation.result.contradiction is not None:
        raise InvalidInput(f"{source}: {estimation.result.contradiction}")
    yield estimation.to_model(), estimation.model
    if estimation.ledger.doubts and not partial:
        raise typer.Exit(1)
