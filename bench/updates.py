"""The CPU time that each contender needs for one new observation, as a table, and the memory that it takes."""

import contextlib
import gc
import itertools
import math
import time
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np
from rich.table import Table

from bench.contenders import CONTENDERS, Contender, NoOptimum, OutOfTime
from bench.display import Figures, Verdict, plain_tables
from bench.observations import data_points
from pushfric_core.solvers.simplex import Simplex

LIMIT = 20.0
"""A contender is left out if an update takes more CPU time than this [s], or if an update or its load is expected to."""

LIMITS = {"pushfric": 300.0}
"""The same of those without which nothing is measured; pushfric's load is a solve after each observation."""

GROWTH = 0.2
"""Updates are measured while the observations grow by at most this fraction; then another sequence of pushes begins."""

SHORTEST = 10
"""Least number of updates in a sequence."""

FEWEST = 3
"""Least number of updates of a slow contender in a cell, even if they use up its budget."""

AGREEMENT = 1e-6
"""Contenders may differ by this fraction of the objective."""

LARGEST = 36
"""The targets hold up to this number of support points."""

TIMES = {50: (25, 2), 100: (25, 2), 1000: (650, 7), 10000: (10000, 40)}
"""For each M: how many times faster pushfric must be than linprog, and than HiGHS kept warm."""

FLATNESS = 2
"""The median at M = 100000 must be at most this many times that at M = 100."""

TAIL = 20
"""The 99th percentile must be at most this many times the median."""


def measure(
    points: Sequence[int], supports: Sequence[int], updates: int, budget: float, held: int, progress: Callable[[str], None]
) -> Figures:
    """The cost of every contender for each number of observations M and of support points N, and memory (`memory`).

    Args:
        points: values of M, the number of earlier observations.
        supports: values of N.
        updates: number of updates to measure in each cell, that is for each M and N.
        budget: CPU time of a contender in a cell [s]; afterwards it is no longer measured there.
        held: number of observations over which memory is measured.
        progress: called with a description of each cell before it begins.
    Returns:
        "updates": rows {M, N, contender, median_cpu_ms, p99_cpu_ms, count, objective_error}; the last is the largest relative
        difference from pushfric's objective. "disagreements": a line for each program that a contender did not solve, or
        solved with another result.
    """
    rows: list[Figures] = []
    disagreements: list[str] = []
    for n in supports:
        slowest = dict.fromkeys(CONTENDERS, 0.0)  # CPU time of its longest solve for each observation there was [s]
        for m in sorted(points):
            # a cost is expected to grow in proportion to M
            running = [name for name, cost in slowest.items() if cost * m <= LIMITS.get(name, LIMIT)]
            progress(f"{m} observations, {n} supports")
            if "pushfric" not in running:
                continue
            cell = _Cell(m, n, running, updates, budget)
            cell.run()
            rows += cell.figures()
            disagreements += cell.disagreements
            slowest |= {name: longest / m for name, longest in cell.longest.items()}
    return {"updates": rows, "disagreements": disagreements, "bytes_per_observation": memory(supports, held, progress)}


