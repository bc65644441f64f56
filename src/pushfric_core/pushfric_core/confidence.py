"""How far p_CF can be trusted: from the scatter of the estimates that halves of the pushes give, each by its own warm program.

Balanced half-samples: an estimate from m of n pushes scatters about that from all of them as sqrt((n - m) / m) times the latter
about the truth (McCarthy, "Pseudo-replication: half samples", Review of the International Statistical Institute 37, 1969). What
all pushes have in common, as a wrong outline or camera, it cannot tell.
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
"""Ways of halving the pushes; either half has a program of its own."""

FEWEST_PUSHES = 4
"""Of fewer, halves say nothing."""


class Halves:
    """Estimates from halves of the pushes; of two pushes that follow each other, often alike, one goes into either half.

    Args:
        support_points: (n, 2) [m].
        make: makes an empty program over them.
    """

    def __init__(self, support_points: Array, make: Callable[[], Program]) -> None:
        self._points = support_points
        self._halves = [_Half(make()) for _ in range(2 * SPLITS)]
        self._homes: dict[int, list[_Half]] = {}  # of each push, in order of arrival: its half of each split
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
        """Of the circle about p_CF that holds the truth with 90 % [m]; None from fewer than FEWEST_PUSHES pushes.

        Args:
            center: p_CF (2,) from all pushes [m].
        """
        pushes = sum(len(half.pushes) for half in self._halves[:2])  # any split holds them all
        if pushes < FEWEST_PUSHES:
            return None
        shifts = []
        for half in self._halves:
            share = len(half.pushes) / pushes
            if 0 < share < 1:
                shifts.append((half.center(self._points) - center) * math.sqrt(share / (1 - share)))
        scatter = np.array(shifts)
        largest = float(np.linalg.eigvalsh(scatter.T @ scatter / len(scatter))[-1])
        # the circle about the ellipse of a normal distribution that holds so much of it
        return math.sqrt(-2 * math.log(1 - SHARE) * max(largest, 0.0))

    def _drawn(self, number: int) -> "list[_Half]":
        """The half of each split for a push, by its number in order of arrival."""
        pair, second = divmod(number, 2)
        swapped = np.random.default_rng(pair).integers(0, 2, SPLITS)  # a fixed choice for each pair
        return [self._halves[2 * split + (second ^ int(swap))] for split, swap in enumerate(swapped)]


class _Half:
    """The program of some of the pushes."""

    def __init__(self, program: Program) -> None:
        self._program = program
        self._added = 0
        self._groups: dict[int, int] = {}  # the estimator's number of each data point -> the program's
        self.pushes: Counter[int] = Counter()  # data points of each
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
