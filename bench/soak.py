"""Whether a cell that runs for long grows: resident memory, threads and open files of each node, and their slopes."""

import pathlib
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import psutil
import yaml
from mcap.reader import make_reader

from pushfric_core import PushfricError
from pushfric_core.bags.contents import mcap_file
from pushfric_core.cell.node_settings import PlanConfig
from pushfric_core.vision.camera import load_camera
from pushfric_ros.commands.demo import demo_cell
from pushfric_ros.graph import graph
from pushfric_ros.graph.supervisor import Supervisor
from pushfric_ros.nodes.tracker import IMAGE_QUEUE

OBJECT, SPEED = "rubber_rect4", 5.0

PUSHES = 120
"""Pushes planned for each minute: more than there is time for."""

PERIOD = 2.0
"""Time between samples [s]."""

STARTING = 0.1
"""Time between two looks whether the cell records yet [s]."""

WARM_UP = 0.3
"""The first share of the samples does not count: libraries are loaded and caches filled."""

PER_DATA_POINT = 4.0
"""Memory that an observation may take in the estimator [kB]."""

PER_CHUNK = 1.2
"""Memory that a chunk of the bag may take in the recorder [kB]: MCAP's index of chunks is written at the end of the file."""

ALLOWED = 4096.0
"""Memory that any process may take over the whole time, as noise of its allocator [kB]."""

KINDS = ("memory, kB", "threads", "files")


class Growth(NamedTuple):
    """How one figure of a node changed."""

    node: str
    kind: str  # of KINDS
    first: float  # after the warm-up, by the fitted line
    last: float
    slope: float  # per hour
    flat: bool  # whether it grew by no more than what the node keeps on purpose


def measure(minutes: float, progress: Callable[[str], None]) -> dict[str, Any]:
    """Run a simulated cell for this long, and follow its nodes.

    Returns:
        "growth": the figures of a `Growth` for each node and kind, "data_points": number of observations that came meanwhile.
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
            begin, recording = time.monotonic(), False
            while (now := time.monotonic() - begin) < 60 * minutes:
                if (ended := supervisor.poll()) is not None:
                    raise PushfricError(f"the cell ended after {now:.0f} s: {ended.reason}; {' '.join(said[-3:])}")
                if not recording:  # the time counts from then on: a busy machine takes long to start the nodes
                    begin, recording = time.monotonic(), any(file.stat().st_size for file in (here / "bag").glob("*.mcap"))
                    time.sleep(STARTING)
                    continue
                for node, pid in supervisor.processes.items():
                    samples.setdefault(node, []).append((now, *_figures(pid)))
                progress(f"{now / 60:.0f} of {minutes:g} minutes")
                time.sleep(PERIOD)
        data_points, chunks = _recorded(mcap_file(here / "bag"))
        camera = load_camera(cell.camera.calibration)
    # the middleware keeps the memory of a queue that was full once, which happens when the machine is busy
    queue = IMAGE_QUEUE.depth * camera.width * camera.height / 1024
    keeps = {
        "estimator": PER_DATA_POINT * data_points,
        "recorder": PER_CHUNK * chunks,
        "tracker": queue,
    }
    growth = [one._asdict() for node, taken in samples.items() for one in _growth(node, np.array(taken), keeps.get(node, 0.0))]
    return {"growth": growth, "data_points": data_points, "minutes": minutes}


def failures(figures: dict[str, Any]) -> list[str]:
    """A line for each figure that grew."""
    return [
        f"{one['kind']} of {one['node']}: grows from {one['first']:.0f} to {one['last']:.0f}"
        for one in figures["growth"]
        if not one["flat"]
    ]


def _figures(pid: int) -> tuple[float, int, int]:
    """Resident memory [kB], number of threads and of open files of a process."""
    process = psutil.Process(pid)
    return process.memory_info().rss / 1024, process.num_threads(), process.num_fds()


def _growth(node: str, samples: np.ndarray, keeps: float) -> Iterator[Growth]:
    """Slopes of a node's figures; samples (m, 4): time [s], and a column for each of KINDS.

    Args:
        keeps: memory that the node may take for what it keeps on purpose [kB].
    """
    counted = samples[int(WARM_UP * len(samples)) :]
    hours = counted[:, 0] / 3600
    for kind, values in zip(KINDS, counted[:, 1:].T, strict=True):
        slope, start = np.polyfit(hours, values, 1) if len(counted) > 1 else (0.0, values[0])
        first, last = start + slope * hours[0], start + slope * hours[-1]
        flat = last - first <= keeps + ALLOWED if kind == KINDS[0] else last - first < 1.0
        yield Growth(node, kind, float(first), float(last), float(slope), bool(flat))


def _recorded(path: pathlib.Path) -> tuple[int, int]:
    """Number of observations and of chunks of a finished bag."""
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    counts = summary.statistics.channel_message_counts
    made = (counts.get(number, 0) for number, channel in summary.channels.items() if channel.topic.endswith("/observation"))
    return sum(made), summary.statistics.chunk_count
