"""The cost of a data point in the estimator node when there are already many: time and memory, for up to a million.

One estimator takes one data point after the other, as the node does: the data point, the verdict, and the serialised message.
This leaves out the middleware, and the region of p_CF, a polygon whose cost does not depend on the number of lines that cut it.
"""

import itertools
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message

from bench.data_points import observations, support_points
from bench.processes import memory
from pushfric_core import Estimator, Observation
from pushfric_core.estimation.estimate_report import EstimateReport, FrictionReport
from pushfric_core.uncertainty.spread import is_due
from pushfric_ros.messages.conversions import estimate_to_msg

SUPPORTS = 15

MARKS = (1000, 10_000, 100_000, 1_000_000)
"""Numbers of data points at which the cost of one is given; it is measured over the last tenth before."""

STEPS = len(MARKS)

PER_PUSH = 12
"""Number of data points of a push."""

Figures = dict[str, Any]


def measure(progress: Callable[[str], None], marks: tuple[int, ...] = MARKS) -> list[Figures]:
    """Rows {M, median_ms, mean_ms, p99_ms, longest_ms, at_rest_ms, bytes}: CPU time of a data point, and memory per data point.

    `at_rest_ms` is the time for what is done when no other data point follows at once: spread and mu_c from all data points.
    """
    estimator = Estimator(support_points(SUPPORTS))
    friction: FrictionReport | None = None
    rows, seconds = [], []
    before = memory(os.getpid(), "Rss")
    for count, observation in enumerate(_pushes(marks[-1]), 1):
        start = time.process_time()
        estimate = estimator.add(observation)
        verdict = estimator.verdict(estimate)
        if friction is None or is_due(estimate.data_points, friction.data_points):
            friction = FrictionReport.of(estimate)
        serialize_message(estimate_to_msg(EstimateReport.of(estimate, "box", verdict=verdict, friction=friction)))
        seconds.append(time.process_time() - start)
        if count in marks:
            newest = np.array(seconds[-count // 10 :]) * 1e3
            start = time.process_time()
            FrictionReport.of(estimator.estimate())
            rows.append(
                {
                    "M": count,
                    "median_ms": float(np.median(newest)),
                    "mean_ms": float(np.mean(newest)),
                    "p99_ms": float(np.percentile(newest, 99)),
                    "longest_ms": float(newest.max()),
                    "at_rest_ms": (time.process_time() - start) * 1e3,
                    "bytes": 1024 * (memory(os.getpid(), "Rss") - before) / count,
                }
            )
            progress(f"{count} data points")
    return rows


def _pushes(count: int) -> Iterator[Observation]:
    """Data points of simulated pushes."""
    found = observations(np.random.default_rng(0))
    for number, observation in enumerate(itertools.islice(found, count)):
        yield replace(observation, push_id=number // PER_PUSH, stamp=number + 1)
