"""Many estimates as one table, which of them differ from the others, and a summary: a Markdown page with all that is wrong."""

import csv
import math
import pathlib
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from pushfric_core.estimation.picture import ESTIMATE, INK, MILLIMETRE, STYLE, TRUTH
from pushfric_core.files.figure_file import save_figure
from pushfric_core.offline.many import Line, objections

TABLE, PAGE, FIGURE = "table.csv", "report.md", "centers.svg"
"""Names in the folder of the results."""

PANELS = 12
"""Largest number of objects whose centres are drawn in one figure."""

COLUMNS = (
    "input", "object", "status", "use", "error", "reasons", "p_cf_x", "p_cf_y", "var_x", "var_y", "cov_xy",
    "mu_c", "mu_c_low", "mu_c_high", "mu_c_kind", "mu_c_p90", "mu_c_max", "total_friction", "objective", "gap",
    "data_points", "pushes", "outlier", "warnings", "model",
)  # fmt: skip
"""Those of the table; SI units, object frame."""


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


def believed_center(line: Line) -> list[float]:
    """The belief's p_CF; that of the program if the pushes do not show how far it is off."""
    known: list[float] = line["belief"].get("center_of_friction", line["center_of_friction"])
    return known


def write_table(lines: Sequence[Line], folder: pathlib.Path) -> pathlib.Path:
    """Write the table of many estimates; return the file."""
    with (folder / TABLE).open("w", newline="", encoding="utf-8") as stream:
        table = csv.DictWriter(stream, COLUMNS)
        table.writeheader()
        table.writerows(map(_table_row, lines))
    return folder / TABLE


def _table_row(line: Line) -> Line:
    row = {name: line[name] for name in COLUMNS if name in line}
    row |= {"outlier": "; ".join(line.get("differs", ())), "warnings": len(line["warnings"])}
    if "belief" in line:
        row["use"], row["reasons"] = not objections(line), " ".join(one["code"] for one in objections(line))
        row["p_cf_x"], row["p_cf_y"] = believed_center(line)
        mu_c, bounds, unknown = line["belief"].get("mu_c", {}), line["mu_c"], (None, None)
        (row["var_x"], row["cov_xy"]), (_, row["var_y"]) = line["belief"].get("covariance", (unknown, unknown))
        row["mu_c"], (row["mu_c_low"], row["mu_c_high"]) = mu_c.get("value"), mu_c.get("interval", unknown)
        row |= {"mu_c_kind": mu_c.get("kind"), "mu_c_p90": bounds["p90"], "mu_c_max": bounds["max"]}
    return row


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
        _draw_centers(folder / FIGURE, groups)
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


def _draw_centers(path: pathlib.Path, objects: dict[str, list[Line]]) -> None:
    """A panel for each of the first PANELS objects: p_CF of each input, and the names of those that differ."""
    shown = list(objects.items())[:PANELS]
    columns = min(len(shown), 3)
    rows = -(-len(shown) // columns)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.2 * columns, 3.8 * rows), layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, (name, lines) in zip(panels, shown, strict=False):
            points = MILLIMETRE * np.array([believed_center(line) for line in lines])
            differs = np.array(["differs" in line for line in lines])
            axes.plot(*points[~differs].T, "o", ms=4, mfc="none", color=ESTIMATE, label="p_CF")
            axes.plot(*points[differs].T, "x", ms=6, color=TRUTH, label="differs from the others")
            for place, line in zip(points, lines, strict=True):
                if "differs" in line:
                    label = pathlib.Path(line["input"]).name
                    axes.annotate(label, place, (4, 4), textcoords="offset points", fontsize=7, color=INK)
            axes.set(title=f"{name}: {len(points)}", xlabel="x [mm]", ylabel="y [mm]")
            axes.set_aspect("equal", "datalim")
            axes.margins(0.15)
        for axes in panels[len(shown) :]:
            axes.axis("off")
        if any("differs" in line for _, lines in shown for line in lines):
            figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
        save_figure(figure, path)


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


FEWEST = 5
"""With fewer estimates of an object, none is called an outlier."""

TOO_FAR = 3.5
"""An estimate differs if its modified z-score is larger (Iglewicz and Hoaglin, How to Detect and Handle Outliers, 1993)."""

TOO_FAR_IN_THE_PLANE = 3.92
"""A normally distributed point in the plane is farther than this many standard deviations from its mean as rarely as a number
is farther than TOO_FAR."""

RESOLUTION = 1e-4
"""Differences of p_CF below this do not matter [m]."""

NORMAL, RAYLEIGH = 0.6745, 1.1774
"""Median absolute deviation of the standard normal distribution, and median distance of such a point in the plane."""


def modified_z(values: npt.ArrayLike, resolution: float) -> npt.NDArray[np.float64]:
    """How far each value lies from their median, in robust standard deviations.

    Args:
        values: (M,) numbers, at least one; NaN for one that is not known.
        resolution: differences smaller than this mean nothing, in the unit of the values.
    Returns:
        (M,) numbers >= 0; 0 for a value that is not known.
    """
    values = np.asarray(values, dtype=float)
    if np.isnan(values).all():
        return np.zeros_like(values)
    distances = np.abs(values - np.nanmedian(values))
    return np.asarray(np.nan_to_num(NORMAL * distances / max(np.nanmedian(distances), resolution)))


def differing(points: npt.ArrayLike, errors: Sequence[float], mu_c: Sequence[float | None]) -> list[list[str]]:
    """Why each of M estimates of one object differs from the others; an empty list for one that does not.

    Args:
        points: (M, 2) centres of friction [m].
        errors: fit error for each observation.
        mu_c: contact friction coefficients; None for one that is only bounded.
    Returns:
        For each estimate a list of reasons in words; all are empty if there are too few estimates.
    """
    points = np.asarray(points, dtype=float)
    reasons: list[list[str]] = [[] for _ in errors]
    if len(reasons) < FEWEST:
        return reasons
    far = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    half = float(np.median(far))
    known = np.array([math.nan if value is None else value for value in mu_c])
    # logarithms, because fit errors scatter by factors
    logs = np.log10(np.maximum(errors, 1e-12))
    for reason, z_error, z_mu, distance, error, mu in zip(
        reasons, modified_z(logs, 0.1), modified_z(known, 0.01), far, errors, known, strict=True
    ):
        if distance > TOO_FAR_IN_THE_PLANE * max(half / RAYLEIGH, RESOLUTION):
            reason.append(
                f"p_CF lies {distance * 1e3:.1f} mm from the middle of all; half of them lie within {half * 1e3:.1f} mm"
            )
        if z_error > TOO_FAR and error > np.median(errors):
            times = error / max(float(np.median(errors)), 1e-12)
            reason.append(f"the fit error of an observation is {times:.1f} times that of the others")
        if z_mu > TOO_FAR:
            reason.append(f"mu_c is {mu:.3f}; the median is {np.nanmedian(known):.3f}")
    return reasons
