"""The frames of a cell.

`table` is the world of a cell: its z axis points up, the plane z = 0 is the table top. `object` is fixed to the object.
`camera_optical` is the camera, with the axes of REP 103: z along the line of sight, x to the right and y down in the image.
Cells that share a tree of transforms put a prefix before these names.
"""

from typing import Any

TABLE = "table"
OBJECT = "object"
CAMERA = "camera_optical"
FRAMES = (TABLE, OBJECT, CAMERA)


def put_prefix(msg: Any, prefix: str) -> None:
    """Put a prefix before the names of the frames in the headers of a message that is to be published.

    Messages that share a header get the prefix once.
    """
    if not prefix:
        return
    for part in (msg, getattr(msg, "basis", None), *getattr(msg, "markers", ())):
        header = getattr(part, "header", None)
        if header is not None and header.frame_id in FRAMES:
            header.frame_id = prefix + header.frame_id


def is_frame(name: str, frame: str) -> bool:
    """Whether a name is that of a frame, with whatever prefix."""
    return name.rpartition("/")[2] == frame
