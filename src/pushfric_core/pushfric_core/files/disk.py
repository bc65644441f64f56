"""Files: read with an error in one line, and written whole or not at all, however the program ends."""

import contextlib
import csv
import errno
import os
import pathlib
import re
import shutil
from collections.abc import Iterator, Mapping

from pushfric_core.errors import InvalidInput


@contextlib.contextmanager
def reading(path: pathlib.Path, expected: str = "") -> Iterator[None]:
    """A context in which a file is opened, decoded, and parsed as CSV.

    Args:
        path: the file.
        expected: what is added where it cannot be read.
    Raises:
        InvalidInput: one of these steps failed.
    """
    try:
        yield
    except OSError as error:
        raise InvalidInput(f"{path}: cannot be read: {error.strerror}{expected}") from error
    except (csv.Error, ValueError, MemoryError) as error:  # bytes that are not UTF-8, and a NUL in the path, raise a ValueError
        name = repr(str(path)) if "\0" in str(path) else path
        raise InvalidInput(f"{name}: cannot be read: {error or 'there is not enough memory'}{expected}") from error


@contextlib.contextmanager
def writing(path: pathlib.Path) -> Iterator[None]:
    """A context in which a file is written.

    Raises:
        InvalidInput: it cannot be.
    """
    try:
        yield
    except OSError as error:
        raise InvalidInput(f"{path}: cannot be written: {error.strerror or error}") from error


def text_of(path: pathlib.Path, limit: int) -> str:
    """The text of a file, which may be a device that never ends; for use within `reading`.

    Raises:
        ValueError: the file has more than `limit` characters, is not UTF-8, or is a pipe, to which perhaps nobody writes.
    """
    if path.is_fifo():
        raise ValueError("it is a pipe")
    with path.open(encoding="utf-8") as stream:
        text = stream.read(limit + 1)
    if len(text) > limit:
        raise ValueError(f"expected at most {limit} characters")
    return text


def as_named_here(error: Exception, names: Mapping[str, str]) -> str:
    """An error in the words of the file.

    Args:
        error: of a record, which names its own fields.
        names: how the file names them.
    """
    return re.sub("|".join(rf"\b{name}\b" for name in names), lambda field: names[field[0]], str(error))


def write_whole(path: pathlib.Path, content: str | bytes) -> None:
    """Write a file, text as UTF-8, and make its folder; one that is there is replaced, a device or a pipe written to.

    Raises:
        InvalidInput: the file cannot be written.
    """
    make_folder(path.parent)
    content = content.encode() if isinstance(content, str) else content
    with writing(path):
        if path.exists() and not path.is_file():
            path.write_bytes(content)
            return
        path = path.resolve()  # a link stays
        draft = path.with_name(f".{path.name}.{os.getpid()}")
        try:
            with draft.open("wb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
            if path.exists():
                shutil.copymode(path, draft)
            draft.replace(path)
        except BaseException:
            draft.unlink(missing_ok=True)
            raise
        try:
            folder = os.open(path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)  # the new name, too, outlasts a power cut
            finally:
                os.close(folder)
        except OSError as error:
            if error.errno not in (errno.EACCES, errno.EINVAL):  # it may not be read; its file system cannot do that
                raise


def make_folder(path: pathlib.Path) -> None:
    """Make a folder, and those around it, unless it exists.

    Raises:
        InvalidInput: it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidInput(f"{path}: the folder cannot be created: {error.strerror}") from error
