"""Accuracy on real pushes: the error of p_CF for each log, support and rule, and how it falls with the number of pushes."""

import pathlib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from rich.table import Table

from bench.display import pivot_table
from bench.public import zhou2015
from pushfric_core import Estimator, EstimatorConfig, Observation, Outline
from pushfric_core.geometry.planar import Array

OUTLINE = Outline(np.array(zhou2015.CORNERS))
TRUTH = np.array((0.05, 0.05))
"""p_CF of all objects of the data set, from statics [m]."""

GRIDS = {"grid_55": OUTLINE.grid(10, 10, 0.0075), "grid_10x10": OUTLINE.grid(10, 10), "grid_8x8": OUTLINE.grid(8, 8)}
TRUE = "true"

RULES = {
    "paper": EstimatorConfig(cor_radius=0.0, screening=False),
    "default": EstimatorConfig(),
    "force_angle": EstimatorConfig(terms=("moment", "force_angle"), screening=False),
    "force": EstimatorConfig(terms=("moment", "force"), screening=False),
}
"""The paper's rows, the defaults, and the defaults with each of the two terms of a measured force."""

PUSHES = (5, 10, 20, 40)
SUBSETS = 20
"""Number of random choices of pushes from each log."""

STEPS = len(RULES) * (1 + len(GRIDS))


def measure(source: pathlib.Path, progress: Callable[[str], None]) -> dict[str, Any]:
    """Errors of p_CF over all logs of the data set `zhou2015`.

    Args:
        source: its push_points.csv.
        progress: called with a description of the next step, STEPS times.
    Returns:
        {"logs": [{"log", "support", "rule", "error_m"}], "curve": [{"support", "rule", "pushes", "median_m", "p90_m"}]}.
    Raises:
        InvalidInput: the file cannot be read.
    """
    logs = zhou2015.read_push_points(source)
    by_log, curve = [], []
    for support in (TRUE, *GRIDS):
        for rule, config in RULES.items():
            progress(f"real pushes: {support}, {rule}")
            pooled: dict[int, list[float]] = {count: [] for count in PUSHES}
            for index, (log, pushes) in enumerate(logs.items()):
                points = support_points(log, support)
                if points is None:
                    continue
                by_log.append({"log": log, "support": support, "rule": rule, "error_m": _error(pushes, points, config)})
                for count in (count for count in PUSHES if count < len(pushes)):
                    rng = np.random.default_rng([index, count])
                    chosen = [rng.permutation(len(pushes))[:count] for _ in range(SUBSETS)]
                    pooled[count] += [_error([pushes[k] for k in subset], points, config) for subset in chosen]
            curve += [
                {
                    "support": support,
                    "rule": rule,
                    "pushes": count,
                    "median_m": float(np.median(errors)),
                    "p90_m": float(np.percentile(errors, 90)),
                }
                for count, errors in pooled.items()
            ]
    return {"logs": by_log, "curve": curve}


def tables(figures: dict[str, Any]) -> Iterator[Table]:
    """Errors over the logs, and how they fall with the number of pushes."""
    logs = ({**row, "log": row["log"].split("__exp")[0], "error_m": 1e3 * row["error_m"]} for row in figures["logs"])
    yield pivot_table("Error of p_CF [mm]", logs, "log", "error_m", median=np.median, worst=max)
    curve = (
        {"support": row["support"], "rule": row["rule"], "": name, "pushes": row["pushes"], "error": 1e3 * row[f"{name}_m"]}
        for row in figures["curve"]
        for name in ("median", "p90")
    )
    yield pivot_table("Error of p_CF [mm], by number of random pushes", curve, "pushes", "error")


def support_points(log: str, support: str) -> Array | None:
    """The support points of an object (n, 2) [m]: a grid, or the true ones; None if these are unknown (the flat object)."""
    if support != TRUE:
        return GRIDS[support]
    digits = [int(part) for part in log.split("__")[0].split("_") if part.isdigit()]
    return np.reshape(digits, (2, 3)).T * 1e-3 if len(digits) == 6 else None


def _error(pushes: list[Observation], points: Array, config: EstimatorConfig) -> float:
    estimator = Estimator(points, config)
    for push in pushes:
        estimate = estimator.add(push)
    return float(np.hypot(*(estimate.center_of_friction - TRUTH)))
