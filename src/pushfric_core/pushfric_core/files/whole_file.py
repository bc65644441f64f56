"""Folders for files, and files that are written whole or not at all, however the program ends."""

import os
import pathlib

from pushfric_core.errors import InvalidInput


def write_whole(path: pathlib.Path, content: str | bytes) -> None:
    """Write a file, text as UTF-8, and make its folder; an earlier one of this name is replaced.

    Raises:
        InvalidInput: the file cannot be written.
    """
    make_folder(path.parent)
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        try:
            draft.write_bytes(content.encode() if isinstance(content, str) else content)
            draft.replace(path)
        except OSError:
            draft.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise InvalidInput(f"{path}: cannot be written: {error.strerror}") from error


def make_folder(path: pathlib.Path, new: bool = False) -> None:
    """Make a folder, and those around it.

    Args:
        path: of the folder.
        new: it must not exist yet.
    Raises:
        InvalidInput: it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=not new)
    except OSError as error:
        raise InvalidInput(f"{path}: the folder cannot be created: {error.strerror}") from error
