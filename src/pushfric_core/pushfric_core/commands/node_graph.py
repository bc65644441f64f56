"""The entry points of a package with a node graph that these commands use (group `pushfric.node_graph`)."""

import importlib.metadata
from typing import Any

from pushfric_core.errors import MissingPackage

GROUP = "pushfric.node_graph"


def borrowed(name: str, what: str) -> Any:
    """The parts that such a package provides.

    Args:
        name: of the entry point: frames (from a topic), stroke (pictures along it).
        what: is asked for.
    Raises:
        MissingPackage: no such package is installed.
    """
    found = importlib.metadata.entry_points(group=GROUP, name=name)
    if not found:
        raise MissingPackage(f"{what} needs the node graph: the package pushfric_ros is not installed (docs/install.md)")
    (entry,) = {entry.value: entry for entry in found}.values()
    return entry.load()
