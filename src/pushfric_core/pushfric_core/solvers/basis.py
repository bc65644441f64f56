"""The basis of the linear program: its active conditions, and those that may become active, while rows come and go."""

from typing import Any

import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.planar import Array, Indices
from pushfric_core.solvers import pivoting
from pushfric_core.solvers.pivoting import State
from pushfric_core.solvers.tableau import FIT, VIOLATION, Conditions, Mask, Rows

NEGATIVE_PART = 1e3
"""Cost of a negative x_j relative to that of a violated row; it keeps w in the simplex even if hard rows are contradictory."""

ROOM = 384
"""A basis has room for twice the rows that it was given, and this many more; beyond that, some must be settled."""

BROKEN = 1e-6
"""If the sum of w differs from 1 by this much, the inverse is unusable: the active conditions nearly depend on each other."""


class Basis:
    """n active conditions, the inverse of their normals, and every condition that may become active.

    Args:
        weights: number of columns that are weights, with sum 1.
        n: number of columns.
    """

    def __init__(self, weights: int, n: int) -> None:
        self._weights, self._fixed = weights, 1 + n
        cost = np.zeros((2, 2, self._fixed))
        cost[:, :, 0] = np.inf
        cost[:, 1, 1:] = [[NEGATIVE_PART], [np.inf]]
        conditions = Conditions(
            number=np.full(self._fixed, -1),
            a=np.column_stack((np.arange(n) < weights, np.eye(n))),
            value=np.zeros(self._fixed),
            side=np.ones(self._fixed),
            cost=cost,
            settled=np.zeros(n),
            gradient=np.zeros((2, n)),
            active=np.arange(n),
            inverse=np.empty((n, n)),
            x=np.zeros(n),
            dual=np.zeros(n),
        )
        self.state = State(conditions, self._fixed)
        self._limit = self._fixed + ROOM  # of the count; beyond it, some must be settled
        self._reserve(ROOM)
        self.restart()

    @property
    def conditions(self) -> Conditions:
        """The arrays that the state consists of."""
        return self.state.conditions

    @property
    def count(self) -> int:
        """Number of conditions: the fixed ones, and the rows."""
        return self.state.count

    def restart(self) -> None:
        """Start at the vertex at which the last support point bears everything."""
        conditions = self.conditions
        conditions.side[conditions.active] = 1.0
        conditions.active[:] = np.delete(np.arange(self._fixed), self._weights)
        conditions.side[conditions.active] = 0.0
        self.refresh()

    def refresh(self) -> None:
        """Compute everything again from the active conditions, or from others if these turn out to depend on each other."""
        conditions = self.conditions
        try:
            conditions.inverse[:] = np.linalg.inv(conditions.a[:, conditions.active].T)
        except np.linalg.LinAlgError:
            self.restart()
            return
        self.state.updates = 0
        pivoting.sum_gradients(self.state)
        pivoting.locate(self.state, 0.0)
        self.check()

    def check(self) -> None:
        """Start over if the inverse is unusable."""
        if not abs(self.conditions.x[: self._weights].sum() - 1) < BROKEN:
            self.restart()

    def has_room(self, rows: int) -> bool:
        """Whether this many more rows may come before some must be settled."""
        return self.count + rows <= self._limit

    def replace(self, numbers: Indices, rows: Rows, settled: Array) -> None:
        """Replace all rows, and the gradient of the settled ones.

        Args:
            numbers: of the rows to keep unsettled; they must ascend, and include the active rows.
            rows: all rows.
            settled: (n,) gradient of the settled rows.
        """
        active = self.conditions.number[self.conditions.active]
        self._limit = self._fixed + 2 * len(numbers) + ROOM
        if self._limit > len(self.conditions.value):
            self._reserve(2 * self._limit)
        conditions = self.conditions
        self.state.count = self._fixed
        pivoting.append(self.state, numbers, rows)
        conditions.active[:] = np.where(active < 0, conditions.active, self._fixed + np.searchsorted(numbers, active))
        conditions.side[conditions.active] = 0.0
        conditions.settled[:] = settled
        pivoting.sum_gradients(self.state)

    def free(self, numbers: Indices) -> Mask:
        """Remove the costs of these consecutive rows; return which of them are in the basis."""
        here = self.conditions.number[self._fixed : self.count]
        first, last = self._fixed + np.searchsorted(here, (numbers[0], numbers[-1] + 1))
        for position in range(first, last):
            pivoting.free(self.state, position)
        pivoting.sum_gradients(self.state)
        return np.isin(numbers, self.conditions.number[first:last])

    def forget(self, gradient: Array) -> None:
        """Subtract this part (n,) from the gradient of the settled rows."""
        self.conditions.settled[:] -= gradient
        self.conditions.gradient[FIT] -= gradient

    def renumber(self, numbers: Indices) -> None:
        """Give each row a new number: numbers[old]."""
        rows = slice(self._fixed, self.count)
        self.conditions.number[rows] = numbers[self.conditions.number[rows]]

    def sides(self) -> tuple[Indices, Array]:
        """Number and side of every row in the basis."""
        rows = slice(self._fixed, self.count)
        return self.conditions.number[rows], self.conditions.side[rows]

    def active_rows(self) -> tuple[Indices, Array]:
        """Numbers and multipliers of the active rows."""
        rows = self.conditions.active >= self._fixed
        return self.conditions.number[self.conditions.active[rows]], self.conditions.dual[rows]

    def contradiction(self, smallest: float) -> Indices:
        """The rows whose multiplier in the least violation is larger than this."""
        conditions = self.conditions
        y = np.array([pivoting.slope(self.state, VIOLATION, k, conditions.side[k]) for k in range(self.count)])
        y[conditions.active] = -conditions.gradient[VIOLATION] @ conditions.inverse
        y[: self._fixed] = 0.0
        return conditions.number[np.flatnonzero(np.abs(y) > smallest)]

    def _reserve(self, rows: int) -> None:
        """Make room for this many rows; the present rows are lost."""
        old = self.conditions
        room = 16 * ((self._fixed + rows) // 16) + 24  # not a multiple of a page: a column is read across all rows of `a`

        def resized(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
            new = np.zeros((*array.shape[:-1], room), array.dtype)
            new[..., : self._fixed] = array[..., : self._fixed]
            return new

        wider = {name: resized(getattr(old, name)) for name in ("number", "a", "value", "side", "cost")}
        self.state = State(old._replace(**wider), self.state.count, self.state.updates)
