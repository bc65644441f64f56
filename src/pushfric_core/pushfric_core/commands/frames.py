"""The frames of the camera.source of a cell's file: a device, files, or a topic."""

from pushfric_core.cell.node_settings import Discovery
from pushfric_core.commands.node_graph import borrowed
from pushfric_core.errors import InvalidInput
from pushfric_core.vision.frame_source import ACCEPTED, TOPICS, DeviceFrames, Frames

ACCEPTED_WITH_TOPICS = f"{ACCEPTED}; or {' or '.join(TOPICS)}, for a camera whose driver is a node"
"""The kinds of a source."""


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
    try:
        return DeviceFrames(source, size)
    except InvalidInput as error:
        raise InvalidInput(f"{error}; or {' or '.join(TOPICS)}, for a camera whose driver is a node") from error
