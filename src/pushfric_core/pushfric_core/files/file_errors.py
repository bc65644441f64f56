"""The one-line error for a file that cannot be read; it names the file once."""

import contextlib
import csv
import pathlib
import re
from collections.abc import Iterator, Mapping

from pushfric_core.errors import InvalidInput


@contextlib.contextmanager
def reading(path: pathlib.Path) -> Iterator[None]:
    """A context in which a file is opened, decoded, and parsed as CSV.

    Raises:
        InvalidInput: one of these steps failed.
    """
    try:
        yield
    except OSError as error:
        raise InvalidInput(f"{path}: cannot be read: {error.strerror}") from error
    except (csv.Error, ValueError) as error:  # bytes that are not UTF-8, and a NUL in the path, raise a ValueError
        name = repr(str(path)) if "\0" in str(path) else path
        raise InvalidInput(f"{name}: cannot be read: {error}") from error


def text_of(path: pathlib.Path, limit: int) -> str:
    """The text of a file, which may be a device that never ends; for use within `reading`.

    Raises:
        ValueError: the file has more than `limit` characters, or is not UTF-8.
    """
    with path.open(encoding="utf-8") as stream:
        text = stream.read(limit + 1)
    if len(text) > limit:
        raise ValueError(f"expected at most {limit} characters")
    return text


LONGEST = 80
"""Number of characters of a wrong value that are shown."""


def shortened(value: object) -> str:
    """A wrong value for people, on one line of bounded length."""
    text = repr(value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


def as_named_here(error: Exception, names: Mapping[str, str]) -> str:
    """An error in the words of the file.

    Args:
        error: of a record, which names its own fields.
        names: how the file names them.
    """
    return re.sub("|".join(rf"\b{name}\b" for name in names), lambda field: names[field[0]], str(error))
