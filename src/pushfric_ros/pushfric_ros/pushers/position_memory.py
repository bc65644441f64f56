"""What a process knew of a pusher's position, kept for the next one: per port, in a file of the user's."""

import json
import math
import os
import pathlib
import urllib.parse

from pushfric_core.settings import AUTO


class PositionMemory:
    """Where a pusher rested; or that it was not known, because it moved, or had lost its position."""

    def __init__(self, folder: str, place: str) -> None:
        """Nothing is read yet.

        Args:
            folder: `auto` for the user's state folder; empty: nothing is kept.
            place: of the pusher, such as its port.
        """
        if folder == AUTO:
            state = os.environ.get("XDG_STATE_HOME") or pathlib.Path.home() / ".local/state"
            folder = str(pathlib.Path(state) / "pushfric")
        name = urllib.parse.quote(place, safe="")
        self._file = pathlib.Path(folder) / f"{name}.json" if folder else None
        self._kept: float | None = None

    def recall(self) -> float | None:
        """Where it rested [m]; nan: that is not known; None: nothing was ever kept."""
        if self._file is None or not self._file.exists():
            return None
        try:
            position = json.loads(self._file.read_text())["position"]
            self._kept = math.nan if position is None else float(position)
        except (OSError, ValueError, KeyError, TypeError):
            self._kept = math.nan  # it was damaged: so nothing is known
        return self._kept

    def keep(self, position: float) -> None:
        """Where it rests [m]; nan: it begins to move, or its position is lost. Raises OSError."""
        same = self._kept is not None and (self._kept == position or (math.isnan(self._kept) and math.isnan(position)))
        if self._file is None or same:
            return
        self._file.parent.mkdir(parents=True, exist_ok=True)
        written = self._file.with_suffix(".new")
        written.write_text(json.dumps({"position": None if math.isnan(position) else position}))
        os.replace(written, self._file)
        self._kept = position
