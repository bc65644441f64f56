"""The paper's figures from the simulated experiments: one seed where they show data, all seeds where they show errors."""

import io
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from pushfric_core.estimation import picture
from pushfric_core.estimation.picture import ESTIMATE, GREY, INK, closed
from pushfric_core.geometry.planar import Array, Pose, transform
from pushfric_core.geometry.table_1 import ORIENTATIONS, TABLE_1
from pushfric_core.paper.experiments import GRIDS, HALF_WIDTHS, SUBSETS
from pushfric_core.report.figures import OTHER, REACHED, TRUTH

PAPER = "#e69f00"  # the paper's numbers; also of Okabe and Ito

CENTIMETRE = 100.0

DOT = 900
"""Area of the dot that shows a weight of 1 [points^2]."""

STYLE = picture.STYLE | {
    "font.family": "sans-serif",
    "axes.titlesize": 9.5,
    "svg.fonttype": "path",
    "svg.hashsalt": "pushfric",
}

FORMATS: dict[str, dict[str, Any]] = {"svg": {"transparent": True, "metadata": {"Date": None}}, "png": {"dpi": 300}}

Experiments = Mapping[str, Any]


def figures(tables: Experiments, seeds: Sequence[Experiments], rods: Experiments) -> dict[str, bytes]:
    """Every figure as the contents of image files.

    Args:
        tables: the numbers over all seeds, as `tables.tables` gives them.
        seeds: the result of each, as `experiments.run_seed` gives it; the figures show the data of the first.
        rods: the drawings of Figure 12, from `experiments.rods`.
    Returns:
        The contents by the name of the file: table2, figure3, figure5 ... figure13 and test_pushes, each .svg and .png.
    """
    seed = seeds[0]
    makers: dict[str, Callable[[], Figure]] = {
        "table2": lambda: _grids(tables["table2"], seeds),
        "figure3": lambda: _trajectories(seed["data"]["rubber_rect4"]),
        "figure5": lambda: _support_friction(seed["drawings"]["figure5"]),
        "figure6": lambda: _feet_off_the_grid(seed["drawings"]["figure6"]),
        "figure7": lambda: _histograms(
            seed["drawings"]["bounds"],
            {"wood_rect4_all_data": "(a) wood_rect4, all data", "wood_rect4": "(b) without the bad push"},
            tables["table3"],
        ),
        "figure8": lambda: _histograms(
            seed["drawings"]["bounds"],
            {
                "rubber_rect4": "(a) rubber_rect4, original data",
                "rubber_rect4_slipping": "(b) test pushes with slipping contact",
            },
            tables["table3"],
        ),
        "figure9": lambda: _orientations("wood_rect3", tables["figure9"]),
        "figure10": lambda: _orientations("delrin_square3", tables["figure10"]),
        "figure11": lambda: _subsets(tables["figure11"]),
        "figure12": lambda: _rods(rods),
        "figure13": lambda: _least_squares(seed["drawings"]["figure13"]),
        "test_pushes": lambda: _test_pushes(seed["drawings"]["test_pushes"]),
    }
    drawn = {}
    with mpl.rc_context(STYLE):
        for name, make in makers.items():
            figure = make()
            for form, options in FORMATS.items():
                content = io.BytesIO()
                figure.savefig(content, format=form, **options)
                drawn[f"{name}.{form}"] = content.getvalue()
    return drawn


def _new(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height), layout="constrained")


def _outline(axes: Any, corners: Array, **style: Any) -> None:
    axes.plot(*closed(corners).T, **({"color": INK, "lw": 1} | style))


