"""The paper's tables and figures as numbers: medians and quartiles over the seeds, next to what the paper prints.

The keys are those of tables.json; docs/paper.md explains them.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

Nested = dict[str, Any]


def _grid_errors(rows: dict[int, tuple[float, float, float]], ratios: dict[int, tuple[float, float, float]]) -> Nested:
    names = ("left", "center", "right")
    return {
        f"grid_{size}": {
            **{f"error_{name}": value for name, value in zip(names, rows[size], strict=True)},
            **{f"ratio_{name}": value for name, value in zip(names, ratios[size], strict=True)},
            "correct": True,
        }
        for size in rows
    }


def _center(x: float, y: float, percent_x: float, percent_y: float) -> Nested:
    return {"x": x, "y": y, **_percent(percent_x, percent_y)}


def _percent(x: float, y: float) -> Nested:
    return {"percent_x": x, "percent_y": y}


_RIGHT_FOR_ALL = {
    case: {f"half_width_{half_width}_mm": {"correct": True} for half_width in (0, 2, 4, 6, 8)}
    for case in ("supports", "supports_and_center")
}

PAPER: Nested = {
    "table1": {
        name: {"data_points": count}
        for name, count in {
            "delrin_square3": 85,
            "wood_rect3": 68,
            "wood_rect4": 70,
            "rubber_rect4": 80,
            "delrin_rect_center": 36,
            "delrin_rect_right": 32,
        }.items()
    },
    "table2": {
        "delrin_rect_center": {
            "grid_4": _center(0.41, 1.60, 4.8, 31.5),
            "grid_9": _center(0.10, -0.28, 1.2, 5.5),
            "grid_15": _center(-0.08, -0.13, 0.9, 2.6),
            "grid_24": _center(-0.15, -0.20, 1.7, 3.9),
        },
        "delrin_rect_right": {
            "grid_4": _center(2.13, 0.89, 17.3, 17.5),
            "grid_9": _center(0.79, -0.48, 1.1, 9.4),
            "grid_15": _center(0.71, -0.41, 0.1, 8.1),
            "grid_24": _center(0.74, -0.33, 0.5, 6.5),
        },
    },
    "table3": {
        "delrin_rect_center": {"p90": 0.21, "p100": 0.34},
        "delrin_rect_right": {"p90": 0.24, "p100": 0.36},
        "wood_rect3": {"p90": 0.28, "p100": 0.41},
        "wood_rect4_all_data": {"p90": 0.32, "p100": 1.41, "bad_data_points": 6},
        "wood_rect4": {"p90": 0.30, "p100": 0.47},
        "rubber_rect4": {"p90": 0.52, "p100": 0.80},
        "rubber_rect4_slipping": {"low": 0.75, "high": 1.13, "data_points": 21},
    },
    "table4": _grid_errors(
        {4: (104.14, 101.45, 105.54), 9: (19.58, 9.86, 19.74), 15: (17.73, 6.78, 18.85), 24: (15.29, 4.60, 15.29)},
        {4: (1.03, 1.00, 1.04), 9: (1.99, 1.00, 2.00), 15: (2.61, 1.00, 2.78), 24: (3.32, 1.00, 3.32)},
    ),
    "table5": _grid_errors(
        {4: (95.78, 91.21, 90.75), 9: (30.56, 20.35, 13.46), 15: (29.62, 18.44, 10.08), 24: (31.42, 16.54, 6.22)},
        {4: (1.06, 1.01, 1.00), 9: (2.27, 1.51, 1.00), 15: (2.94, 1.83, 1.00), 24: (5.05, 2.66, 1.00)},
    ),
    "figure5": {
        "wood_rect4": {"corners_are_top_four": True, "nonzero_weights": 5},
        "rubber_rect4": {"corners_are_top_four": True, "nonzero_weights": 4},
    },
    "figure9": _RIGHT_FOR_ALL,
    "figure10": _RIGHT_FOR_ALL,
    "figure12": {"largest_difference_of_reachable_wrenches": 0.0},
    "figure13": {
        "feet": _center(0.25, -0.10, 2.0, 1.6),
        "grid_15": {"w_min": -25.3, "w_max": 38.2, **_center(0.69, -1.80, 5.4, 28.3)},
    },
}
"""The paper's numbers, in its own units: cm, percent, and the support friction of the translating object."""

