"""Whether a cell that runs for long grows: resident memory, threads and open files of each node, and their slopes."""

import pathlib
import tempfile
import time
from collections.abc import Callable, Iterator

import numpy as np
import psutil
import yaml
from mcap.reader import make_reader

from bench.display import Figures
from bench.processes import Run, cell_of
from pushfric_core import PushfricError
from pushfric_core.bags.contents import mcap_file
from pushfric_ros.nodes.tracker import IMAGE_QUEUE

SPEED = 5.0

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

QUEUE = IMAGE_QUEUE.depth * 640 * 480 / 1024
"""Memory of the tracker's queue of images [kB]: the middleware keeps it once it was full, as when the machine is busy."""

ALLOWED = 4096.0
"""Memory that any process may take over the whole time, as noise of its allocator [kB]."""

KINDS = ("memory, kB", "threads", "files")


def measure(minutes: float, progress: Callable[[str], None]) -> Figures:
    """Run a simulated cell for this long, and follow its nodes.

    Returns:
        "growth": of each figure of each node {"node", "kind" (of KINDS), "first" and "last" value by the line fitted after the
        warm-up, its "slope" per hour, "flat": whether it grew by no more than what the node keeps on purpose}; "data_points":
        number of observations that came meanwhile.
    Raises:
        PushfricError: a node failed, or the run ended before the time was over.
    """
    samples: dict[str, list[tuple[float, ...]]] = {}
    with tempfile.TemporaryDirectory(prefix="pushfric-soak-") as folder:
        bag, plan = pathlib.Path(folder, "bag"), pathlib.Path(folder, "plan.yaml")
        pushes = [{"edge": number % 4, "offset": 0.01 * (number % 3 - 1)} for number in range(max(1, round(PUSHES * minutes)))]
        plan.write_text(yaml.safe_dump({"pushes": pushes}))
        with Run(cell_of(folder, str(plan), SPEED)) as cell:
            begin, recording = time.monotonic(), False
            while (now := time.monotonic() - begin) < 60 * minutes:
                if cell.finished():
                    raise PushfricError(f"the cell ended after {now:.0f} s")
                if not recording:  # the time counts from then on: a busy machine takes long to start the nodes
                    begin, recording = time.monotonic(), any(file.stat().st_size for file in bag.glob("*.mcap"))
                    time.sleep(STARTING)
                    continue
                for node, pid in cell.processes.items():
                    samples.setdefault(node, []).append((now, *_figures(pid)))
                progress(f"{now / 60:.0f} of {minutes:g} minutes")
                time.sleep(PERIOD)
        with mcap_file(bag).open("rb") as stream:
            summary = make_reader(stream).get_summary()
    counts, topics = summary.statistics.channel_message_counts, summary.channels.items()
    data_points = sum(counts.get(number, 0) for number, channel in topics if channel.topic.endswith("/observation"))
    keeps = {
        "estimator": PER_DATA_POINT * data_points,
        "recorder": PER_CHUNK * summary.statistics.chunk_count,
        "tracker": QUEUE,
    }
    growth = [one for node, taken in samples.items() for one in _growth(node, np.array(taken), keeps.get(node, 0.0))]
    return {"growth": growth, "data_points": data_points, "minutes": minutes}


def failures(figures: Figures) -> list[str]:
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


def _growth(node: str, samples: np.ndarray, keeps: float) -> Iterator[Figures]:
    """How the figures of a node changed; samples (m, 4): time [s], and a column for each of KINDS.

    Args:
        keeps: memory that the node may take for what it keeps on purpose [kB].
    """
    counted = samples[int(WARM_UP * len(samples)) :]
    hours = counted[:, 0] / 3600
    for kind, values in zip(KINDS, counted[:, 1:].T, strict=True):
        slope, start = np.polyfit(hours, values, 1) if len(counted) > 1 else (0.0, values[0])
        first, last = (float(start + slope * hours[end]) for end in (0, -1))
        flat = last - first <= keeps + ALLOWED if kind == KINDS[0] else last - first < 1.0
        yield {"node": node, "kind": kind, "first": first, "last": last, "slope": float(slope), "flat": flat}
