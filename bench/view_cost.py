"""What the live view costs: image to estimate without it, with it while nobody looks, and with a visitor, in one run.

The three take turns, so that other work of the machine affects all alike. The visitor is a WebSocket client in a process of its
own that reads everything, as a page in the foreground does; it draws nothing.
"""

import pathlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from bench import pipeline
from bench.display import Verdict
from pushfric_core.cell.node_settings import ViewConfig
from pushfric_ros.graph import graph
from pushfric_ros.graph.graph import NodeSpec

WITHOUT, NOBODY, VISITOR = "without a view", "a view, nobody looks", "a view and a visitor"
ROUNDS = 3
SECONDS = 40.0
"""Duration of each run [s]."""

STEPS = 3 * ROUNDS

READER = pathlib.Path(__file__).with_name("visitor.py")

Figures = dict[str, Any]


def measure(progress: Callable[[str], None]) -> Figures:
    """Run the cell at its camera's rate, each way in turn.

    Returns:
        For each way: {estimates, p50_ms: the median of the rounds' medians, p99_ms: the same of their 99th percentiles,
        rounds_p50_ms, cores: CPU time of all nodes over wall time}.
    """
    rounds: dict[str, list[Figures]] = {WITHOUT: [], NOBODY: [], VISITOR: []}
    for number in range(ROUNDS):
        for way, found in rounds.items():
            progress(f"{way}, {number + 1} of {ROUNDS}")
            found.append(_run(way))
    return {
        way: {
            "estimates": sum(one["estimates"] for one in found),
            **{key: float(np.median([one[key] for one in found])) for key in ("p50_ms", "p99_ms", "cores")},
            "rounds_p50_ms": [one["p50_ms"] for one in found],
        }
        for way, found in rounds.items()
    }


def verdicts(figures: Figures) -> Iterator[Verdict]:
    """The target: with nobody looking, no longer than the slowest round without a view."""
    limit = max(figures[WITHOUT]["rounds_p50_ms"])
    measured = figures[NOBODY]["p50_ms"]
    yield Verdict("image to estimate while nobody looks, median, ms", f"<= {limit:.1f}", measured, measured <= limit)


def _run(way: str) -> Figures:
    def viewed(specs: list[NodeSpec]) -> list[NodeSpec]:
        return graph.with_view(specs, pipeline.OBJECT, ViewConfig())

    with _visitors() as visit:

        def said(name: str, line: str) -> None:
            if way == VISITOR and name == "view" and line.startswith("http"):
                visit(line)

        listener = pipeline.Listener()
        pipeline.run(listener, SECONDS, list if way == WITHOUT else viewed, said)
    latency = listener.latency()
    return {key: latency[key] for key in ("estimates", "p50_ms", "p99_ms")} | {"cores": listener.cores}


@contextmanager
def _visitors() -> Iterator[Callable[[str], None]]:
    """A function that sends a visitor to an address; all visitors leave at the end."""
    visitors: list[subprocess.Popen[bytes]] = []
    try:
        yield lambda url: visitors.append(subprocess.Popen([sys.executable, READER, url]))
    finally:
        for visitor in visitors:
            visitor.terminate()
            visitor.wait()