REFERENCE: Nested = {
    "table2": {
        name: {f"grid_{size}": {"percent_y": y} for size, y in zip((4, 9, 15, 24), errors, strict=True)}
        for name, errors in {
            "delrin_rect_center": (6.1, 0.7, 0.95, 0.74),
            "delrin_rect_right": (5.4, 0.6, 0.45, 0.6),
        }.items()
    },
    "table3": {
        "delrin_rect_center": {"p90": 0.26, "p100": 0.35},
        "delrin_rect_right": {"p90": 0.29, "p100": 0.38},
        "wood_rect4_all_data": {"p100": 1.12},
        "wood_rect4": {"p90": 0.28, "p100": 0.44},
        "rubber_rect4": {"p90": 0.43, "p100": 0.86},
    },
    "table4": {
        f"grid_{size}": {"error_center": error, "ratio_left": ratio, "ratio_right": ratio}
        for size, error, ratio in ((9, 8.2, 2.0), (15, 5.7, 2.5), (24, 4.5, 2.9))
    },
    "table5": {"grid_24": {"ratio_left": 4.5, "ratio_center": 2.3}},
    "figure6": {"weight_within_1_cm": 0.85},
    "figure11": {"points_10": _percent(0.8, 3.1), "points_20": _percent(0.4, 1.5), "points_60": _percent(0.1, 0.6)},
    "figure13": {"feet": _percent(0.1, 0.6), "grid_15": {"w_min": -1.9, "w_max": 1.6}},
}
"""Medians of another, independently written simulation of the paper's cell, with the same noise; some numbers are missing."""


class MedianRange(NamedTuple):
    """A number over the seeds; infinite if no w satisfied the hard constraints."""

    median: float
    low: float  # quartile
    high: float  # quartile


class Count(NamedTuple):
    """How often something held."""

    held: int
    of: int


def tables(seeds: Sequence[Mapping[str, Any]]) -> Nested:
    """The numbers of all seeds in one table: each leaf has the figures of this run, of the paper and of the reference.

    Args:
        seeds: the `numbers` of each seed, all with the same keys.
    Returns:
        A dictionary nested like `numbers`. A leaf is {median, quartiles: [low, high], seeds} or {held, of}. It also has
        `paper` and `reference` if these give the number; `seeds` is the number of seeds.
    """
    return _merge(seeds, PAPER, REFERENCE)


def markdown(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    """A table as lines of Markdown."""
    head, *lines = (f"| {' | '.join(map(str, row))} |" for row in (heads, *rows))
    return [head, "|" + "---|" * len(heads), *lines]


def spread(values: Sequence[float]) -> MedianRange:
    """Median and quartiles, as order statistics: infinite values do not spoil them."""
    ranked = np.sort(np.asarray(values, dtype=float))
    low, median, high = (_between(ranked, share * (len(ranked) - 1)) for share in (0.25, 0.5, 0.75))
    return MedianRange(median, low, high)


def _between(ranked: np.ndarray, position: float) -> float:
    below, above = float(ranked[math.floor(position)]), float(ranked[math.ceil(position)])
    return below if below == above else below + (above - below) * (position - math.floor(position))


def _merge(values: Sequence[Any], paper: Any, reference: Any) -> Nested:
    first = values[0]
    if isinstance(first, Mapping):
        return {key: _merge([value[key] for value in values], _part(paper, key), _part(reference, key)) for key in first}
    leaf: Nested
    if isinstance(first, bool):
        leaf = Count(sum(values), len(values))._asdict()
    else:
        median, low, high = spread(values)
        leaf = {"median": median, "quartiles": [low, high], "seeds": len(values)}
    return leaf | {name: known for name, known in (("paper", paper), ("reference", reference)) if known is not None}


def _part(known: Any, key: str) -> Any:
    return known.get(key) if isinstance(known, Mapping) else None
