"""The tableau of the simplex method: its rows and conditions in arrays, and the numbers that those who share them agree on."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.planar import Array, Indices

Mask = npt.NDArray[np.bool_]

# Rows are scaled to a largest coefficient in [1/2, 1), so that tolerances on them are absolute.

ZERO = 1e-14
"""Values this close to zero are rounding; the side of such a row is remembered, not derived from its value."""

REFRESH = 100
"""B^-1 is computed again from scratch after this many updates, before their rounding errors show."""

LARGEST = 1e150
"""No coefficient and no finite cost is larger; a row whose coefficients are all smaller than its inverse is one of zeros."""

VIOLATION, FIT = 0, 1  # the two costs, in lexicographic order
COEFFICIENT, COST = -1.0, -2.0  # what `pivoting.store` finds wrong


class Conditions(NamedTuple):
    """A basis in arrays, with room for more rows than there are.

    Conditions are numbered by position: sum w = 1; then x_j >= 0, j = 1..n; then the rows that are not settled.
    """

    number: Indices  # (room,) of the row, -1 for the other conditions
    a: Array  # (n, room) normals, one per column: along an edge all of them are met, component by component
    value: Array  # (room,) a . x, or shifted from it while a degenerate vertex is left
    side: Array  # (room,) +1, -1, or 0 while active: explicit, because a value of zero has no side
    cost: Array  # (2, 2, room) VIOLATION and FIT; above and below zero
    settled: Array  # (n,) gradient of F of the settled rows: none of them is violated
    gradient: Array  # (2, n) of all inactive conditions, per cost; kept up to date, and summed up again with the inverse
    active: Indices  # (n,) positions; the first is always sum w = 1
    inverse: Array  # (n, n) B^-1
    x: Array  # (n,) the present vertex
    dual: Array  # (n,) multipliers of the active rows, as `pivoting.bounds` left them


class Rows(NamedTuple):
    """Rows in order of arrival, scaled by powers of two to a largest coefficient of the weights in [1/2, 1)."""

    a: Array  # (m, n)
    cost: Array  # (m, 2) above and below
    scale: Array  # (m,) what they were divided by; 0 once removed
    norm: Array  # (m,) |a|*
    side: Array  # (m,) as last seen: +1, -1, or 0 while active
    group: Indices  # (m,)

    def part(self, which: slice | npt.NDArray[np.generic]) -> "Rows":
        a, cost, scale, norm, side, group = self
        return Rows(a[which], cost[which], scale[which], norm[which], side[which], group[which])

    def with_room(self, room: int) -> "Rows":
        grown = empty_rows(room, self.a.shape[1])
        for new, old in zip(grown, self, strict=True):
            new[: len(old)] = old
        return grown


def empty_rows(room: int, columns: int) -> Rows:
    scale, norm, side = np.zeros((3, room))
    return Rows(np.zeros((room, columns)), np.zeros((room, 2)), scale, norm, side, np.zeros(room, np.int64))
