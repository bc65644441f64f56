"""The linear program for w, solved exactly and incrementally: each solve starts from the last optimal basis.

`pivoting` exchanges its conditions. This module makes the cost independent of the number of earlier observations, and certifies
the result.

A row far from zero keeps its side, so it is linear: |a . (x - c)| <= |a|* |x - c| with |v|^2 = v' C v and |a|*^2 = a' C^-1 a, C
the second moment of the rows (x moves most where the rows see it least: in any other norm the bound is ten times worse). Rows
settled in a ball around c need no look while x stays in it, and a descent that would leave it by far stops first. The balls are
nested, the more of them the more rows there are. The smallest is sorted often, but only from the rows that the next larger one
leaves unsettled, and so on. So all rows are looked at seldom: the cost of an observation does not grow with their number.
"""

from typing import NamedTuple

import numpy as np

from pushfric_core.errors import warn_unless_compiled
from pushfric_core.geometry.planar import Array, Indices
from pushfric_core.program.constraints import ConstraintRows
from pushfric_core.solvers import pivoting
from pushfric_core.solvers.active_set import nearest_uniform
from pushfric_core.solvers.basis import Basis
from pushfric_core.solvers.pivoting import Ball
from pushfric_core.solvers.program import (
    HARD_VIOLATION,
    NOISELESS,
    RELATIVE_GAP,
    Groups,
    Optimum,
    Program,
    Solution,
    Status,
    certify,
    finite,
)
from pushfric_core.solvers.tableau import COEFFICIENT, COST, LARGEST, REFRESH, ZERO, Rows, empty_rows

OWN_GAP = RELATIVE_GAP / 2
"""Half of what `program.certify` allows, because it sums in another order and must come to the same conclusion."""

VIOLATED = HARD_VIOLATION / 4
"""A hard row is violated beyond this: well within what the certificate allows, which measures by the largest coefficient."""

FLAT = (1e-12, 1e-15)
"""Slopes within this fraction of the gradient do not descend; the second, rounding itself, is tried if the first fails."""

SHIFT = 1e-10
"""Conditions of a degenerate vertex are shifted apart by about this: far above rounding, hardly ever misleading an exchange."""

ROUNDS = 15
"""Cap on the descents of a solve; afterwards the certificate judges the result."""

CLOSE, CLOSE_PER_COLUMN = 96, 4
"""Rows left unsettled in the smallest ball: exchanges hardly slow down until a few hundred, and more columns travel farther."""

FAR, WIDER = 12, 4
"""Number of rows left in a ball, as a multiple of those in the next smaller one, and the least such multiple if that one has
grown, so that it has room in half of the larger one. All rows together are at least WIDER times those of the largest ball.
"""

FLOOR = 1e-9
"""Least radius a ball is sorted for: the rows of noiseless data are all zero, and none of them is ever settled."""

RIDGE = 1e-5
"""Part of the identity in C, which keeps C invertible before the rows span all directions."""

SAMPLE = 2048
"""Number of rows, or 2 n if that is more, from which C is computed."""

BLOCK = 512
"""Norms are computed for this many rows at a time, because the product for all of them would double the memory."""


STEEP = 1e-9
"""An edge along which F rises by less than this fraction of its gradient counts as level."""

warn_unless_compiled(pivoting, "the solver is")


class _Shell(NamedTuple):
    """A ball around the close one, and the rows that it settles or leaves to smaller ones."""

    size: int  # about how many rows were to be left
    unsettled: Indices
    fresh: int  # rows from this one on came later, and are unsettled, too
    ball: Ball
    gradient: Array  # of F, of the rows that this ball settles and no larger one; changed in place where they are removed


