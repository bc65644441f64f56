"""The frames of the camera.source of a cell's file: a device, files, or a topic."""

import importlib.metadata
from typing import Any

from pushfric_core.cell.node_settings import Discovery
from pushfric_core.errors import MissingPackage
from pushfric_core.vision.frame_source import TOPICS, DeviceFrames, Frames


def frames_from(source: str, namespace: str, size: tuple[int, int] | None = None, discovery: Discovery | None = None) -> Frames:
    """The frames of a source, which is opened as a context manager.

    Args:
        source: as `camera.source` of a cell's file.
        namespace: of the cell, if the source is a topic.
        size: width and height to ask of a device [px]; None: its default.
        discovery: where the nodes of the cell look for each other, if the source is a topic; None: as the environment says.
    Raises:
        InvalidInput: there is nothing to read at `source`.
        MissingPackage: the source is a topic, and there is no node graph.
    """
    if source in TOPICS:
        frames: Frames = borrowed("frames", f"the source {source}")(source, namespace, discovery)
        return frames
    return DeviceFrames(source, size)


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
