"""The files that an import wrote."""

import pathlib
from typing import NamedTuple

from pushfric_core.errors import InvalidInput


class Imported(NamedTuple):
    """A bag, or a set of CSV files, that was written."""

    path: pathlib.Path  # of the bag, or of the file with the strokes
    object: str
    observations: int


def new_folder(path: pathlib.Path) -> None:
    """Make a folder for the files of an import.

    Raises:
        InvalidInput: it exists already, or cannot be made.
    """
    try:
        path.mkdir(parents=True)
    except OSError as error:
        raise InvalidInput(f"{path}: cannot be created: {error.strerror}") from error
