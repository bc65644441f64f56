"""The paper's figures from the simulated experiments: one seed where they show data, all seeds where they show errors."""

import io
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bench.paper.experiments import CENTIMETRE, GRIDS, HALF_WIDTHS, SUBSETS, Seed, Weights
from bench.paper.tables import PUBLISHED, Nested, number
from pushfric_core import Observation, Region
from pushfric_core.estimation import picture
from pushfric_core.estimation.picture import ESTIMATE, GREY, INK, OTHER, REACHED, TRUTH, closed
from pushfric_core.geometry.planar import Array, transform
from pushfric_core.geometry.table_1 import ORIENTATIONS, TABLE_1

PAPER = "#e69f00"  # the paper's numbers; also of Okabe and Ito

DOT = 900
"""Area of the dot that shows a weight of 1 [points^2]."""

STYLE = picture.STYLE | {"axes.titlesize": 9.5, "svg.hashsalt": "pushfric"}

Panels = Sequence[Any]
"""The axes of a figure."""


def figures(tables: Nested, seeds: Sequence[Seed], rods: Sequence[tuple[Array, Array]]) -> dict[str, bytes]:
    """Every figure as the content of an SVG file.

    Args:
        tables: the numbers over all seeds, as `tables.tables` gives them.
        seeds: the results; the figures show the data of the first.
        rods: of Figure 12, as from `experiments.rods`.
    Returns:
        The contents by the name of the figure: table2, figure3, figure5 ... figure13 and test_pushes.
    """
    seed = seeds[0]
    drawn: dict[str, tuple[tuple[int, int], float, Callable[[Panels], None]]] = {
        "table2": ((2, len(GRIDS)), 3.8, lambda panels: _grids(panels, tables["table2"], seeds)),
        "figure3": ((1, 2), 3.2, lambda panels: _trajectories(panels, seed.data["rubber_rect4"])),
        "figure5": ((1, 2), 3.1, lambda panels: _weights(panels, seed.weights["figure5"])),
        "figure6": ((1, 2), 4.2, lambda panels: _weights(panels, seed.weights["figure6"])),
        "figure7": ((1, 2), 3.1, lambda panels: _histograms(panels, seed, "wood_rect4_all_data", "wood_rect4")),
        "figure8": ((1, 2), 3.1, lambda panels: _histograms(panels, seed, "rubber_rect4", "rubber_rect4_slipping")),
        "figure9": ((1, 2), 3.1, lambda panels: _orientations(panels, ORIENTATIONS["wood_rect3"], tables["figure9"])),
        "figure10": ((1, 2), 3.1, lambda panels: _orientations(panels, ORIENTATIONS["delrin_square3"], tables["figure10"])),
        "figure11": ((1, 2), 3.0, lambda panels: _subsets(panels, tables["figure11"])),
        "figure12": ((1, 2), 3.8, lambda panels: _rods(panels, rods)),
        "figure13": ((2, 2), 6.0, lambda panels: _weights(panels, seed.weights["figure13"])),
        "test_pushes": ((1, 1), 3.6, lambda panels: _regions(panels, seed.regions)),
    }
    images = {}
    with mpl.rc_context(STYLE):
        for name, (grid, height, draw) in drawn.items():
            figure = Figure(figsize=(9.0, height), layout="constrained")
            panels = figure.subplots(*grid, squeeze=False).ravel()
            draw(panels)
            marked = (axes.get_legend_handles_labels() for axes in panels)
            entries = dict(itertools.chain.from_iterable(zip(labels, marks, strict=True) for marks, labels in marked))
            figure.legend(entries.values(), entries, loc="outside lower center", ncols=min(len(entries), 5))
            content = io.BytesIO()
            figure.savefig(content, format="svg", transparent=True, metadata={"Date": None})
            images[name] = content.getvalue()
    return images


def _outline(axes: Any, corners: Array, **style: Any) -> None:
    axes.plot(*closed(corners * CENTIMETRE).T, **({"color": INK, "lw": 1} | style))
    axes.set(aspect="equal", xlabel="x [cm]", ylabel="y [cm]")


