"""Rows of numbers that are kept, with the groups they belong to."""

import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.planar import Array

SPARE = 64
"""Initial room, as a number of rows; the room doubles whenever it is too small."""


class RowTable:
    """Rows of numbers, each of which belongs to a group, with room to grow."""

    def __init__(self, columns: int) -> None:
        self._room = np.empty((SPARE, columns))
        self._groups = np.empty(SPARE, int)
        self._count = 0

    @property
    def rows(self) -> Array:
        """The rows (m, columns), in order of arrival; a view."""
        return self._room[: self._count]

    @property
    def groups(self) -> npt.NDArray[np.intp]:
        """The group (m,) of each row; a view."""
        return self._groups[: self._count]

    def append(self, rows: Array, group: int) -> None:
        """Add rows (k, columns) of one group."""
        first, self._count = self._count, self._count + len(rows)
        if self._count > len(self._room):
            self._room = np.concatenate((self._room[:first], np.empty((self._count, self._room.shape[1]))))
            self._groups = np.concatenate((self._groups[:first], np.empty(self._count, int)))
        self._room[first : self._count] = rows
        self._groups[first : self._count] = group

    def remove(self, group: int) -> None:
        """Remove all rows of a group; the others keep their order."""
        kept = self.groups != group
        rows, groups = self.rows[kept], self.groups[kept]
        self._count = len(rows)
        self._room[: self._count], self._groups[: self._count] = rows, groups
