"""Which images of a run are kept: the placed object, begin, middle and end of each push, and each loss of the object."""

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from pushfric_core.vision.camera import Image

MOST_HELD = 16
"""Images of a push that are held until its middle is known."""


class RunState(NamedTuple):
    """The state of the run while an image is taken."""

    pushes: bool  # whether the forward stroke of a push is under way
    placed: bool  # whether the object lies in place for a push
    in_sight: bool  # whether the image shows the object


class Keyframes:
    """Chooses images as they come.

    Args:
        everything: choose every image.
    """

    def __init__(self, everything: bool) -> None:
        self._everything = everything
        self._before = RunState(False, False, False)
        self._held: list[tuple[int, Image]] = []  # of the push under way, evenly spread over it so far
        self._every, self._count = 1, 0  # each how many-th image of the push is held; how many there were

    def take(self, frame: "Image", stamp: int, now: RunState) -> list[tuple[int, "Image"]]:
        """The images to keep, now that a new one has come: this one, the middle of a push that is over, both or none.

        Args:
            frame: the new image.
            stamp: its time [ns].
            now: what goes on.
        """
        before, self._before = self._before, now
        if self._everything:
            return [(stamp, frame)]
        chosen = []
        if before.pushes and not now.pushes:
            chosen += self._held[len(self._held) // 2 :][:1]
            self._held.clear()
        if now.pushes != before.pushes or now.placed > before.placed or now.in_sight < before.in_sight:
            chosen.append((stamp, frame))
        if now.pushes:
            if not before.pushes:
                self._every, self._count = 1, 0
            if self._count % self._every == 0:
                self._held.append((stamp, frame.copy()))  # a frame may share the memory of a message
            self._count += 1
            if len(self._held) == MOST_HELD:
                del self._held[1::2]
                self._every *= 2
        return chosen
