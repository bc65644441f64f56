"""The files of a bag's folder: metadata.yaml, in which rosbag2 describes them, and whether they are those of one recording."""

import os
import pathlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from pushfric_core.errors import InvalidInput
from pushfric_core.files.disk import reading
from pushfric_core.files.yaml_text import load_yaml

METADATA = "metadata.yaml"

VERSION = 9

CONVERT = f"rosbags-convert --src BAG --dst NEW --dst-storage mcap makes an MCAP bag of one with {METADATA}"

NO_BAG = f"is not a bag, expected {METADATA}, or an .mcap file in it; {CONVERT}"
"""Said of a folder."""

COMPRESSION_MODES = ("", "none", "file", "message")

FILE_LIMIT = 10_000
"""Largest number of files of a bag."""


class Compressed(InvalidInput):
    """rosbag2 compressed the messages or files of a bag, which is not read."""


@dataclass(frozen=True)
class BagMetadata:
    """The part of a metadata.yaml that is used."""

    files: tuple[pathlib.Path, ...]
    message_count: int
    by_topic: Mapping[str, int]  # counts of messages
    custom: Mapping[str, str]  # what the writer added


def read_metadata(folder: pathlib.Path) -> BagMetadata | None:
    """The metadata of a bag's folder; None if there is no metadata.yaml.

    Raises:
        InvalidInput: the file is not the metadata of a bag.
    """
    path = folder / METADATA
    if not os.path.isfile(path):  # unlike Path.is_file, it accepts every name, however long or odd
        return None
    with reading(path):
        text = path.read_text(encoding="utf-8")
    try:
        return _metadata(folder, load_yaml(text)["rosbag2_bagfile_information"])
    except (KeyError, TypeError, AttributeError) as error:
        raise InvalidInput(f"{path}: is not the metadata of a bag, expected that of rosbag2") from error
    except ValueError as error:
        raise InvalidInput(f"{path}: is not the metadata of a bag: {error}") from error


def embedded_metadata(folder: pathlib.Path, text: str) -> BagMetadata | None:
    """The metadata of a bag in a record of one of its files; None if it says nothing that can be used."""
    try:
        return _metadata(folder, load_yaml(text))
    except (KeyError, TypeError, AttributeError, ValueError):
        return None  # only metadata.yaml is needed; what recorders write when they begin is not complete


def _metadata(folder: pathlib.Path, information: Any) -> BagMetadata:
    if (storage := str(information["storage_identifier"])) != "mcap":
        raise InvalidInput(f"{folder}: is a bag of the storage {storage[:80]!r}, expected mcap; {CONVERT}")
    mode = information.get("compression_mode") or ""
    if not isinstance(mode, str) or mode.lower() not in COMPRESSION_MODES:
        raise ValueError(f"expected compression_mode to be one of {', '.join(COMPRESSION_MODES[1:])}, got {str(mode)[:80]!r}")
    names = information["relative_file_paths"]
    if not isinstance(names, list) or not 0 < len(names) <= FILE_LIMIT:
        raise ValueError(f"expected relative_file_paths to list 1 to {FILE_LIMIT} files")
    for name in names:
        if not isinstance(name, str) or not name or "\0" in name:
            raise ValueError(f"expected relative_file_paths to list names of files, got {str(name)[:80]!r}")
    if mode.lower() == "message" or names[0].endswith(".zstd"):  # what would be read of it makes no sense
        raise Compressed(f"{folder}: rosbag2 compressed each {mode.lower()}; {CONVERT}")
    # old bags list them relative to the folder in which the recorder ran
    files = [folder / pathlib.PurePath(name).name for name in names]
    if twice := sorted({file.name for file in files if files.count(file) > 1}):
        raise ValueError(f"relative_file_paths lists {', '.join(twice)} more than once")
    by_topic: dict[str, int] = {}
    for entry in information.get("topics_with_message_count") or []:
        name = str(entry["topic_metadata"]["name"])
        by_topic[name] = by_topic.get(name, 0) + _count(entry["message_count"])
    custom = information.get("custom_data") or {}
    if not isinstance(custom, dict):
        raise ValueError("expected custom_data to be a mapping")
    count = _count(information["message_count"])
    said = {str(key): str(value) for key, value in custom.items()}
    return BagMetadata(tuple(files), count, by_topic, said)


def _count(value: Any) -> int:
    if type(value) is not int or value < 0:
        raise ValueError(f"expected message_count to be a whole number of 0 or more, got {str(value)[:80]!r}")
    return value


_NUMBERED = re.compile(r"(?P<base>.*)_(?P<number>[0-9]{1,9})\.mcap")


class Parts(NamedTuple):
    """The files of a bag, by number."""

    files: tuple[pathlib.Path, ...]
    doubts: tuple[str, ...]
    notes: tuple[str, ...]  # what cannot be known


def parts_of(path: pathlib.Path, metadata: BagMetadata | None) -> Parts:
    """The files of a bag's folder, or the one file that is given.

    Raises:
        InvalidInput: the folder holds no files of a bag.
    """
    if not os.path.isdir(path):
        return Parts((path,), (), ())
    present = sorted(path.glob("*.mcap"))
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
        raise InvalidInput(f"{path}: {NO_BAG}")
    matches = ((file, _NUMBERED.fullmatch(file.name)) for file in present)
    known = {file: None if one is None else (one["base"], int(one["number"])) for file, one in matches}
    files = tuple(sorted(present, key=lambda file: (known[file] is None, (known[file] or ("", 0))[1], file.name)))
    numbers = [known[file] for file in files]
    if len(files) == 1 and numbers == [None]:
        return Parts(files, (), ())
    doubts = []
    if numbers != [(numbers[0][0] if numbers[0] else "", number) for number in range(len(files))]:
        names = ", ".join(file.name for file in files[:10])
        doubts.append(f"the names of its files are not those of one bag, with the numbers 0 to {len(files) - 1}: {names}")
    return Parts(files, tuple(doubts), (f"without {METADATA}, nothing says whether a part {len(files)} was recorded",))
