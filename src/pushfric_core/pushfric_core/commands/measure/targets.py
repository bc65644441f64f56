"""Where measurements go: into the object's file and the cell's file, or new files in another folder."""

import pathlib
import sys
from collections.abc import Mapping

import cv2
import typer

from pushfric_core.cell.cell_file import CellFile
from pushfric_core.errors import InvalidInput
from pushfric_core.files.file_errors import reading
from pushfric_core.files.object_file import OBJECT_FILE
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


def draw(path: pathlib.Path, picture: Image) -> None:
    """Write a picture.

    Raises:
        InvalidInput: the file cannot be written.
    """
    if not cv2.imwrite(str(path), picture):
        raise InvalidInput(f"{path}: cannot be written")
