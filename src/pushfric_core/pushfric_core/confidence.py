"""How far p_CF can be trusted: from the scatter of estimates from halves of the pushes, each with its own warm program.

The method is that of balanced half-samples. The scatter of an estimate from m of n pushes about the estimate from all of them
is sqrt((n - m) / m) times the scatter of the latter about the truth (McCarthy, "Pseudo-replication: half samples", Review of
the International Statistical Institute 37, 1969). It does not show errors that all pushes have in common, such as a wrong
outline or camera.
"""

import math
from collections import Counter
from collections.abc import Callable

import numpy as np

from pushfric_core.constraint_rows import ConstraintRows
from pushfric_core.planar import Array
from pushfric_core.solvers.program import Program
from pushfric_core.support import center_of_friction

SHARE = 0.9
"""The truth lies within the radius this often."""

SPLITS = 6
"""Number of ways in which the pushes are split into halves; each half has its own program."""

FEWEST_PUSHES = 4
"""With fewer pushes, halves say nothing."""


class Halves:
    """Estimates from halves of the pushes. Consecutive pushes are often alike, so of each pair one goes into each half.

    Args:
        support_points: (n, 2) [m].
        make: makes an empty program over these points.
    """

    def __init__(self, support_points: Array, make: Callable[[], Program]) -> None:
        self._points = support_points
        self._halves = [_Half(make()) for _ in range(2 * SPLITS)]
        self._homes: dict[int, list[_Half]] = {}  # for each push, in order of arrival: its half of each split
        self._pushes: dict[int, int] = {}  # of groups

    def add(self, group: int, push_id: int, rows: ConstraintRows) -> None:
        """Take a data point."""
        self._pushes[group] = push_id
        if push_id not in self._homes:
            self._homes[push_id] = self._drawn(len(self._homes))
        for half in self._homes[push_id]:
            half.add(group, push_id, rows)

    def remove(self, group: int) -> None:
        """Take a data point out again."""
        push_id = self._pushes.pop(group)
        for half in self._homes[push_id]:
            half.remove(group, push_id)

    def radius(self, center: Array) -> float | None:
        """Radius of the circle about p_CF that contains the truth with 90 % [m]; None with fewer than FEWEST_PUSHES pushes.

        Args:
            center: p_CF (2,) from all pushes [m].
        """
        pushes = sum(len(half.pushes) for half in self._halves[:2])  # the halves of any split contain all pushes
        if pushes < FEWEST_PUSHES:
            return None
        shifts = []
        for half in self._halves:
            share = len(half.pushes) / pushes
            if 0 < share < 1:
                shifts.append((half.center(self._points) - center) * math.sqrt(share / (1 - share)))
        scatter = np.array(shifts)
        largest = float(np.linalg.eigvalsh(scatter.T @ scatter / len(scatter))[-1])
        # the circle that contains this much of a normal distribution
        return math.sqrt(-2 * math.log(1 - SHARE) * max(largest, 0.0))

    def _drawn(self, number: int) -> "list[_Half]":
        """The half of each split to which a push belongs, by its number in order of arrival."""
        pair, second = divmod(number, 2)
        swapped = np.random.default_rng(pair).integers(0, 2, SPLITS)  # a fixed choice for each pair
        return [self._halves[2 * split + (second ^ int(swap))] for split, swap in enumerate(swapped)]


class _Half:
    """The program of some of the pushes."""

    def __init__(self, program: Program) -> None:
        self._program = program
        self._added = 0
        self._groups: dict[int, int] = {}  # number of each data point in the estimator -> in the program
        self.pushes: Counter[int] = Counter()  # number of data points of each push
        self._center: Array | None = None

    def add(self, group: int, push_id: int, rows: ConstraintRows) -> None:
        self._program.add(rows)
        self._groups[group] = self._added
        self._added += 1
        self.pushes[push_id] += 1
        self._center = None

    def remove(self, group: int, push_id: int) -> None:
        self._program.remove(self._groups.pop(group))
        self.pushes[push_id] -= 1
        if not self.pushes[push_id]:
            del self.pushes[push_id]
        self._center = None

    def center(self, support_points: Array) -> Array:
        if self._center is None:
            self._center = center_of_friction(support_points, self._program.solve().w)
        return self._center
