"""The messages, services and actions: whether they are built from their present source."""

import pathlib
from typing import Any

from ament_index_python.packages import get_package_share_directory

from pushfric_core.errors import InvalidInput
from pushfric_core.pushers.check import Check, Grade
from pushfric_ros.messages.types import message_class

INTERFACE_PARTS = {"msg": (), "srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}
PRIMITIVES = {"bool": "boolean", "float32": "float", "float64": "double", "byte": "octet", "char": "uint8"}
"""Names of types in interface files -> names that rosidl uses."""


def check_build() -> Check:
    """Whether the interfaces are built from their present source."""
    stale = stale_interfaces(pathlib.Path(get_package_share_directory("pushfric_msgs")))
    if stale:
        finding = f"older than the source, or not built: {', '.join(stale)}"
        return Check("build", Grade.FAILED, finding, "build the workspace again: ./pushfric setup, or colcon build")
    return Check("build", Grade.OK, "pushfric_msgs is built from its present source")


def stale_interfaces(share: pathlib.Path) -> list[str]:
    """Interfaces of pushfric_msgs that are not built, or whose fields differ from their source files.

    Args:
        share: where they are installed; links lead to the source.
    """
    stale = []
    for kind, parts in INTERFACE_PARTS.items():
        folders = {path.resolve().parent for path in (share / kind).glob(f"*.{kind}")}
        for source in sorted(source for folder in folders for source in folder.glob(f"*.{kind}")):
            wanted = [_fields(text) for text in source.read_text(encoding="utf-8").split("\n---\n")]
            try:
                built = message_class(f"pushfric_msgs/{kind}/{source.stem}")
            except InvalidInput:
                stale.append(source.name)
                continue
            classes: list[Any] = [getattr(built, part) for part in parts] or [built]
            if [made.get_fields_and_field_types() for made in classes] != wanted:
                stale.append(source.name)
    return stale


def _fields(text: str) -> dict[str, str]:
    """Names and types of the fields that an interface file defines, as rosidl calls them."""
    fields = {}
    for line in text.splitlines():
        words = line.partition("#")[0].split()
        if len(words) < 2 or "=" in "".join(words[1:]):  # blank, or a constant
            continue
        base, bracket, size = words[0].rstrip("]").partition("[")
        base = PRIMITIVES.get(base, f"pushfric_msgs/{base}" if base[0].isupper() else base)
        if size.isdecimal():
            base = f"{base}[{size}]"
        elif bracket:
            base = f"sequence<{base}{size.replace('<=', ', ')}>"
        fields[words[1]] = base
    return fields
