"""The message types installed on this machine: their classes, definitions and hashes, looked up by name."""

import functools
import importlib
import json
import pathlib
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from pushfric_core.bags.contents import Topic
from pushfric_core.errors import InvalidInput


@functools.cache
def message_class(type_name: str) -> type:
    """The installed class of package/msg/Type.

    Raises:
        InvalidInput: the type is not installed.
    """
    try:
        package, kind, name = type_name.split("/")
        return getattr(importlib.import_module(f"{package}.{kind}"), name)
    except (ValueError, ImportError, AttributeError) as error:
        raise InvalidInput(f"message type {type_name!r} is not installed, expected package/msg/Type") from error


def recorded_class(topic: Topic) -> type:
    """The installed class of a recorded topic.

    Raises:
        InvalidInput: the type is not installed, or not with the definition that the bag was recorded with.
    """
    installed = message_class(topic.type_name)
    if topic.type_hash and topic.type_hash != type_hash(topic.type_name):
        raise InvalidInput(f"{topic.name}: was recorded with another definition of {topic.type_name} than the one installed")
    return installed


def type_hash(type_name: str) -> str:
    """RIHS01 hash of an installed type.

    Raises:
        InvalidInput: the type is not installed.
    """
    hashes = {entry["type_name"]: entry["hash_string"] for entry in _description(type_name)["type_hashes"]}
    return hashes[type_name]


def definition(type_name: str) -> str:
    """Definition of an installed message type, followed by those of all types that it refers to.

    Raises:
        InvalidInput: one of them is not installed.
    """
    text = _share_file(type_name, "msg")
    for entry in _description(type_name)["type_description_msg"]["referenced_type_descriptions"]:
        package, _, name = entry["type_name"].split("/")
        text += f"\n{'=' * 80}\nMSG: {package}/{name}\n{_share_file(entry['type_name'], 'msg')}"
    return text


def _description(type_name: str) -> dict[str, Any]:
    return json.loads(_share_file(type_name, "json"))


def _share_file(type_name: str, suffix: str) -> str:
    """Text of a file that rosidl installs for a type."""
    try:
        package, kind, name = type_name.split("/")
        return (pathlib.Path(get_package_share_directory(package)) / kind / f"{name}.{suffix}").read_text(encoding="utf-8")
    except (ValueError, PackageNotFoundError, FileNotFoundError) as error:
        raise InvalidInput(f"message type {type_name!r} has no installed .{suffix} file, expected package/msg/Type") from error
