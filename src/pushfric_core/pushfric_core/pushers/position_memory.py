"""Where a pusher rested, kept for the next process: one file of the user's for each pusher."""

import json
import math
import os
import pathlib
import urllib.parse
from concurrent.futures import Future, ThreadPoolExecutor, wait

from pushfric_core.files.disk import write_whole
from pushfric_core.settings import AUTO

RESOLUTION = 2e-5
"""A position at rest is written again only if it differs by more than this: the poses of an arm are noisy [m]."""
LONGEST = 200
"""Number of characters of the file that are read; it holds one number."""


class PositionMemory:
    """Where a pusher rested, or that its position is unknown because it was moving or had lost it.

    A thread of its own writes it: a disk may take longer than a moving pusher may be left alone.
    """

    def __init__(self, folder: str, place: str) -> None:
        """Nothing is read yet.

        Args:
            folder: `auto`: the user's state folder; empty: nothing is kept.
            place: what identifies the pusher, as `Pusher.place`.
        """
        self.place = place
        if folder == AUTO:
            state = os.environ.get("XDG_STATE_HOME") or pathlib.Path.home() / ".local/state"
            folder = str(pathlib.Path(state) / "pushfric")
        self._file = pathlib.Path(folder) / f"{urllib.parse.quote(place, safe='')}.json" if folder else None
        self._kept: float | None = None  # or is about to be
        self._disk = ThreadPoolExecutor(1, "memory")
        self._writing: Future[None] | None = None

    def recall(self) -> float | None:
        """Where it rested [m]; NaN if that is not known; None if nothing was ever kept."""
        if self._file is None:
            return None
        try:
            with open(self._file, encoding="utf-8") as file:
                self._kept = float(json.loads(file.read(LONGEST))["position"])
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError, OverflowError):
            self._kept = math.nan  # a null, or a damaged file, says nothing
        if not math.isfinite(self._kept):
            self._kept = math.nan
        return self._kept

    def keep(self, position: float) -> None:
        """Have it kept where it rests [m]; NaN if it begins to move or its position is lost.

        Where it rests is not kept while the disk is busy, and nothing if it refuses: call again.
        """
        kept, moves = None if self.settle(0.0) else self._kept, math.isnan(position)
        same = kept is not None and (abs(kept - position) <= RESOLUTION or (math.isnan(kept) and moves))
        if self._file is None or same or not (self.settled or moves):
            return
        self._kept = position
        self._writing = self._disk.submit(write_whole, self._file, json.dumps({"position": None if moves else position}))

    @property
    def settled(self) -> bool:
        """Whether the disk has what was last to be kept, or has refused it."""
        return self._writing is None or self._writing.done()

    def settle(self, seconds: float) -> BaseException | None:
        """Wait for the disk, at most so long; return why what was last to be kept was not."""
        if self._writing is None or not wait((self._writing,), seconds).done:
            return None
        return self._writing.exception()
