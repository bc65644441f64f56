"""The targets: what one new data point may cost compared with the peers, and what was measured."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

LARGEST = 36
"""The targets hold up to this number of support points."""

TIMES = {50: (25, 2), 100: (25, 2), 1000: (650, 7), 10000: (10000, 40)}
"""For each M: how many times faster pushfric must be than linprog, and than HiGHS kept warm."""

FLATNESS = 2
"""The median at M = 100000 must be at most this many times that at M = 100."""

TAIL = 20
"""The 99th percentile must be at most this many times the median."""

Figures = dict[str, Any]


class Verdict(NamedTuple):
    """One target; if it was not measured, it is not met."""

    target: str
    asked: str
    measured: float | None
    met: bool


def with_best_of_highs(updates: Sequence[Figures]) -> list[Figures]:
    """The rows, and for each M and N the row of the HiGHS form with the lower median again, as `highs_warm`."""
    best: dict[tuple[int, int], Figures] = {}
    for row in sorted(updates, key=lambda row: -row["median_cpu_ms"]):
        if row["contender"] in ("highs_primal", "highs_dual"):
            best[row["M"], row["N"]] = {**row, "contender": "highs_warm", "form": row["contender"].removeprefix("highs_")}
    return [*updates, *(best[cell] for cell in sorted(best, key=lambda cell: cell[::-1]))]


def verdicts(updates: Sequence[Figures]) -> Iterator[Verdict]:
    """The targets for the M and N that were measured."""
    row_of = {(row["M"], row["N"], row["contender"]): row for row in updates}
    cells = [(m, n) for m, n, name in row_of if name == "pushfric" and n <= LARGEST]
    for m, n in cells:
        own = row_of[m, n, "pushfric"]
        for peer, times in zip(("linprog", "highs_warm"), TIMES.get(m, ()), strict=False):
            row = row_of.get((m, n, peer))
            measured = row["median_cpu_ms"] / own["median_cpu_ms"] if row else None
            yield Verdict(
                f"{peer} / pushfric, M = {m}, N = {n}", f">= {times}", measured, measured is not None and measured >= times
            )
        tail = own["p99_cpu_ms"] / own["median_cpu_ms"]
        yield Verdict(f"p99 / median, M = {m}, N = {n}", f"<= {TAIL}", tail, tail <= TAIL)
        if m == 100_000 and (100, n) in cells:
            growth = own["median_cpu_ms"] / row_of[100, n, "pushfric"]["median_cpu_ms"]
            yield Verdict(f"median at M = 100000 / at 100, N = {n}", f"<= {FLATNESS}", growth, growth <= FLATNESS)
