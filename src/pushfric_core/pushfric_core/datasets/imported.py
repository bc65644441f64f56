"""The files that an import wrote."""

import pathlib
from typing import NamedTuple


class Imported(NamedTuple):
    """A bag, or a set of CSV files, that was written."""

    path: pathlib.Path  # of the bag, or of the file with the strokes
    object: str
    observations: int
