"""The summary of many estimates: a Markdown page of outliers, unusable estimates and broken inputs."""

import pathlib
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np

from pushfric_core.offline.many import Line, objections
from pushfric_core.offline.outliers import FEWEST, differing
from pushfric_core.offline.table import believed_center
from pushfric_core.report.figures import Centers, centers_figure

PAGE, FIGURE = "report.md", "centers.svg"
"""Names in the folder of the results."""


def mark_outliers(lines: Sequence[Line]) -> list[Line]:
    """The lines; if an estimate differs from the others of its object, its line gets the key `differs` with the reasons."""
    marked = {line["input"]: dict(line) for line in lines}
    for group in by_object(lines).values():
        points = [believed_center(line) for line in group]
        errors = [line["objective"] / max(line["data_points"], 1) for line in group]
        for line, reasons in zip(group, differing(points, errors, [_mu_c(line) for line in group]), strict=True):
            if reasons:
                marked[line["input"]]["differs"] = reasons
    return list(marked.values())


def _mu_c(line: Line) -> float | None:
    """The belief's mu_c; None if it is only bounded."""
    known: float | None = line["belief"].get("mu_c", {}).get("value")
    return known


def by_object(lines: Sequence[Line]) -> dict[str, list[Line]]:
    """The estimates that may be used, by the name of their object."""
    groups = defaultdict(list)
    for line in lines:
        if "belief" in line and not objections(line):
            groups[line["object"]].append(line)
    return dict(sorted(groups.items()))


def counts(lines: Sequence[Line]) -> dict[str, int]:
    """How many inputs there are, and what became of them."""
    use = Counter(None if "error" in line else not objections(line) for line in lines)
    states = {"usable": use[True], "not_usable": use[False], "broken": use[None]}
    outliers = sum("differs" in line for line in lines)
    return {"inputs": len(lines), "outliers": outliers} | states


def write_summary(lines: Sequence[Line], folder: pathlib.Path) -> pathlib.Path:
    """Write the page and its figure; return the path of the page.

    Args:
        lines: as `mark_outliers` returns them.
        folder: where to write them.
    """
    number = counts(lines)
    groups = by_object(lines)
    text = [
        "# Estimates of many inputs",
        "",
        f"{number['inputs']} inputs: {number['usable']} gave an estimate that may be used, {number['not_usable']} gave one"
        f" that may not, and {number['broken']} gave none. {number['outliers']} differ from the others of their object.",
        "",
    ]
    if groups:
        centers = [_centers(name, group) for name, group in groups.items()]
        centers_figure(folder / FIGURE, centers)
        text += [
            "| object | estimates | p_CF x [mm] | p_CF y [mm] | half lie within [mm] | mu_c | outliers |",
            "|---|---|---|---|---|---|---|",
            *(_row(name, group) for name, group in groups.items()),
            "",
            "p_CF and mu_c are medians; that of mu_c is over the estimates that give a value and not only a bound.",
            "",
            f"![The centres of friction of each object]({FIGURE})",
            "",
        ]
    text += _list("Outliers", [(line, "; ".join(line["differs"])) for line in lines if "differs" in line])
    if any(len(group) < FEWEST for group in groups.values()):
        text += [f"An object needs at least {FEWEST} estimates before outliers are looked for.", ""]
    doubtful = [line for line in lines if "belief" in line and objections(line)]
    reasons = (" ".join(one["text"] for one in objections(line)) for line in doubtful)
    text += _list("Not to be used", list(zip(doubtful, reasons, strict=True)))
    text += _list("Broken inputs", [(line, line["error"]) for line in lines if "error" in line])
    text += _list("Warnings", [(line, warning) for line in lines for warning in line["warnings"]])
    page = folder / PAGE
    page.write_text("\n".join(text), encoding="utf-8")
    return page


def _centers(name: str, group: Sequence[Line]) -> Centers:
    return Centers(
        name,
        np.array([believed_center(line) for line in group]),
        [pathlib.Path(line["input"]).name if "differs" in line else "" for line in group],
    )


def _row(name: str, group: Sequence[Line]) -> str:
    points = 1e3 * np.array([believed_center(line) for line in group])
    x, y = middle = np.median(points, axis=0)
    within = np.median(np.linalg.norm(points - middle, axis=1))
    values = [value for line in group if (value := _mu_c(line)) is not None]
    mu_c = f"{np.median(values):.3f}" if values else "-"
    outliers = sum("differs" in line for line in group)
    return f"| {name} | {len(group)} | {x:.2f} | {y:.2f} | {within:.2f} | {mu_c} | {outliers} |"


def _list(title: str, entries: Sequence[tuple[Line, Any]]) -> list[str]:
    """A section with a line for each input; empty if there is nothing to list."""
    return [f"## {title}", "", *(f"- `{line['input']}`: {what}" for line, what in entries), ""] if entries else []
