"""Where measurements go: into the object's file and the cell's file, or new files in another folder."""

import pathlib
import sys
from collections.abc import Mapping
from typing import Any

import cv2
import typer
import yaml

from pushfric_core.cell.cell_file import CellFile
from pushfric_core.errors import InvalidInput
from pushfric_core.files.bounded_yaml import load_yaml
from pushfric_core.files.file_errors import reading
from pushfric_core.files.object_file import OBJECT_FILE, ObjectFile, ObjectModel, make_object
from pushfric_core.files.yaml_edit import Value, with_values
from pushfric_core.vision.camera import Image

PUSHER_FILE = "pusher.yaml"
"""Name of the file for the pusher's entries if they do not go into the cell's file."""


def object_target(cell: CellFile, path: pathlib.Path, folder: pathlib.Path) -> pathlib.Path:
    """The file that a measured object goes into.

    Args:
        cell: the cell, which names the object.
        path: of the cell's file.
        folder: to write to.
    """
    own = pathlib.Path(cell.object)
    if own.suffix not in (".yaml", ".yml"):  # of Table 1
        return folder / OBJECT_FILE
    return folder / own.name if folder != path.parent else path.parent / own


def object_text(target: pathlib.Path, known: ObjectModel | None, values: Mapping[str, Value]) -> str:
    """The text of the object's file with the measured values; everything else in it stays.

    Args:
        target: the file, which need not exist.
        known: the object as it was known so far, for a new file; None if it was not.
        values: by key.
    Raises:
        InvalidInput: the file cannot be read, or does not fit what was measured; for example, support points lie outside.
    """
    if target.exists():
        with reading(target):
            text = target.read_text(encoding="utf-8")
        try:
            text = with_values(text, None, values)
        except ValueError as error:
            raise InvalidInput(f"{target}: {error}") from error
    else:
        content: dict[str, Any] = {"name": target.stem}
        if known is not None:
            content = known.file.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
        text = yaml.safe_dump({**content, **values}, sort_keys=False, default_flow_style=None, width=120)
    make_object(ObjectFile.model_validate(load_yaml(text)), str(target))
    return text


def cell_text(path: pathlib.Path, values: Mapping[str, Value]) -> str:
    """The text of the cell's file with new entries in the section `pusher`.

    Raises:
        InvalidInput: the file cannot be read, or its entries cannot be replaced.
    """
    with reading(path):
        text = path.read_text(encoding="utf-8")
    try:
        return with_values(text, "pusher", values)
    except ValueError as error:
        raise InvalidInput(f"{path}: {error}; with --out FOLDER, the entries go into a file of their own") from error


def permit(target: pathlib.Path, force: bool) -> None:
    """Ask before a file is overwritten; this comes before anything is measured.

    Raises:
        InvalidInput: the folder does not exist; or the file exists, and there is no terminal to ask.
    """
    if not target.parent.is_dir():
        raise InvalidInput(f"{target.parent}: no such folder")
    if force or not target.exists():
        return
    if not sys.stdin.isatty():
        raise InvalidInput(f"{target} exists: give --force, or --out FOLDER to write elsewhere")
    typer.confirm(f"{target} exists. Replace what is measured in it?", abort=True, err=True)


def write(path: pathlib.Path, text: str) -> None:
    """Write a file.

    Raises:
        InvalidInput: the file cannot be written.
    """
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InvalidInput(f"{path}: cannot be written: {error.strerror}") from error


def draw(path: pathlib.Path, picture: Image) -> None:
    """Write a picture.

    Raises:
        InvalidInput: the file cannot be written.
    """
    if not cv2.imwrite(str(path), picture):
        raise InvalidInput(f"{path}: cannot be written")