def _grids(numbers: Experiments, seeds: Sequence[Experiments]) -> Figure:
    """The support grids of Figure 4, and the p_CF estimated on them."""
    figure = _new(9.0, 3.8)
    panels = figure.subplots(len(numbers), len(GRIDS), sharex=True, sharey=True)
    for row, name in zip(panels, numbers, strict=True):
        known = TABLE_1[name]
        for axes, (size, grid) in zip(row, GRIDS.items(), strict=True):
            _outline(axes, known.outline.vertices * CENTIMETRE)
            axes.plot(*(known.outline.grid(*grid) * CENTIMETRE).T, ".", color=GREY, ms=4, label="support points")
            centers = [seed["numbers"]["table2"][name][f"grid_{size}"] for seed in seeds]
            axes.plot(
                [c["x"] for c in centers], [c["y"] for c in centers], ".", color=ESTIMATE, ms=5, alpha=0.5, label="each seed"
            )
            paper = numbers[name][f"grid_{size}"]
            axes.plot(paper["x"]["paper"], paper["y"]["paper"], "D", color=PAPER, ms=5, label="the paper")
            axes.plot(*(known.support.center_of_friction * CENTIMETRE), "o", mfc="none", color=TRUTH, ms=8, label="truth")
            axes.set(aspect="equal", title=f"{size} points")
        row[0].set_ylabel(f"{name}\ny [cm]")
    for axes in panels[-1]:
        axes.set_xlabel("x [cm]")
    figure.legend(*panels[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def _trajectories(rows: list[list[float]]) -> Figure:
    """Two pushes of rubber_rect4, side by side."""
    figure = _new(9.0, 3.2)
    vertices = TABLE_1["rubber_rect4"].outline.vertices
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, push, title in zip(panels, (5, 1), ("right of the middle", "left of the middle"), strict=True):
        course = [row for row in rows if row[7] == push]
        for age, row in enumerate(course):
            pose = Pose(*row[8:11])
            strength = 0.25 + 0.75 * (age + 1) / len(course)
            _outline(axes, transform(pose, vertices) * CENTIMETRE, color=GREY, alpha=strength)
            axes.plot(*(transform(pose, np.array(row[:2])) * CENTIMETRE), "o", color=INK, ms=4, alpha=strength)
        axes.axvline(0, color=GREY, lw=0.8, ls=":", zorder=0)
        axes.set(title=f"Pushed {title}", xlabel="x [cm]", aspect="equal")
    panels[0].set_ylabel("y [cm]")
    return figure


def _dots(axes: Any, points: Array, w: Array, **style: Any) -> None:
    """w as dots of proportional area, hollow where it is negative, with an x where it is zero."""
    zero = np.abs(w) < 1e-6
    axes.plot(*points[zero].T, "x", color=GREY, ms=5)
    inside = [mpl.colors.to_rgba(ESTIMATE, 0.85 if one > 0 else 0.0) for one in w[~zero]]
    style = {"s": DOT * np.abs(w[~zero]), "lw": 1.2} | style
    axes.scatter(*points[~zero].T, facecolors=inside, edgecolors=ESTIMATE, **style)
    axes.set(aspect="equal", xlabel="x [cm]")


def _on_object(axes: Any, name: str, points: Array, w: Array, title: str, **style: Any) -> None:
    _outline(axes, TABLE_1[name].outline.vertices * CENTIMETRE)
    _dots(axes, points * CENTIMETRE, w, **style)
    center = (w / w.sum()) @ points * CENTIMETRE
    axes.plot(*center, "+", color=INK, ms=10)
    x, y = (f"{value + 0.0:.2f}".replace("-", "\N{MINUS SIGN}") for value in np.round(center, 2).tolist())
    axes.set(title=f"{title}: $p_{{CF}}$ ({x}, {y})")


def _explain(figure: Figure, **more: Any) -> None:
    """A legend of the marks on an object."""
    marks = {
        "$w_j$, by area": Line2D([], [], color=ESTIMATE, marker="o", ls="", ms=9, mew=0),
        **more,
        "$w_j = 0$": Line2D([], [], color=GREY, marker="x", ls="", ms=5),
        "$p_{CF}$": Line2D([], [], color=INK, marker="+", ls="", ms=10),
    }
    figure.legend(list(marks.values()), list(marks), loc="outside lower center", ncols=len(marks))


def _support_friction(weights: Mapping[str, list[float]]) -> Figure:
    figure = _new(9.0, 3.1)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, (name, w) in zip(panels, weights.items(), strict=True):
        _on_object(axes, name, TABLE_1[name].support_points, np.array(w), name)
    panels[0].set_ylabel("y [cm]")
    _explain(figure)
    return figure


def _feet_off_the_grid(w: list[float]) -> Figure:
    figure = _new(9.0, 4.2)
    known = TABLE_1["delrin_square3"]
    actual, estimated = figure.subplots(1, 2, sharex=True, sharey=True)
    _on_object(actual, "delrin_square3", known.support.points, known.support.weights, "Actual")
    _on_object(estimated, "delrin_square3", known.support_points, np.array(w), "Estimated")
    estimated.scatter(
        *(known.support.points * CENTIMETRE).T, s=DOT * known.support.weights, facecolors="none", edgecolors=TRUTH, lw=1.2
    )
    actual.set_ylabel("y [cm]")
    _explain(figure, **{"feet": Line2D([], [], color=TRUTH, marker="o", mfc="none", ls="", ms=9)})
    return figure


def _histograms(bounds: Mapping[str, list[float]], shown: Mapping[str, str], numbers: Experiments) -> Figure:
    """Histograms of lower bounds on mu_c, with the simulated mu_c and the paper's largest bound."""
    figure = _new(9.0, 3.1)
    finite = [value for case in shown for value in bounds[case] if np.isfinite(value)]
    edges = np.arange(0, max(finite) + 0.1, 0.05)
    for axes, (case, title) in zip(figure.subplots(1, 2, sharex=True), shown.items(), strict=True):
        shown_bounds = [value for value in bounds[case] if np.isfinite(value)]
        axes.hist(shown_bounds, bins=edges, color=ESTIMATE, alpha=0.85, edgecolor="white", lw=0.5)
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        largest = numbers[case]["high" if "high" in numbers[case] else "p100"]["paper"]
        truth = TABLE_1[case.removesuffix("_all_data").removesuffix("_slipping")].mu_c
        axes.axvline(truth, color=TRUTH, lw=1.2, label=f"simulated $\\mu_c$: {truth:.1f}")
        axes.axvline(largest, color=PAPER, lw=1.2, ls="--", label=f"largest bound of the paper: {largest:.2f}")
        axes.set(title=title, xlabel="lower bound on $\\mu_c$", ylabel="data points")
        axes.legend(loc="upper left", bbox_to_anchor=(0, -0.25), fontsize=8, ncols=2)
    return figure


def _orientations(name: str, numbers: Experiments) -> Figure:
    figure = _new(9.0, 3.1)
    titles = {"supports": "(a) Hypothesised supports only", "supports_and_center": "(b) With the centre of friction"}
    looks = ((TRUTH, "-", "o"), (OTHER, "--", "s"), (OTHER, ":", "^"), (OTHER, "-.", "v"))
    for axes, (case, title) in zip(figure.subplots(1, 2, sharey=True), titles.items(), strict=True):
        for turn, (color, line, marker) in zip(ORIENTATIONS[name], looks, strict=False):
            leaves = [numbers[case][f"half_width_{half_width}_mm"][f"error_{turn}"] for half_width in HALF_WIDTHS]
            low, high = zip(*(leaf["quartiles"] for leaf in leaves), strict=True)
            label = f"turned by {turn}°" if turn else "true orientation"
            medians = [leaf["median"] for leaf in leaves]
            axes.plot(HALF_WIDTHS, medians, ls=line, marker=marker, ms=4, color=color, label=label)
            axes.fill_between(HALF_WIDTHS, low, high, color=color, alpha=0.15, lw=0)
        axes.set(title=title, xlabel="half-width of the contact interval [mm]", xticks=HALF_WIDTHS, ylim=(0, None))
    figure.axes[0].set_ylabel("fit error [cm]")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(ORIENTATIONS[name]))
    return figure


def _subsets(numbers: Experiments) -> Figure:
    figure = _new(9.0, 3.0)
    errors, found = figure.subplots(1, 2)
    for axis, line, marker in (("x", "-", "o"), ("y", "--", "s")):
        leaves = [numbers[f"points_{size}"][f"percent_{axis}"] for size in SUBSETS]
        low, high = zip(*(leaf["quartiles"] for leaf in leaves), strict=True)
        medians = [leaf["median"] for leaf in leaves]
        errors.plot(SUBSETS, medians, ls=line, marker=marker, ms=4, color=ESTIMATE, label=axis)
        errors.fill_between(SUBSETS, low, high, color=ESTIMATE, alpha=0.15, lw=0)
        known = {size: leaf["reference"] for size, leaf in zip(SUBSETS, leaves, strict=True) if "reference" in leaf}
        style = {"ls": "", "marker": marker, "mfc": "none", "ms": 7}
        errors.plot(list(known), list(known.values()), color=OTHER, label=f"{axis}, reference", **style)
    errors.set(title="Mean error of $p_{CF}$, 10 samplings", xlabel="data points", ylabel="% of the side", ylim=(0, None))
    errors.legend(fontsize=8)
    share = [100 * numbers[f"points_{size}"]["share_with_correct_supports"]["median"] for size in SUBSETS]
    found.plot(SUBSETS, share, "o-", ms=4, color=INK)
    found.set(title="The four feet have the largest weights", xlabel="data points", ylabel="% of samplings", ylim=(0, 105))
    return figure


def _rods(rods: Experiments) -> Figure:
    figure = _new(9.0, 3.8)
    titles = {"two_supports": "1/2 at each end", "three_supports": "1/3 at the ends and the middle"}
    for axes, (name, title) in zip(figure.subplots(1, 2, sharex=True, sharey=True), titles.items(), strict=True):
        section = np.array(rods[name]["section"])
        reachable = np.array(rods[name]["reachable"])
        _outline(axes, section, color=GREY, lw=1.2, label="limit surface")
        axes.plot(*reachable.T, color=REACHED, lw=3, solid_capstyle="butt", label="what pushes without friction reach")
        axes.set(title=title, xlabel="$f_y$ [support friction]", aspect="equal")
    figure.axes[0].set_ylabel("$m$ [support friction by half length]")
    handles = dict(zip(*reversed(figure.axes[0].get_legend_handles_labels()), strict=True))
    figure.legend(handles.values(), handles, loc="outside lower center", ncols=2)
    return figure


def _least_squares(weights: Mapping[str, list[float]]) -> Figure:
    figure = _new(9.0, 6.0)
    titles = {
        "feet": "Least squares, actual supports",
        "grid_15": "Least squares, 15 points",
        "grid_15_nonnegative": "Least squares with $w \\geq 0$",
        "grid_15_linear_program": "Linear program",
    }
    known = TABLE_1["wood_rect4"]
    for axes, (case, title) in zip(figure.subplots(2, 2).ravel(), titles.items(), strict=True):
        w = np.array(weights[case])
        points = known.support.points if case == "feet" else known.support_points
        # the dots of weights many times the whole friction would cover the object
        scale = min(1.0, 1 / np.abs(w).max())
        _on_object(axes, "wood_rect4", points, w, title, s=DOT * scale * np.abs(w[np.abs(w) >= 1e-6]))
        # rounded to zero, a tiny weight has no sign
        low, high = (f"{value + 0.0:.2f}".replace("-", "\N{MINUS SIGN}") for value in np.round((w.min(), w.max()), 2).tolist())
        axes.set_xlabel(f"x [cm]        weights from {low} to {high}")
    for axes in figure.axes[::2]:
        axes.set_ylabel("y [cm]")
    _explain(figure, **{"$w_j < 0$": Line2D([], [], color=ESTIMATE, marker="o", mfc="none", ls="", ms=9)})
    return figure


def _test_pushes(drawing: Experiments) -> Figure:
    figure = _new(9.0, 3.6)
    axes = figure.subplots()
    known = TABLE_1["delrin_rect_right"]
    _outline(axes, known.outline.vertices * CENTIMETRE)
    regions = drawing["regions"]
    for age, region in enumerate(regions):
        if region:
            axes.fill(*(np.array(region) * CENTIMETRE).T, color=ESTIMATE, alpha=0.04 + 0.2 * (age + 1) / len(regions), lw=0)
    axes.plot(*(np.array(drawing["center"]) * CENTIMETRE), "+", color=INK, ms=10, label="centroid of the region")
    truth = known.support.center_of_friction * CENTIMETRE
    axes.plot(*truth, "o", mfc="none", color=TRUTH, ms=7, label="true $p_{CF}$")
    axes.set(aspect="equal", xlabel="x [cm]", ylabel="y [cm]", title="Where $p_{CF}$ can lie: the darker, the more pushes")
    axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5))
    return figure