def _grids(panels: Panels, numbers: Nested, seeds: Sequence[Seed]) -> None:
    """The support grids of Figure 4, and the p_CF estimated on them."""
    cases = [(name, size, grid) for name in numbers for size, grid in GRIDS.items()]
    for axes, (name, size, grid) in zip(panels, cases, strict=True):
        known, paper = TABLE_1[name], numbers[name][f"grid_{size}"]
        centers = [seed.numbers["table2"][name][f"grid_{size}"] for seed in seeds]
        _outline(axes, known.outline.vertices)
        axes.plot(*(known.outline.grid(*grid) * CENTIMETRE).T, ".", color=GREY, ms=4, label="support points")
        each = [[center[axis] for center in centers] for axis in ("x", "y")]
        axes.plot(*each, ".", color=ESTIMATE, ms=5, alpha=0.5, label="each seed")
        axes.plot(paper["x"]["paper"], paper["y"]["paper"], "D", color=PAPER, ms=5, label="the paper")
        _truth(axes, name)
        axes.set(title=f"{size} points", ylabel=f"{name}\ny [cm]" if size == min(GRIDS) else "")


def _truth(axes: Any, name: str) -> None:
    center = TABLE_1[name].support.center_of_friction * CENTIMETRE
    axes.plot(*center, "o", mfc="none", color=TRUTH, ms=8, label="true $p_{CF}$")


def _trajectories(panels: Panels, observations: Sequence[Observation]) -> None:
    """Two pushes of rubber_rect4, as the camera saw them."""
    vertices = TABLE_1["rubber_rect4"].outline.vertices
    for axes, push, side in zip(panels, (5, 1), ("right", "left"), strict=True):
        course = [(one.pose, one.contact_point) for one in observations if one.push_id == push and one.pose is not None]
        for age, (pose, contact) in enumerate(course):
            strength = 0.25 + 0.75 * (age + 1) / len(course)
            _outline(axes, transform(pose, vertices), color=GREY, alpha=strength)
            axes.plot(*(transform(pose, contact) * CENTIMETRE), "o", color=INK, ms=4, alpha=strength, label="contact")
        axes.axvline(0, color=GREY, lw=0.8, ls=":", zorder=0, label="the pusher's line")
        axes.set(title=f"Pushed {side} of the middle")


def _weights(panels: Panels, shown: Sequence[Weights]) -> None:
    """w as dots of proportional area, hollow where it is negative, with an x where it is zero."""
    for axes, (name, title, points, w) in zip(panels, shown, strict=True):
        support = TABLE_1[name].support
        _outline(axes, TABLE_1[name].outline.vertices)
        zero = np.abs(w) < 1e-6
        # the dots of weights many times the whole friction would cover the object
        sizes = DOT * np.abs(w[~zero]) * min(1.0, 1 / np.abs(w).max())
        inside = [mpl.colors.to_rgba(ESTIMATE, 0.85 if one > 0 else 0.0) for one in w[~zero]]
        axes.scatter(*(points[~zero] * CENTIMETRE).T, sizes, facecolors=inside, edgecolors=ESTIMATE, lw=1.2)
        axes.scatter(*(support.points * CENTIMETRE).T, DOT * support.weights, facecolors="none", edgecolors=TRUTH, lw=1.2)
        axes.plot([], [], "o", color=ESTIMATE, label="$w_j$, by area")
        if (w < -1e-6).any():
            axes.plot([], [], "o", mfc="none", color=ESTIMATE, label="$w_j < 0$")
        axes.plot([], [], "o", mfc="none", color=TRUTH, label="feet")
        axes.plot(*(points[zero] * CENTIMETRE).T, "x", color=GREY, ms=5, label="$w_j = 0$")
        x, y = (w / w.sum()) @ points * CENTIMETRE
        axes.plot(x, y, "+", color=INK, ms=10, label="$p_{CF}$")
        axes.set(title=f"{title}: $p_{{CF}}$ ({number(x)}, {number(y)})")
        axes.set_xlabel(f"x [cm]        weights from {number(w.min())} to {number(w.max())}")


def _histograms(panels: Panels, seed: Seed, *cases: str) -> None:
    """Histograms of lower bounds on mu_c, with the simulated mu_c and the paper's largest bound."""
    shown = [seed.bounds[case][np.isfinite(seed.bounds[case])] for case in cases]
    edges = np.arange(0, np.concatenate(shown).max() + 0.1, 0.05)
    for axes, case, values in zip(panels, cases, shown, strict=True):
        axes.hist(values, bins=edges, color=ESTIMATE, alpha=0.85, edgecolor="white", lw=0.5)
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        published = PUBLISHED["paper"]["table3"][case]
        largest = published.get("p100", published.get("high"))
        truth = TABLE_1[case.removesuffix("_all_data").removesuffix("_slipping")].mu_c
        axes.axvline(truth, color=TRUTH, lw=1.2, label=f"simulated $\\mu_c$: {truth:.1f}")
        axes.axvline(largest, color=PAPER, lw=1.2, ls="--", label="largest bound of the paper")
        axes.set(
            title=f"{case}; paper: up to {largest:.2f}",
            xlabel="lower bound on $\\mu_c$",
            ylabel="observations",
            xlim=(0, edges[-1]),
        )


