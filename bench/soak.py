"""Whether a cell that runs for long grows: resident memory, threads and open files of each node, and their slopes."""

import pathlib
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import yaml

from pushfric_core.errors import PushfricError
from pushfric_ros.commands.demo import demo_cell
from pushfric_ros.files.node_settings import PlanConfig
from pushfric_ros.graph import graph
from pushfric_ros.graph.supervisor import Supervisor

OBJECT, SPEED = "rubber_rect4", 5.0

PUSHES = 120
"""Pushes planned for each minute: more than there is time for."""

PERIOD = 2.0
"""Time between samples [s]."""

WARM_UP = 0.3
"""The first share of the samples does not count: libraries are loaded and caches filled."""

PER_DATA_POINT = 4.0
"""Memory that a data point may take in the estimator [kB]."""

ALLOWED = 4096.0
"""Memory that a process may take in addition over the whole time, as noise of its allocator [kB]."""

KINDS = ("memory [kB]", "threads", "files")


class Growth(NamedTuple):
    """How one figure of a node changed."""

    node: str
    kind: str  # of KINDS
    first: float  # after the warm-up, by the fitted line
    last: float
    slope: float  # per hour
    flat: bool  # whether the slope is no steeper than what the node keeps of its data


def measure(minutes: float, progress: Callable[[str], None]) -> dict[str, Any]:
    """Run a simulated cell for this long, and follow its nodes.

    Returns:
        "growth": a `Growth` for each node and kind, "data_points": number of data points that came meanwhile.
    Raises:
        PushfricError: the run ended before the time was over.
    """
    samples: dict[str, list[tuple[float, ...]]] = {}
    with tempfile.TemporaryDirectory(prefix="pushfric-soak-") as folder:
        here = pathlib.Path(folder)
        count = max(1, round(PUSHES * minutes))
        plan = [{"edge": number % 4, "offset": 0.01 * (number % 3 - 1)} for number in range(count)]
        (here / "plan.yaml").write_text(yaml.safe_dump({"pushes": plan}))
        cell = replace(demo_cell(OBJECT, here), plan=PlanConfig(plan=str(here / "plan.yaml")))
        specs = graph.simulated_cell(cell, str(here / "bag"), seed=0, speed=SPEED)
        said: list[str] = []
        with Supervisor(specs, graph.NAMESPACE, lambda name, line: said.append(f"{name}: {line}")) as supervisor:
            begin = time.monotonic()
            while (now := time.monotonic() - begin) < 60 * minutes:
                if (ended := supervisor.poll()) is not None:
                    raise PushfricError(f"the cell ended after {now:.0f} s: {ended.reason}; {' '.join(said[-3:])}")
                for node, pid in supervisor.processes.items():
                    samples.setdefault(node, []).append((now, *_figures(pid)))
                progress(f"{now / 60:.0f} of {minutes:g} minutes")
                time.sleep(PERIOD)
        data_points = _data_points(here / "bag")
    growth = [one for node, taken in samples.items() for one in _growth(node, np.array(taken), data_points)]
    return {"growth": growth, "data_points": data_points, "minutes": minutes}


def _figures(pid: int) -> tuple[float, float, float]:
    """Resident memory [kB], number of threads and of open files of a process."""
    status = dict(line.split(":", 1) for line in pathlib.Path(f"/proc/{pid}/status").read_text().splitlines())
    files = len(list(pathlib.Path(f"/proc/{pid}/fd").iterdir()))
    return float(status["VmRSS"].split()[0]), float(status["Threads"]), float(files)


def _growth(node: str, samples: np.ndarray, data_points: int) -> Iterator[Growth]:
    """Slopes of a node's figures; samples (m, 4): time [s], and a column for each of KINDS."""
    counted = samples[int(WARM_UP * len(samples)) :]
    hours = counted[:, 0] / 3600
    for kind, values in zip(KINDS, counted[:, 1:].T, strict=True):
        slope, start = np.polyfit(hours, values, 1) if len(counted) > 1 else (0.0, values[0])
        first, last = start + slope * hours[0], start + slope * hours[-1]
        keeps = PER_DATA_POINT * data_points * (node == "estimator") + ALLOWED
        flat = last - first <= keeps if kind == KINDS[0] else last - first < 1.0
        yield Growth(node, kind, float(first), float(last), float(slope), bool(flat))


def _data_points(bag: pathlib.Path) -> int:
    from pushfric_ros.bags.bag import Bag

    topics = Bag(bag).summary.topics
    return sum(topic.message_count for topic in topics if topic.name.endswith("/observation"))
