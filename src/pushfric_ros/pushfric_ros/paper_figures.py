"""The paper's figures from the simulated experiments: of one seed where they show data, of all where they show errors."""

import io
from collections.abc import Callable, Mapping
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from pushfric_core.planar import Array, Pose, transform
from pushfric_core.simulation import TABLE_1
from pushfric_ros.figures import BLUE, GREY, INK, RED
from pushfric_ros.paper_experiments import HALF_WIDTHS, SUBSETS, TURNS

GREEN, OCHRE = "#2f7d4f", "#b8860b"

CENTIMETRE = 100.0

DOT = 900
"""Area of the dot of a weight of 1 [points^2]."""

STYLE = {
    "font.size": 9,
    "font.family": "sans-serif",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "svg.fonttype": "path",
    "svg.hashsalt": "pushfric",
}

Experiments = Mapping[str, Any]


def figures(tables: Experiments, seed: Experiments, rods: Experiments) -> dict[str, str]:
    """Every figure as an SVG element.

    Args:
        tables: the numbers over all seeds, see paper_tables.
        seed: the result of the seed whose data are shown.
        rods: the drawings of Figure 12.
    Returns:
        By the keys figure3, figure5 ... figure13 and test_pushes.
    """
    makers: dict[str, Callable[[], Figure]] = {
        "figure3": lambda: _trajectories(seed["data"]["rubber_rect4"]),
        "figure5": lambda: _support_friction(seed["drawings"]["figure5"]),
        "figure6": lambda: _feet_off_the_grid(seed["drawings"]["figure6"]),
        "figure7": lambda: _histograms(
            seed["drawings"]["bounds"],
            {"wood_rect4_all_data": "(a) wood_rect4, all data", "wood_rect4": "(b) without the bad push"},
        ),
        "figure8": lambda: _histograms(
            seed["drawings"]["bounds"],
            {
                "rubber_rect4": "(a) rubber_rect4, original data",
                "rubber_rect4_slipping": "(b) test pushes with slipping contact",
            },
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
            text = io.StringIO()
            make().savefig(text, format="svg", transparent=True, metadata={"Date": None})
            svg = text.getvalue()
            drawn[name] = svg[svg.index("<svg") :]
    return drawn


def _new(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height), layout="constrained")


def _outline(axes: Any, corners: Array, **style: Any) -> None:
    axes.plot(*np.vstack((corners, corners[:1])).T, **({"color": INK, "lw": 1} | style))


def _trajectories(rows: list[list[float]]) -> Figure:
    """Two pushes of rubber_rect4, side by side."""
    figure = _new(7.2, 2.9)
    vertices = TABLE_1["rubber_rect4"].outline.vertices
    for axes, push, title in zip(figure.subplots(1, 2), (5, 1), ("right of the middle", "left of the middle"), strict=True):
        course = [row for row in rows if row[7] == push]
        for age, row in enumerate(course):
            pose = Pose(*row[8:11])
            strength = 0.25 + 0.75 * (age + 1) / len(course)
            _outline(axes, transform(pose, vertices) * CENTIMETRE, color=BLUE, alpha=strength)
            axes.plot(*(transform(pose, np.array(row[:2])) * CENTIMETRE), "o", color=RED, ms=4, alpha=strength)
        axes.set(title=f"Pushed {title}", xlabel="cm", aspect="equal")
    return figure


def _dots(axes: Any, points: Array, w: Array, **style: Any) -> None:
    """w as dots of proportional area, an x where it is zero."""
    zero = np.abs(w) < 1e-6
    axes.plot(*points[zero].T, "x", color=GREY, ms=5)
    colors = np.where(w[~zero] > 0, BLUE, RED)
    axes.scatter(*points[~zero].T, **({"s": DOT * np.abs(w[~zero]), "c": colors, "alpha": 0.85, "lw": 0} | style))
    axes.set(aspect="equal", xlabel="cm")


def _on_object(axes: Any, name: str, points: Array, w: Array, title: str, **style: Any) -> None:
    _outline(axes, TABLE_1[name].outline.vertices * CENTIMETRE)
    _dots(axes, points * CENTIMETRE, w, **style)
    center = (w / w.sum()) @ points * CENTIMETRE
    axes.plot(*center, "+", color=INK, ms=10)
    axes.set(title=f"{title}: $p_{{CF}}$ ({center[0]:.2f}, {center[1]:.2f})")


def _support_friction(weights: Mapping[str, list[float]]) -> Figure:
    figure = _new(7.2, 2.5)
    for axes, (name, w) in zip(figure.subplots(1, 2), weights.items(), strict=True):
        _on_object(axes, name, TABLE_1[name].support_points, np.array(w), name)
    return figure


def _feet_off_the_grid(w: list[float]) -> Figure:
    figure = _new(7.2, 3.3)
    known = TABLE_1["delrin_square3"]
    actual, estimated = figure.subplots(1, 2, sharex=True, sharey=True)
    _on_object(actual, "delrin_square3", known.support.points, known.support.weights, "Actual")
    _on_object(estimated, "delrin_square3", known.support_points, np.array(w), "Estimated")
    estimated.scatter(
        *(known.support.points * CENTIMETRE).T, s=DOT * known.support.weights, facecolors="none", edgecolors=RED, lw=1.2
    )
    return figure


def _histograms(bounds: Mapping[str, list[float]], shown: Mapping[str, str]) -> Figure:
    figure = _new(7.2, 2.4)
    finite = [value for case in shown for value in bounds[case] if np.isfinite(value)]
    edges = np.arange(0, max(finite) + 0.1, 0.05)
    for axes, (case, title) in zip(figure.subplots(1, 2, sharex=True), shown.items(), strict=True):
        axes.hist([value for value in bounds[case] if np.isfinite(value)], bins=edges, color=BLUE, alpha=0.85)
        truth = TABLE_1[case.removesuffix("_all_data").removesuffix("_slipping")].mu_c
        axes.axvline(truth, color=RED, lw=1.2)
        axes.text(truth, axes.get_ylim()[1], " true $\\mu_c$", color=RED, va="top")
        axes.set(title=title, xlabel="lower bound on $\\mu_c$", ylabel="data points")
    return figure


def _orientations(name: str, numbers: Experiments) -> Figure:
    figure = _new(7.2, 2.7)
    titles = {"supports": "(a) Hypothesised supports only", "supports_and_center": "(b) With the centre of friction"}
    for axes, (case, title) in zip(figure.subplots(1, 2, sharey=True), titles.items(), strict=True):
        for turn, color in zip(TURNS[name], (BLUE, RED, OCHRE, GREEN), strict=False):
            leaves = [numbers[case][f"half_width_{half_width}_mm"][f"error_{turn}"] for half_width in HALF_WIDTHS]
            low, high = zip(*(leaf["quartiles"] for leaf in leaves), strict=True)
            label = f"turned by {turn}°" if turn else "true orientation"
            axes.plot(HALF_WIDTHS, [leaf["median"] for leaf in leaves], "o-", ms=4, color=color, label=label)
            axes.fill_between(HALF_WIDTHS, low, high, color=color, alpha=0.15, lw=0)
        axes.set(title=title, xlabel="half-width of the contact interval [mm]", xticks=HALF_WIDTHS, ylim=(0, None))
    figure.axes[0].set_ylabel("fit error [cm]")
    figure.axes[1].legend(fontsize=8)
    return figure


def _subsets(numbers: Experiments) -> Figure:
    figure = _new(7.2, 2.7)
    errors, found = figure.subplots(1, 2)
    for axis, color in (("x", BLUE), ("y", RED)):
        leaves = [numbers[f"points_{size}"][f"percent_{axis}"] for size in SUBSETS]
        low, high = zip(*(leaf["quartiles"] for leaf in leaves), strict=True)
        errors.plot(SUBSETS, [leaf["median"] for leaf in leaves], "o-", ms=4, color=color, label=axis)
        errors.fill_between(SUBSETS, low, high, color=color, alpha=0.15, lw=0)
    errors.set(title="Mean error of $p_{CF}$, 10 samplings", xlabel="data points", ylabel="% of the side", ylim=(0, None))
    errors.legend()
    share = [100 * numbers[f"points_{size}"]["share_with_correct_supports"]["median"] for size in SUBSETS]
    found.plot(SUBSETS, share, "o-", ms=4, color=INK)
    found.set(title="The four feet have the largest weights", xlabel="data points", ylabel="% of samplings", ylim=(0, 105))
    return figure


def _rods(rods: Experiments) -> Figure:
    figure = _new(7.2, 3.0)
    titles = {"two_supports": "1/2 at each end", "three_supports": "1/3 at the ends and the middle"}
    for axes, (name, title) in zip(figure.subplots(1, 2, sharex=True, sharey=True), titles.items(), strict=True):
        section = np.array(rods[name]["section"])
        reachable = np.array(rods[name]["reachable"])
        _outline(axes, section, color=GREY, lw=1.2)
        axes.plot(*reachable.T, color=BLUE, lw=3, solid_capstyle="butt")
        axes.set(title=title, xlabel="$f_y$", aspect="equal")
    figure.axes[0].set_ylabel("$m$")
    return figure


def _least_squares(weights: Mapping[str, list[float]]) -> Figure:
    figure = _new(7.2, 4.8)
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
        # weights of many times the whole friction would cover the object
        scale = min(1.0, 1 / np.abs(w).max())
        _on_object(axes, "wood_rect4", points, w, title, s=DOT * scale * np.abs(w[np.abs(w) >= 1e-6]), alpha=0.7)
        axes.set_xlabel(f"cm;  w in [{w.min():.2f}, {w.max():.2f}]")
    return figure


def _test_pushes(drawing: Experiments) -> Figure:
    figure = _new(7.2, 3.0)
    axes = figure.subplots()
    known = TABLE_1["delrin_rect_right"]
    _outline(axes, known.outline.vertices * CENTIMETRE)
    regions = drawing["regions"]
    for age, region in enumerate(regions):
        if region:
            axes.fill(*(np.array(region) * CENTIMETRE).T, color=BLUE, alpha=0.04 + 0.2 * (age + 1) / len(regions), lw=0)
    axes.plot(*(np.array(drawing["center"]) * CENTIMETRE), "+", color=INK, ms=10, label="centroid of the region")
    truth = known.support.center_of_friction * CENTIMETRE
    axes.plot(*truth, "o", mfc="none", color=RED, ms=7, label="true $p_{CF}$")
    axes.set(aspect="equal", xlabel="cm", title="Where $p_{CF}$ can lie, after each push")
    axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5))
    return figure
