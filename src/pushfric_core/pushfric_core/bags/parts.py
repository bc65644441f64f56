"""The files of a bag: whether their numbers are those of one recording, and metadata.yaml lists them."""

import os
import pathlib
import re
from collections.abc import Sequence
from typing import NamedTuple

from pushfric_core.bags.rosbag2_metadata import METADATA, BagMetadata
from pushfric_core.errors import InvalidInput

PATTERNS = ("*.mcap", "*.mcap.zstd", "*.db3", "*.db3.zstd")

_NUMBERED = re.compile(r"(?P<base>.*)_(?P<number>[0-9]{1,9})\.(?:mcap|db3)(?:\.zstd)?")


class Parts(NamedTuple):
    """The files of a bag, by number."""

    files: tuple[pathlib.Path, ...]
    doubts: tuple[str, ...]
    notes: tuple[str, ...]  # what cannot be known


def _numbers(files: Sequence[pathlib.Path]) -> list[tuple[str, int] | None]:
    """The name and the number in each file's name; None: there is none."""
    found = (_NUMBERED.fullmatch(file.name) for file in files)
    return [None if one is None else (one["base"], int(one["number"])) for one in found]


def parts_of(path: pathlib.Path, metadata: BagMetadata | None) -> Parts:
    """The files of a bag's folder, or the one file that is given.

    Raises:
        InvalidInput: the folder holds no files of a bag.
    """
    if not os.path.isdir(path):
        return Parts((path,), (), ())
    present = sorted(file for pattern in PATTERNS for file in path.glob(pattern))
    if metadata is not None:
        files = tuple(file for file in metadata.files if file.exists())
        if not files:
            raise InvalidInput(f"{metadata.files[0]}: cannot be read: No such file or directory, expected a bag")
        gone = [f"{METADATA} lists {file.name}, which is not there" for file in metadata.files if file not in files]
        more = (file for file in present if file not in files)
        return Parts(
            files,
            (*gone, *(f"{METADATA} does not list {file.name}, which lies in the folder and is not read" for file in more)),
            (),
        )
    if not present:
        raise InvalidInput(f"{path}: is not a bag, expected {METADATA}, or an .mcap or .db3 file in it")
    known = dict(zip(present, _numbers(present), strict=True))
    files = tuple(sorted(present, key=lambda file: (known[file] is None, (known[file] or ("", 0))[1], file.name)))
    numbers = [known[file] for file in files]
    if len(files) == 1 and numbers == [None]:
        return Parts(files, (), ())
    doubts = []
    if numbers != [(numbers[0][0] if numbers[0] else "", number) for number in range(len(files))]:
        names = ", ".join(file.name for file in files[:10])
        doubts.append(f"the names of its files are not those of one bag, with the numbers 0 to {len(files) - 1}: {names}")
    return Parts(files, tuple(doubts), (f"without {METADATA}, nothing says whether a part {len(files)} was recorded",))