def _course(axes: Any, places: Sequence[float], leaves: Sequence[Nested], **style: Any) -> None:
    """Medians as a line, with a band between their quartiles."""
    low, high = zip(*(leaf["quartiles"] for leaf in leaves), strict=True)
    axes.plot(places, [leaf["median"] for leaf in leaves], ms=4, **style)
    axes.fill_between(places, low, high, color=style["color"], alpha=0.15, lw=0)


def _orientations(panels: Panels, turns: Sequence[int], numbers: Nested) -> None:
    titles = {"supports": "(a) Hypothesised supports only", "supports_and_center": "(b) With the centre of friction"}
    looks = ((TRUTH, "-", "o"), (OTHER, "--", "s"), (OTHER, ":", "^"), (OTHER, "-.", "v"))
    for axes, (case, title) in zip(panels, titles.items(), strict=True):
        for turn, (color, line, marker) in zip(turns, looks, strict=False):
            leaves = [numbers[case][f"half_width_{half_width}_mm"][f"error_{turn}"] for half_width in HALF_WIDTHS]
            label = f"turned by {turn}°" if turn else "true orientation"
            _course(axes, HALF_WIDTHS, leaves, color=color, ls=line, marker=marker, label=label)
        axes.set(title=title, xlabel="half-width of the contact interval [mm]", xticks=HALF_WIDTHS, ylim=(0, None))
        axes.set_ylabel("fit error [cm]")


def _subsets(panels: Panels, numbers: Nested) -> None:
    errors, found = panels
    for axis, line, marker in (("x", "-", "o"), ("y", "--", "s")):
        leaves = [numbers[f"points_{size}"][f"percent_{axis}"] for size in SUBSETS]
        known = {size: leaf["reference"] for size, leaf in zip(SUBSETS, leaves, strict=True) if "reference" in leaf}
        _course(errors, SUBSETS, leaves, color=ESTIMATE, ls=line, marker=marker, label=f"error in {axis}")
        errors.plot(*zip(*known.items(), strict=True), marker, mfc="none", ms=7, color=OTHER, label=f"{axis}, reference")
    errors.set(title="Mean error of $p_{CF}$, 10 samplings", xlabel="observations", ylabel="% of the side", ylim=(0, None))
    share = [100 * numbers[f"points_{size}"]["share_with_correct_supports"]["median"] for size in SUBSETS]
    found.plot(SUBSETS, share, "o-", ms=4, color=INK)
    found.set(title="The four feet have the largest weights", xlabel="observations", ylabel="% of samplings", ylim=(0, 105))


def _rods(panels: Panels, rods: Sequence[tuple[Array, Array]]) -> None:
    titles = ("1/2 at each end", "1/3 at the ends and the middle")
    for axes, (section, reachable), title in zip(panels, rods, titles, strict=True):
        axes.plot(*closed(section).T, color=GREY, lw=1.2, label="limit surface")
        axes.plot(*reachable.T, color=REACHED, lw=3, solid_capstyle="butt", label="what pushes without friction reach")
        axes.set(title=title, xlabel="$f_y$ [support friction]", aspect="equal")
        axes.set_ylabel("$m$ [support friction by half length]")


def _regions(panels: Panels, regions: Sequence[Region]) -> None:
    (axes,) = panels
    _outline(axes, TABLE_1["delrin_rect_right"].outline.vertices)
    for age, region in enumerate(regions):
        corners = np.asarray(region.polygon.exterior.coords) * CENTIMETRE
        if len(corners):
            axes.fill(*corners.T, color=ESTIMATE, alpha=0.04 + 0.2 * (age + 1) / len(regions), lw=0)
    axes.plot(*(regions[-1].center * CENTIMETRE), "+", color=INK, ms=10, label="centroid of the region")
    _truth(axes, "delrin_rect_right")
    axes.set(title="Where $p_{CF}$ can lie: the darker, the more pushes")