class Simplex(Program):
    """Minimises F over the weights of n support points, and the scale if there is one, while rows are added and removed.

    Args:
        n: number of support points.
        with_scale: the rows have an additional last column for the scale, a variable >= 0 besides the weights.
    Raises:
        ValueError: n < 1.
    """

    def __init__(self, n: int, with_scale: bool = False) -> None:
        if n < 1:
            raise ValueError(f"n must be at least 1, got {n}")
        self._n, self._columns = n, n + with_scale
        self._close_size = CLOSE + CLOSE_PER_COLUMN * self._columns
        self._far_size = FAR * self._close_size
        self._rows = empty_rows(self._close_size, self._columns)  # in order of arrival, the first _count in use
        self._count = self._removed = 0
        self._groups = Groups()
        self._scaled = 0  # number of rows that contain the scale
        self._worst = 0.0  # the largest cost of any w without a scale
        self._basis = Basis(n, self._columns)
        self._optimum: Optimum | None = None  # of the present rows
        self._infeasible = False
        self._strained = False  # the balls had to be enlarged; around the optimum, small ones will be enough again
        self._metric: Array = np.eye(self._columns)  # |v| is the length of metric' v
        self._whitening: Array = self._metric  # the inverse of metric'
        self._metric_count = self._measured = 0  # rows there were when it was chosen; rows whose |a|* is known
        self._close = Ball(self._metric, self._basis.conditions.x.copy(), np.inf)  # its unsettled rows are those of the basis
        self._shells: list[_Shell] = []  # the larger balls, the largest first

    def add(self, added: ConstraintRows) -> None:
        """As of a `Program`; huge coefficients and costs are refused, too."""
        a, above, below = map(_plain, added)
        m = len(above)
        if a.shape != (m, self._columns) or above.shape != (m,) or below.shape != (m,):
            raise ValueError(
                f"rows must have shapes (m, {self._columns}), (m,), (m,); got {a.shape}, {above.shape}, {below.shape}"
            )
        first, last = self._count, self._count + m
        if last > len(self._rows.a):
            self._rows = self._rows.with_room(2 * last)
        unsettled = self._basis.has_room(m) and not self._strained
        worst = pivoting.receive(self._basis.state, self._rows, first, self._groups.next, a, above, below, self._n, unsettled)
        if worst == COEFFICIENT:
            raise ValueError(f"the coefficients of the rows must be finite, and at most {LARGEST:g}")
        if worst == COST:
            raise ValueError(f"the costs of the rows must not be negative or NaN, and at most {LARGEST:g} or infinite")
        self._groups.add()
        self._count = last
        self._optimum = None
        self._worst += worst
        if self._columns > self._n:
            self._scaled += int(np.count_nonzero(a[:, self._n]))
        if not unsettled:
            self._sort()

    def remove(self, group: int) -> None:
        self._groups.remove(group)
        first, last = np.searchsorted(self._rows.group[: self._count], (group, group + 1))
        if first == last:
            return
        rows, numbers = self._rows.part(slice(first, last)), np.arange(first, last)
        gradients = _slope(rows)[:, None] * rows.a
        settled = ~self._basis.free(numbers)
        self._basis.forget(gradients[settled].sum(axis=0))
        for shell in self._shells:
            here = settled & (numbers < shell.fresh) & ~np.isin(numbers, shell.unsettled)
            np.subtract(shell.gradient, gradients[here].sum(axis=0), out=shell.gradient)
            settled &= ~here
        self._optimum = None
        self._removed += len(numbers)
        self._worst -= float(np.abs(rows.a[:, : self._n]).max(axis=1) @ finite(rows.cost).max(axis=1))
        self._scaled -= int(np.count_nonzero(rows.a[:, self._n :]))
        # a row without cost does no harm: it may stay active until an exchange takes it out
        rows.cost[:] = 0.0
        rows.scale[:] = 0.0

    def solve(self) -> Optimum:
        """The optimum over the present rows, starting from the last one. If several w are optimal, w is a vertex of their set.

        If hard rows contradict each other, w has the least sum of violations, and of such w the smallest F.
        """
        if self._optimum is None:
            self._optimum = self._solved()
        return self._optimum

    def nearest_uniform(self) -> Optimum:
        """As `solve`, but of equally good w the one nearest to equal weights, unless there is a scale. O(M n)."""
        optimum = self.solve()
        if self._columns > self._n or optimum.status is not Status.OPTIMAL or self.unique():
            return optimum
        certificate = self.certificate()
        if certificate.status is not Status.OPTIMAL:
            return optimum
        return nearest_uniform(self.rows(), certificate).optimum

    def multipliers(self) -> Array:
        """The dual y of the last optimum, one per present row in order of arrival; O(M)."""
        self._remember_sides()
        rows = self._rows.part(slice(self._count))
        y = _slope(rows)
        numbers, active = self._basis.active_rows()
        y[numbers] = active
        if self._infeasible or (y @ rows.a[:, : self._n]).min() < 0:
            y[:] = 0.0  # F >= 0 is the better bound
        present = rows.scale > 0
        return np.asarray(y[present] / rows.scale[present])

    def unique(self) -> bool:
        """Whether the last optimum is certainly the only one: from its vertex F rises along every edge, and not just barely."""
        return bool(pivoting.rises(self._basis.state, STEEP))

    def rows(self) -> ConstraintRows:
        """The present rows, in order of arrival; O(M)."""
        rows = self._rows.part(slice(self._count))
        if not (present := rows.scale > 0).all():
            rows = rows.part(present)
        scale = rows.scale[:, None]
        return ConstraintRows(rows.a * scale, *(rows.cost / scale).T)

    def certificate(self) -> Solution:
        """The last optimum, judged from scratch by `program.certify`; O(M)."""
        return certify(
            self.rows(),
            self._basis.conditions.x[: self._n],
            self.multipliers(),
            self._scale() if self._columns > self._n else None,
        )

    def conflicts(self) -> list[int]:
        """The groups whose hard rows contradict each other; none unless the last optimum is infeasible.

        Weighted with the multipliers of the least violation, their rows add up to one that every w violates (Farkas).
        """
        if not self._infeasible:
            return []
        return [int(group) for group in np.unique(self._rows.group[self._basis.contradiction(VIOLATED)])]

    def _solved(self) -> Optimum:
        for flat in FLAT:
            optimum = self._optimise(flat)
            if optimum.status is not Status.UNCERTIFIED:
                return optimum
            self._basis.refresh()
        self._basis.restart()
        self._sort()
        optimum = self._optimise(FLAT[0])
        if optimum.status is Status.UNCERTIFIED:
            # hard rows contradict each other by about as much as is tolerated: descents may go in circles unless nothing is
            optimum = self._optimise(FLAT[0], ZERO)
        return optimum

    def _scale(self) -> float:
        return float(self._basis.conditions.x[self._n]) if self._scaled else 0.0

    def _optimise(self, flat: float, tolerated: float = VIOLATED) -> Optimum:
        """Lexicographic descent, until x is optimal for the unsettled rows and no other was settled wrongly."""
        effort = inversions = 0
        proven = False
        while effort < ROUNDS and inversions < 10 + self._columns:
            state = self._basis.state
            result = pivoting.improve(state, self._close, self._n, flat, SHIFT * 0.1**effort, tolerated)
            stays, self._infeasible, consistent, feasible, objective, lower_bound, smallest = result
            if state.updates >= REFRESH:
                self._basis.refresh()
                inversions += 1
                continue
            lower_bound = max(0.0, min(lower_bound, objective))
            gap = objective - lower_bound
            proven = feasible and gap <= OWN_GAP * max(objective, NOISELESS * self._worst) and smallest >= 0
            if not stays:
                self._sort(effort)
                proven = False
            elif proven or consistent:
                break
            effort += 1
        self._strained = effort > 1
        if proven:
            w = self._basis.conditions.x[: self._n].copy()
            w.setflags(write=False)
            return Optimum(w, self._scale(), objective, lower_bound, gap, Status.OPTIMAL)
        self._basis.check()
        truth = self.certificate()
        truth.w.setflags(write=False)
        status = Status.INFEASIBLE if self._infeasible else truth.status
        return Optimum(truth.w, truth.scale, truth.objective, truth.lower_bound, truth.gap, status)

    def _sort(self, effort: int = 0) -> None:
        """Centre the close ball on x: settle the rows far from zero there, and give the basis the others.

        Each effort doubles the balls, so that a descent that leads out of them again and again ends with all rows unsettled.
        """
        self._remember_sides()
        x = self._basis.conditions.x.copy()
        close = self._close_size << effort
        sizes = self._shell_sizes(close)
        kept = 0 if self._measure() else self._shells_around(x, sizes)
        del self._shells[kept:]
        near, room = self._beyond(), self._shells[-1].ball.radius if self._shells else np.inf
        for size in sizes[kept:]:
            near, ball, gradient = _settle(self._rows, near, self._metric, x, size, room)
            self._shells.append(_Shell(size, near, self._count, ball, gradient))
            room = ball.radius
        self._strained = False
        near, self._close, gradient = _settle(self._rows, near, self._metric, x, close, room)
        outer = sum((shell.gradient for shell in self._shells), np.zeros(self._columns))
        self._basis.replace(near, self._rows, outer + gradient)

    def _shell_sizes(self, close: int) -> list[int]:
        """About how many rows each shell leaves unsettled, the largest first."""
        smallest = max(self._far_size, WIDER * close)
        sizes, size = [smallest], self._far_size * FAR
        while WIDER * size < self._count:
            if size >= WIDER * smallest:
                sizes.insert(0, size)
            size *= FAR
        return sizes

    def _shells_around(self, x: Array, sizes: list[int]) -> int:
        """How many of the shells, the largest ones, can stay: they have these sizes, few new rows, and x near their centre."""
        kept = 0
        for shell, size in zip(self._shells, sizes, strict=False):
            grown = len(shell.unsettled) + self._count - shell.fresh > 2 * size
            if shell.size != size or grown or not pivoting.holds(shell.ball, x, 0.5):
                break
            kept += 1
        return kept

    def _beyond(self) -> Indices:
        """The rows that the smallest shell leaves unsettled, and those that have come since."""
        if not self._shells:
            return np.arange(self._count)
        shell = self._shells[-1]
        return np.concatenate((shell.unsettled, np.arange(shell.fresh, self._count)))

    def _measure(self) -> bool:
        """Bring the norms |a|* up to date; True if the metric, and so all of them, changed."""
        if 2 * self._removed > self._count:
            self._compact()
        renew = self._count >= max(1, 2 * self._metric_count)
        if renew:
            sample = self._rows.a[: self._count : 1 + self._count // max(SAMPLE, 2 * self._columns)]
            second_moment = sample.T @ sample / len(sample)
            # the scale has a unit of its own: every component gets a part of its own size
            size = second_moment.diagonal().copy()
            size[size == 0] = 1.0
            self._metric = np.ascontiguousarray(np.linalg.cholesky(second_moment + RIDGE * np.diag(size)), float)
            self._whitening = np.asarray(np.linalg.inv(self._metric).T)
            self._metric_count, self._measured = self._count, 0
        for first in range(self._measured, self._count, BLOCK):
            rows = self._rows.part(slice(first, min(first + BLOCK, self._count)))
            whitened = rows.a @ self._whitening
            rows.norm[:] = np.sqrt(np.einsum("ij,ij->i", whitened, whitened)) + ZERO
        self._measured = self._count
        return renew

    def _compact(self) -> None:
        """Forget the removed rows, except active ones."""
        rows = self._rows.part(slice(self._count))
        kept = (rows.scale > 0) | (rows.side == 0)
        self._basis.renumber(np.cumsum(kept) - 1)
        self._count, self._removed, self._metric_count = int(kept.sum()), 0, 0
        for field, old in zip(self._rows.part(slice(self._count)), rows, strict=True):
            field[:] = old[kept]

    def _remember_sides(self) -> None:
        numbers, sides = self._basis.sides()
        self._rows.side[numbers] = sides


def _plain(array: Array) -> Array:
    """As the compiled functions take arrays."""
    return array if array.flags.carray and array.dtype == np.float64 else np.array(array, np.float64, order="C")


def _settle(rows: Rows, numbers: Indices, metric: Array, x: Array, size: int, around: float) -> tuple[Indices, Ball, Array]:
    """Which rows must stay unsettled, about `size` of them; the ball that settles the others, and the gradient of these.

    Updates their sides. The ball has at most half the radius of the one around it: as x is within half of that radius from its
    center, whatever the inner one allows stays in the outer one.
    """
    distance = np.empty(len(numbers))
    pivoting.rank(numbers, x, rows, distance)
    radius = max(FLOOR, float(np.partition(distance, size)[size])) if len(numbers) > size else np.inf
    unsettled = (distance <= radius) & (distance < np.inf)
    gradient = np.zeros(len(x))
    pivoting.add_gradients(numbers[~unsettled], rows, gradient)
    return numbers[unsettled], Ball(metric, x, min(radius, around / 2)), gradient


def _slope(rows: Rows) -> Array:
    """Derivative of each row's cost on its side; 0 where it is active or its cost infinite."""
    above, below = finite(rows.cost).T
    return np.where(rows.side > 0, above, np.where(rows.side < 0, -below, 0.0))
