"""Where a pusher rested, kept for the next process: one file of the user's for each pusher."""

import json
import math
import os
import pathlib
import urllib.parse

from pushfric_core.settings import AUTO

LONGEST = 200
"""Number of characters of the file that are read; it holds one number."""


class PositionMemory:
    """Where a pusher rested, or that its position is unknown because it was moving or had lost it."""

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
        name = urllib.parse.quote(place, safe="")
        self._file = pathlib.Path(folder) / f"{name}.json" if folder else None
        self._kept: float | None = None

    def recall(self) -> float | None:
        """Where it rested [m]; NaN if that is not known; None if nothing was ever kept."""
        if self._file is None:
            return None
        try:
            with open(self._file, encoding="utf-8") as file:
                position = json.loads(file.read(LONGEST))["position"]
            self._kept = math.nan if position is None else float(position)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError, OverflowError):
            self._kept = math.nan  # a damaged file says nothing
        if not math.isfinite(self._kept):
            self._kept = math.nan
        return self._kept

    def keep(self, position: float) -> None:
        """Keep where it rests [m]; NaN if it begins to move or its position is lost. Raises OSError."""
        same = self._kept is not None and (self._kept == position or (math.isnan(self._kept) and math.isnan(position)))
        if self._file is None or same:
            return
        self._file.parent.mkdir(parents=True, exist_ok=True)
        written = self._file.with_suffix(".new")
        with open(written, "w", encoding="utf-8") as file:
            json.dump({"position": None if math.isnan(position) else position}, file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(written, self._file)
        folder = os.open(self._file.parent, os.O_RDONLY)
        try:
            os.fsync(folder)  # the new name, too, outlasts a power cut
        finally:
            os.close(folder)
        self._kept = position
