"""The paper's tables and figures as numbers: medians and quartiles over the seeds, next to what the paper prints.

The keys are those of tables.json; docs/paper.md explains them.
"""

import math
import pathlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import yaml

from docs.markdown import table

Nested = dict[str, Any]
"""A nested dictionary whose leaves are numbers and truth values, or dictionaries of what is known of a number."""

Path = tuple[str, ...]

PUBLISHED: Nested = yaml.safe_load(pathlib.Path(__file__).with_name("published.yaml").read_text(encoding="utf-8"))
"""The numbers of `paper` and of its `reference`, each nested as the tables are."""


def tables(seeds: Sequence[Any], published: Nested = PUBLISHED) -> Nested:
    """The numbers of all seeds in one table: each leaf has the figures of this run, of the paper and of the reference.

    Args:
        seeds: the `numbers` of each seed, all with the same keys; or the same part of each.
        published: that part of `PUBLISHED`.
    Returns:
        A dictionary nested like `numbers`. A leaf is {median, quartiles: [low, high], seeds} or {held, of}. It also has
        `paper` and `reference` if these give the number; `seeds` is the number of seeds. Numbers are infinite where no w
        satisfied the hard constraints.
    """
    first = seeds[0]
    if isinstance(first, Mapping):
        return {
            key: tables([one[key] for one in seeds], {name: part[key] for name, part in published.items() if key in part})
            for key in first
        }
    if isinstance(first, bool):
        return {"held": sum(seeds), "of": len(seeds), **published}
    median, low, high = spread(seeds)
    return {"median": median, "quartiles": [low, high], "seeds": len(seeds), **published}


def spread(values: Sequence[float]) -> tuple[float, float, float]:
    """Median and quartiles, as order statistics: infinite values do not spoil them."""
    places = np.multiply((0.25, 0.5, 0.75), len(values) - 1)
    low, median, high = np.interp(places, np.arange(len(values)), np.sort(np.asarray(values, dtype=float))).tolist()
    return median, low, high


def leaves(nested: Nested, path: Path = ()) -> Iterator[tuple[Path, Nested]]:
    """All leaves of `tables`, with the keys that lead to them."""
    for key, value in nested.items():
        if isinstance(value, dict):
            found = {"median", "held"} & value.keys()
            yield from [((*path, key), value)] if found else leaves(value, (*path, key))


def table_of(cells: Mapping[str, Mapping[str, Any]], missing: str = "-") -> str:
    """Named numbers as a table in Markdown: a row for each name, a column for each key; and what stands for a missing one."""
    keys = list(dict.fromkeys(key for cell in cells.values() for key in cell))
    rows = ((name, *(_said(cell.get(key, missing)) for key in keys)) for name, cell in cells.items())
    return table(("", *(key.replace("_", " ") for key in keys)), rows)


def _said(value: object) -> str:
    return "-" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)


def number(value: float | None, digits: int = 2) -> str:
    """A number as tables and figures show it, with this many decimal places."""
    if value is None:
        return ""
    # adding zero takes the sign off a zero
    return "\N{INFINITY}" if math.isinf(value) else f"{round(value, digits) + 0.0:.{digits}f}".replace("-", "\N{MINUS SIGN}")
