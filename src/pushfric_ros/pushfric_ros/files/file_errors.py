"""One line of error for a file that cannot be read, which names it once."""

import contextlib
import csv
import pathlib
from collections.abc import Iterator

from pushfric_core.errors import InvalidInput


@contextlib.contextmanager
def reading(path: pathlib.Path) -> Iterator[None]:
    """A context in which a file is opened, decoded, and parsed as CSV.

    Raises:
        InvalidInput: one of these fails.
    """
    try:
        yield
    except OSError as error:
        raise InvalidInput(f"{path}: cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InvalidInput(f"{path}: cannot be read: {error}") from error