class _Cell:
    """The contenders at one M and N, all given each new observation in turn."""

    def __init__(self, m: int, n: int, names: Sequence[str], updates: int, budget: float) -> None:
        self._m, self._n, self._updates, self._budget = m, n, updates, budget
        self._running = list(names)
        self._seconds: dict[str, list[float]] = {name: [] for name in names}
        self._error = dict.fromkeys(names, 0.0)
        self.longest = dict.fromkeys(names, 0.0)
        self.disagreements: list[str] = []

    def run(self) -> None:
        length = min(self._updates, max(SHORTEST, int(GROWTH * self._m)))
        for seed, first in enumerate(range(0, self._updates, length)):
            self._sequence(seed, min(length, self._updates - first))

    def figures(self) -> list[Figures]:
        return [
            {
                "M": self._m,
                "N": self._n,
                "contender": name,
                "median_cpu_ms": 1e3 * float(np.median(seconds)),
                "p99_cpu_ms": 1e3 * float(np.percentile(seconds, 99, method="higher")),
                "count": len(seconds),
                "objective_error": self._error[name],
            }
            for name, seconds in self._seconds.items()
            if seconds
        ]

    def _sequence(self, seed: int, length: int) -> None:
        """Load M observations of a sequence of pushes, then measure `length` updates."""
        groups = list(itertools.islice(data_points(self._n, seed), self._m + length))
        contenders: dict[str, Contender] = {}
        for name in tuple(self._running):  # a copy, as some may leave
            contenders[name] = CONTENDERS[name](self._n, len(groups))
            self._timed(name, partial(contenders[name].load, groups[: self._m]))
        gc.collect()
        gc.disable()
        try:
            for step, rows in enumerate(groups[self._m :]):
                turns = [name for name in contenders if name in self._running]
                # so that no contender always follows the same one, and finds the caches as that one left them
                for name in np.roll(turns, step):
                    seconds = self._timed(name, partial(contenders[name].update, rows))
                    if name in self._running:
                        self._seconds[name].append(seconds)
                    if seconds > LIMIT and name in self._running and name != "pushfric":
                        self._leave(name)
                self._compare({name: contenders[name] for name in turns if name in self._running})
                self._rest()
        finally:
            gc.enable()

    def _timed(self, name: str, work: Callable[[], None]) -> float:
        """CPU time of all threads [s]."""
        start = time.process_time()
        with self._leaving(name):
            work()
        seconds = time.process_time() - start
        self.longest[name] = max(self.longest[name], seconds)
        return seconds

    @contextlib.contextmanager
    def _leaving(self, name: str) -> Iterator[None]:
        """A contender that cannot finish, or finds no optimum, leaves the cell."""
        try:
            yield
        except OutOfTime:
            self._leave(name)
        except NoOptimum as reason:
            self._disagree(name, str(reason))
            self._leave(name)

    def _leave(self, name: str) -> None:
        """Measure a contender no more, and drop its results here."""
        self._running.remove(name)
        self._seconds[name].clear()
        self.longest[name] = math.inf

    def _disagree(self, name: str, reason: str) -> None:
        self.disagreements.append(f"{name} at M = {self._m}, N = {self._n}: {reason}")

    def _compare(self, contenders: dict[str, Contender]) -> None:
        """Compare the objectives, after all contenders have been timed."""
        expected = None  # pushfric comes first
        for name, contender in contenders.items():
            with self._leaving(name):
                found = contender.objective()
                expected = expected or found
                error = abs(found - expected) / expected
                self._error[name] = max(self._error[name], error)
                if error > AGREEMENT:
                    self._disagree(name, f"its objective is {error:.1e} off pushfric's")

    def _rest(self) -> None:
        """Stop measuring contenders that used up their budget; pushfric goes on."""
        for name in self._running[1:]:
            seconds = self._seconds[name]
            if len(seconds) >= FEWEST and sum(seconds) > self._budget:
                self._running.remove(name)


def memory(supports: Sequence[int], count: int, progress: Callable[[str], None]) -> list[Figures]:
    """Memory of pushfric's solver per observation, measured over `count` of them: rows {N, bytes}, including spare room."""
    rows = []
    for n in supports:
        progress(f"memory, {n} supports")
        simplex = Simplex(n)
        simplex.solve()
        tracemalloc.start()
        for group in itertools.islice(data_points(n, 0), count):
            simplex.add(group)
        simplex.solve()
        gc.collect()
        rows.append({"N": n, "bytes": tracemalloc.get_traced_memory()[0] / count})
        tracemalloc.stop()
    return rows


def tables(figures: Figures) -> Iterator[Table]:
    """Medians and 99th percentiles, a line for each M and N; "-" for a contender that was too slow. Memory."""
    for what in ("median", "p99"):
        lines: dict[tuple[int, int], Figures] = {}
        for row in figures["updates"]:
            line = lines.setdefault((row["N"], row["M"]), {"N": row["N"], "M": row["M"]})
            line[row["contender"]] = row[f"{what}_cpu_ms"]
        yield from plain_tables(f"CPU ms of one new observation, {what}", list(lines.values()))
    yield from plain_tables("Memory of an observation", figures["bytes_per_observation"])


def verdicts(figures: Figures) -> Iterator[Verdict]:
    """The targets for the M and N that were measured."""
    row_of = {(row["M"], row["N"], row["contender"]): row for row in figures["updates"]}
    cells = [(m, n) for m, n, name in row_of if name == "pushfric" and n <= LARGEST]
    for m, n in cells:
        own = row_of[m, n, "pushfric"]
        for name, times in zip(("linprog", "highs"), TIMES.get(m, ()), strict=False):
            peer = row_of.get((m, n, name))
            measured = None if peer is None else peer["median_cpu_ms"] / own["median_cpu_ms"]
            met = measured is not None and measured >= times
            yield Verdict(f"{name} / pushfric, M = {m}, N = {n}", f">= {times}", measured, met)
        yield Verdict.at_most(f"p99 / median, M = {m}, N = {n}", TAIL, own["p99_cpu_ms"] / own["median_cpu_ms"])
        if m == 100_000 and (100, n) in cells:
            growth = own["median_cpu_ms"] / row_of[100, n, "pushfric"]["median_cpu_ms"]
            yield Verdict.at_most(f"median at M = 100000 / at 100, N = {n}", FLATNESS, growth)


def failures(figures: Figures) -> list[str]:
    """A line for each program that a contender did not solve, or solved with another result."""
    return list(figures["disagreements"])
