"""Where the milliseconds and the megabytes go: measures them, and writes the tables of docs/graph.md and docs/estimation.md."""

import pathlib
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message

from bench import footprint, pipeline
from bench.display import Figures
from bench.processes import OBJECT
from docs.markdown import replaced, table
from pushfric_core import Estimate, Estimator, load
from pushfric_core.estimation.estimate_report import BoundsReport, EstimateReport
from pushfric_core.estimation.verdict import Verdict, verdict_on
from pushfric_core.files.disk import write_whole
from pushfric_core.files.object_file import load_object
from pushfric_msgs.msg import FrictionEstimate
from pushfric_ros.messages.conversions import estimate_to_msg

ROOT = pathlib.Path(__file__).resolve().parents[1]
ROUNDS = 7
"""Number of times that all observations are taken."""

PARTS = ("program: w, p_CF and the certificate", "verdict", "lower bounds of mu_c", "message", "serialised")
"""The work for one observation."""


def measure(progress: Callable[[str], None]) -> Figures:
    """Measure, and write the tables.

    Returns:
        "observation_ms": median CPU time of each part of the work for one observation of the demo's bag. "latency_ms": of the
        live graph, median of each part of the way from the image to the estimate, and its 99th percentile. "memory_mib": of
        each process of the demo, and of a bare rclpy node.
    """
    progress("an observation")
    observation = _observation()
    latency = pipeline.measure(progress)
    progress("memory of the demo")
    demo = footprint.demo(1)
    memory = dict(sorted(demo["memory_mib"].items(), key=lambda one: one[1], reverse=True))
    together = memory.pop("total")
    figures = {
        "observation_ms": {**observation, "together": sum(observation.values())},
        "latency_ms": {
            "tracker: image to pose": latency["pose_p50_ms"],
            "waiting for the next state of the pusher": latency["pusher_p50_ms"],
            "estimator: the way of the pose, the observation, the estimate": latency["rest_p50_ms"],
            "together, median": latency["p50_ms"],
            "together, 99 of 100 within": latency["p99_ms"],
        },
        "memory_mib": {**memory, "together": together, "a bare rclpy node": demo["bare_memory_mib"]},
    }
    _write(ROOT / "docs/estimation.md", "observation", ("for one observation", "ms of CPU"), figures["observation_ms"], ".2f")
    _write(ROOT / "docs/graph.md", "latency", ("from the image to the estimate", "ms"), figures["latency_ms"], ".1f")
    _write(ROOT / "docs/graph.md", "memory", ("process", "MiB"), figures["memory_mib"], ".0f")
    return figures


def _observation() -> Figures:
    """Median CPU time of each part of the work for one observation [ms]."""
    observations = load(footprint.DEMO_BAG)
    support_points = load_object(OBJECT).support_points
    spent: list[list[float]] = []
    for _ in range(ROUNDS):
        estimator = Estimator(support_points)
        for one in observations:
            estimate, program = _timed(estimator.add, one)
            verdict, judged = _timed(verdict_on, estimate, estimator.judgement)
            bounds, bounded = _timed(BoundsReport.of, estimate)
            msg, message = _timed(_message, estimate, verdict, bounds)
            spent.append([program, judged, bounded, message, _timed(serialize_message, msg)[1]])
    return dict(zip(PARTS, (1e3 * np.median(spent, axis=0)).tolist(), strict=True))


def _message(estimate: Estimate, verdict: Verdict, bounds: BoundsReport) -> FrictionEstimate:
    return estimate_to_msg(EstimateReport.of(estimate, OBJECT, None, verdict=verdict, bounds=bounds))


def _timed(work: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
    """What it returns, and the CPU time that it takes [s]."""
    begin = time.process_time()
    found = work(*arguments)
    return found, time.process_time() - begin


def _write(document: pathlib.Path, name: str, head: tuple[str, str], figures: Mapping[str, float], form: str) -> None:
    """Put a table in the place of the one between the document's marks of this name."""
    rows = [(part, format(figure, form)) for part, figure in figures.items()]
    begin, end = f"<!-- bench --costs: {name} -->\n", f"<!-- end of {name} -->\n"
    write_whole(document, replaced(document.read_text(encoding="utf-8"), begin, end, table(head, rows)))
