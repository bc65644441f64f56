"""A file that cannot be read ends with one line that names it once."""

import contextlib
import csv
import pathlib
from collections.abc import Iterator

from pushfric_core.errors import InvalidInput


@contextlib.contextmanager
def reading(path: pathlib.Path) -> Iterator[None]:
    """Within, a file is opened, decoded, and taken apart where it is a CSV.

    Raises:
        InvalidInput: one of these fails.
    """
    try:
        yield
    except OSError as error:
        raise InvalidInput(f"{path}: cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InvalidInput(f"{path}: cannot be read: {error}") from error
