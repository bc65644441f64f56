"""metadata.yaml, the file in which rosbag2 describes the contents of a bag's folder."""

import os
import pathlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pushfric_core.errors import InvalidInput
from pushfric_core.files.bounded_yaml import load_yaml
from pushfric_core.files.file_errors import reading

METADATA = "metadata.yaml"

VERSION = 9

STORAGES = ("mcap", "sqlite3")

COMPRESSION_MODES = ("", "none", "file", "message")

FILE_LIMIT = 10_000
"""Largest number of files of a bag."""


@dataclass(frozen=True)
class BagMetadata:
    """The part of a metadata.yaml that is used."""

    storage: str  # one of STORAGES
    files: tuple[pathlib.Path, ...]
    compression_mode: str  # one of COMPRESSION_MODES
    compression_format: str
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
    storage = information["storage_identifier"]
    if storage not in STORAGES:
        raise ValueError(f"expected storage_identifier to be one of {', '.join(STORAGES)}, got {str(storage)[:80]!r}")
    mode = information.get("compression_mode") or ""
    if not isinstance(mode, str) or mode.lower() not in COMPRESSION_MODES:
        raise ValueError(f"expected compression_mode to be one of {', '.join(COMPRESSION_MODES[1:])}, got {str(mode)[:80]!r}")
    format_ = information.get("compression_format") or ""
    if mode.lower() in COMPRESSION_MODES[2:] and format_ != "zstd":
        raise ValueError(f"expected compression_format zstd, got {str(format_)[:80]!r}")
    names = information["relative_file_paths"]
    if not isinstance(names, list) or not 0 < len(names) <= FILE_LIMIT:
        raise ValueError(f"expected relative_file_paths to list 1 to {FILE_LIMIT} files")
    for name in names:
        if not isinstance(name, str) or not name or "\0" in name:
            raise ValueError(f"expected relative_file_paths to list names of files, got {str(name)[:80]!r}")
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
    return BagMetadata(storage, tuple(files), mode.lower(), format_, count, by_topic, said)


def _count(value: Any) -> int:
    if type(value) is not int or value < 0:
        raise ValueError(f"expected message_count to be a whole number of 0 or more, got {str(value)[:80]!r}")
    return value
