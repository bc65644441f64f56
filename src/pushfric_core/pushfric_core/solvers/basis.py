"""The basis of the linear program: its active conditions, and those that may become active, while rows come and go."""

from typing import TypeVar

import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.planar import Array
from pushfric_core.solvers import pivoting
from pushfric_core.solvers.pivoting import COUNT, FIT, UPDATES, VIOLATION, Indices, Mask, Rows, State

Number = TypeVar("Number", np.float64, np.int64)

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
        self.state = State(
            tally=np.array((self._fixed, 0)),
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
        self._limit = self._fixed + ROOM  # of the count; beyond it, some must be settled
        self._reserve(ROOM)
        self.restart()

    @property
    def count(self) -> int:
        """Number of conditions: the fixed ones, and the rows."""
        return int(self.state.tally[COUNT])

    def restart(self) -> None:
        """Start at the vertex at which the last support point bears everything."""
        state = self.state
        state.side[state.active] = 1.0
        state.active[:] = np.delete(np.arange(self._fixed), self._weights)
        state.side[state.active] = 0.0
        self.refresh()

    def refresh(self) -> None:
        """Compute everything again from the active conditions, or from others if these turn out to depend on each other."""
        state = self.state
        try:
            state.inverse[:] = np.linalg.inv(state.a[:, state.active].T)
        except np.linalg.LinAlgError:
            self.restart()
            return
        state.tally[UPDATES] = 0
        pivoting.sum_gradients(state)
        pivoting.locate(state, 0.0)
        self.check()

    def check(self) -> None:
        """Start over if the inverse is unusable."""
        if not abs(self.state.x[: self._weights].sum() - 1) < BROKEN:
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
        active = self.state.number[self.state.active]
        self._limit = self._fixed + 2 * len(numbers) + ROOM
        if self._limit > len(self.state.value):
            self._reserve(2 * self._limit)
        state = self.state
        state.tally[COUNT] = self._fixed
        pivoting.append(state, numbers, rows)
        state.active[:] = np.where(active < 0, state.active, self._fixed + np.searchsorted(numbers, active))
        state.side[state.active] = 0.0
        state.settled[:] = settled
        pivoting.sum_gradients(state)

    def free(self, numbers: Indices) -> Mask:
        """Remove the costs of these consecutive rows; return which of them are in the basis."""
        here = self.state.number[self._fixed : self.count]
        first, last = self._fixed + np.searchsorted(here, (numbers[0], numbers[-1] + 1))
        for position in range(first, last):
            pivoting.free(self.state, position)
        pivoting.sum_gradients(self.state)
        return np.isin(numbers, self.state.number[first:last])

    def forget(self, gradient: Array) -> None:
        """Subtract this part (n,) from the gradient of the settled rows."""
        self.state.settled[:] -= gradient
        self.state.gradient[FIT] -= gradient

    def renumber(self, numbers: Indices) -> None:
        """Give each row a new number: numbers[old]."""
        rows = slice(self._fixed, self.count)
        self.state.number[rows] = numbers[self.state.number[rows]]

    def sides(self) -> tuple[Indices, Array]:
        """Number and side of every row in the basis."""
        rows = slice(self._fixed, self.count)
        return self.state.number[rows], self.state.side[rows]

    def active_rows(self) -> tuple[Indices, Array]:
        """Numbers and multipliers of the active rows."""
        rows = self.state.active >= self._fixed
        return self.state.number[self.state.active[rows]], self.state.dual[rows]

    def contradiction(self, smallest: float) -> Indices:
        """The rows whose multiplier in the least violation is larger than this."""
        state = self.state
        y = np.array([pivoting.slope(state.cost[VIOLATION], k, state.side[k]) for k in range(self.count)])
        y[state.active] = -state.gradient[VIOLATION] @ state.inverse
        y[: self._fixed] = 0.0
        return state.number[np.flatnonzero(np.abs(y) > smallest)]

    def _reserve(self, rows: int) -> None:
        """Make room for this many rows; the present rows are lost."""
        state = self.state

        room = 16 * ((self._fixed + rows) // 16) + 24  # not a multiple of a page: a column is read across all rows of `a`

        def resized(old: npt.NDArray[Number]) -> npt.NDArray[Number]:
            new = np.zeros((*old.shape[:-1], room), old.dtype)
            new[..., : self._fixed] = old[..., : self._fixed]
            return new

        self.state = state._replace(
            number=resized(state.number),
            a=resized(state.a),
            value=resized(state.value),
            side=resized(state.side),
            cost=resized(state.cost),
        )
