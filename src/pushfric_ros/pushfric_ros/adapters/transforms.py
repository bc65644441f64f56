"""tf2_msgs/TFMessage: an arm's links, AprilTag detectors, and whatever else is in the tree of transforms."""

from dataclasses import dataclass
from typing import Any

from pushfric_core.settings import setting
from pushfric_ros.adapters.body import Body, Source, chain

MOVING, FIXED = "/tf", "/tf_static"
TYPE = "tf2_msgs/msg/TFMessage"
DEEPEST = 100
"""Largest number of transforms between two frames; more mean that they run in a circle."""


@dataclass(frozen=True)
class TransformsConfig:
    """A frame of the tree of transforms."""

    frame: str = setting("tool0", "frame of the body, such as the last link of an arm or a tag")
    reference: str = setting("base_link", "frame in which the body is wanted, with its z axis up")

    def open_source(self) -> Source:
        """The source."""
        return Transforms(self.frame, self.reference)


class Transforms:
    """A frame seen from another one, whenever a transform between them moves.

    The newest transform of each pair of frames is used, even if their stamps differ. The body has the newest of these stamps.
    """

    def __init__(self, frame: str, reference: str) -> None:
        self.topics = {FIXED: (TYPE, "latched"), MOVING: (TYPE, "reliable")}
        self._frame, self._reference = frame, reference
        self._parents: dict[str, tuple[str, Body]] = {}

    def body(self, topic: str, msg: Any) -> Body | None:
        """The frame after a message; None if the message does not move it, or the way to it is not known yet."""
        moved = set()
        for each in msg.transforms:
            parent, child = each.header.frame_id.lstrip("/"), each.child_frame_id.lstrip("/")
            body = Body.of(each.header.stamp, each.transform.translation, each.transform.rotation)
            if topic == FIXED:
                body = body._replace(stamp=0)
            self._parents[child] = parent, body
            moved.add(child)
        down, up = self._ancestry(self._frame), self._ancestry(self._reference)
        common = next((name for name in down if name in up), None)
        if common is None:
            return None
        below, above = down[: down.index(common)], up[: up.index(common)]
        if topic == FIXED or not moved & {*below, *above}:
            return None
        path = [self._parents[name][1].inverted() for name in above]
        path += [self._parents[name][1] for name in reversed(below)]
        return chain(path)

    def _ancestry(self, name: str) -> list[str]:
        """A frame, its parent, the parent of that, and so on."""
        names = [name]
        while names[-1] in self._parents:
            names.append(self._parents[names[-1]][0])
            if len(names) > DEEPEST:
                raise ValueError(f"the transforms above the frame {name!r} run in a circle")
        return names
