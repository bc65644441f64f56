"""Figures of a run and of a limit surface, in the style of the paper's."""

import itertools
import math
import pathlib
import textwrap
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pushfric_core.errors import InvalidInput
from pushfric_core.estimation.estimate import Estimate
from pushfric_core.estimation.estimate_report import BIN_WIDTH, BINS, histogram
from pushfric_core.estimation.picture import (
    AREA,
    ESTIMATE,
    GREY,
    INK,
    MILLIMETRE,
    STYLE,
    closed,
    draw_support_friction,
    legend,
)
from pushfric_core.files.whole_file import make_folder
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, Wrench, transform
from pushfric_core.geometry.table_1 import TableObject
from pushfric_core.mechanics.limit_surface import LimitSurface
from pushfric_core.mechanics.prediction import ELLIPSE
from pushfric_core.trajectories.observation import Observation

TRUTH, SLIPPING, OTHER, REACHED = "#d55e00", "#cc79a7", "#009e73", "#56b4e9"
"""The meaning of each colour, with those of the picture. OTHER marks what the estimate is compared with, REACHED what pushes
reach. The colours are those of Okabe and Ito (Color Universal Design, 2008), which colour-blind readers tell apart."""

BELIEFS = 15
"""At most about so many times within a run, the figure shows how far p_CF may be off: it takes longer than an observation."""

MERIDIANS = 8
"""Number of sections through the moment axis that show the limit surface in space."""

SCALE_BAR = 50
"""Length of the bar that gives the scale [mm]."""

PANELS = 12
"""Largest number of objects whose centres are drawn in one figure."""


def with_belief(estimates: Sequence[Estimate]) -> list[int]:
    """Which of the estimates after each observation the figure and the page of a run show with their beliefs: the last, and at
    most about BELIEFS others, each after the last observation of a push."""
    ends = [k for k, (one, next_) in enumerate(itertools.pairwise(estimates)) if next_.pushes > one.pushes]
    return [*ends[:: math.ceil(len(ends) / BELIEFS) or 1], len(estimates) - 1]


def check_image_name(path: pathlib.Path) -> None:
    """Check a figure's name, before the work of which it shall show the result.

    Raises:
        InvalidInput: no image is known by the end of this name.
    """
    known = FigureCanvasBase.get_supported_filetypes()
    if path.suffix[1:] not in known:
        raise InvalidInput(
            f"{path}: not the name of an image; expected one that ends with {', '.join(f'.{name}' for name in known)}"
        )


def summary_figure(
    path: pathlib.Path,
    outline: Outline,
    estimates: Sequence[Estimate],
    data: Sequence[Observation],
    truth: TableObject | None,
    slipping: Collection[int] = (),
    doubts: Sequence[str] = (),
) -> None:
    """Four panels: trajectories with contacts (Figure 3), w (Figure 5), mu_c (Figure 8), error of p_CF (Figure 11).

    Args:
        path: where to write the image; its suffix selects the format.
        outline: of the object.
        estimates: the estimates after each observation, at least one; w and mu_c are drawn from the last.
        data: the observations of the last estimate.
        truth: the simulated object; None if it is not known: then the last panel shows p_CF itself instead of its error.
        slipping: ids of the pushes whose contact is known to slip; the figure marks their lower bounds on mu_c.
        doubts: about the data, in words; they stand above the panels.
    Raises:
        InvalidInput: the image cannot be written.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 8.4), layout="constrained")
        figure.suptitle("\n".join(line for doubt in doubts for line in textwrap.wrap(doubt, 120)), fontsize="medium")
        trajectories, friction, contact, errors = figure.subplots(2, 2, height_ratios=(1, 1)).ravel()
        _draw_trajectories(trajectories, outline, data)
        _draw_support_friction(friction, outline, estimates[-1], truth)
        _draw_contact_friction(contact, estimates[-1], [one.push_id in slipping for one in data], truth)
        _draw_center_of_friction(errors, outline, estimates, truth)
        save(figure, path)


def limit_surface_figure(
    path: pathlib.Path, surface: LimitSurface, contact_points: npt.ArrayLike, contact_normals: npt.ArrayLike, mu_c: float
) -> None:
    """Two panels: the surface with the part that pushes reach (Figure 12, in space), and a section with both ellipsoids.

    Args:
        path: where to write the image; its suffix selects the format.
        surface: the limit surface of an object.
        contact_points: (k, 2) where it can be pushed, object frame [m].
        contact_normals: (k, 2) unit, outward.
        mu_c: contact friction coefficient.
    Raises:
        ValueError: as for `LimitSurface.reachable`.
        SolverFailed: the motion of a push was not found.
        InvalidInput: the image cannot be written.
    """
    scale = np.array((1.0, 1.0, MILLIMETRE))
    reached = surface.reachable(contact_points, contact_normals, mu_c).wrenches * scale
    moment = Wrench(0.0, 0.0, 1.0)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10, 4.4), layout="constrained")
        space = figure.add_subplot(1, 2, 1, projection="3d")
        for angle in np.arange(MERIDIANS) * np.pi / MERIDIANS:
            force = Wrench(float(np.cos(angle)), float(np.sin(angle)), 0.0)
            section = surface.cross_section(force, moment).points @ (force, moment) * scale
            space.plot(*closed(section).T, color=GREY, lw=0.6)
        for wrenches in reached:
            (line,) = space.plot(*wrenches.T, color=REACHED, lw=3, marker="o" if len(wrenches) == 1 else None, ms=3)
        line.set_label("what pushes reach")
        space.set_box_aspect(None, zoom=1.1)
        space.set(title="Limit surface, units as on the right", xlabel="$f_x$", ylabel="$f_y$", zlabel="$m$")
        space.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1))
        section = figure.add_subplot(1, 2, 2)
        force = Wrench(0.0, 1.0, 0.0)
        section.plot(*closed(surface.cross_section(force, moment).points * scale[1:]).T, color=INK, lw=1.4, label="exact")
        angles = np.linspace(0, 2 * np.pi, 361)
        for name, ellipsoid, style in (("axes", surface.ellipsoid(), "--"), ("fitted", surface.fitted_ellipsoid(), ":")):
            form = ellipsoid.form[1:, 1:]
            # the inverse of a square root of the form takes the circle to the ellipse
            ellipse = np.column_stack((np.cos(angles), np.sin(angles))) @ np.linalg.inv(np.linalg.cholesky(form))
            section.plot(*(ellipse * scale[1:]).T, ls=style, color=OTHER, lw=1.4, label=f"ellipsoid, {name}")
        section.set(title="Section $f_x = 0$", xlabel="$f_y$ [support friction]", ylabel="$m$ [support friction $\\times$ mm]")
        section.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=3)
        save(figure, path)


class Centers(NamedTuple):
    """The estimates of an object's p_CF from several inputs."""

    name: str  # of the object
    points: Array  # (k, 2) object frame [m]
    labels: Sequence[str]  # k: of those that differ from the others; empty for the rest


def centers_figure(path: pathlib.Path, objects: Sequence[Centers]) -> None:
    """A panel for each object: p_CF of each input, and the names of those that differ.

    Args:
        path: where to write the image; its suffix selects the format.
        objects: at least one; the first PANELS are drawn.
    Raises:
        InvalidInput: the image cannot be written.
    """
    shown = objects[:PANELS]
    columns = min(len(shown), 3)
    rows = -(-len(shown) // columns)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.2 * columns, 3.8 * rows), layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, (name, points, labels) in zip(panels, shown, strict=False):
            differs = np.array([bool(label) for label in labels])
            axes.plot(*(MILLIMETRE * points[~differs].T), "o", ms=4, mfc="none", color=ESTIMATE, label="p_CF")
            axes.plot(*(MILLIMETRE * points[differs].T), "x", ms=6, color=TRUTH, label="differs from the others")
            for (x, y), label in zip(MILLIMETRE * points, labels, strict=True):
                axes.annotate(label, (x, y), (4, 4), textcoords="offset points", fontsize=7, color=INK)
            axes.set(title=f"{name}: {len(points)}", xlabel="x [mm]", ylabel="y [mm]")
            axes.set_aspect("equal", "datalim")
            axes.margins(0.15)
        for axes in panels[len(shown) :]:
            axes.axis("off")
        if any(label for one in shown for label in one.labels):
            figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
        save(figure, path)


def table_error_figure(path: pathlib.Path, places: Array, errors: Array) -> None:
    """A map of the errors that the camera's calibration makes in places on the table.

    Args:
        path: where to write the image; its suffix selects the format.
        places: (rows, columns, 2) in the table frame [m].
        errors: (rows, columns), 1 sigma [m].
    Raises:
        InvalidInput: the image cannot be written.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 4.6), layout="constrained")
        axes = figure.subplots()
        x, y = MILLIMETRE * places[..., 0], MILLIMETRE * places[..., 1]
        map_ = axes.contourf(x, y, MILLIMETRE * errors, levels=8, cmap="viridis")
        axes.plot(0, 0, "+", color="white", ms=10)
        axes.annotate("origin", (0, 0), (4, 4), textcoords="offset points", color="white")
        axes.set(title="Error of a place on the table, 1 sigma", xlabel="x [mm]", ylabel="y [mm]")
        axes.set_aspect("equal")
        figure.colorbar(map_, label="mm")
        save(figure, path)


def save(figure: Figure, path: pathlib.Path, dpi: int = 130) -> None:
    """Write a figure; the suffix of the path selects the format.

    Raises:
        InvalidInput: the image cannot be written, or has no such format.
    """
    check_image_name(path)
    make_folder(path.parent)
    try:
        figure.savefig(path, dpi=dpi)
    except OSError as error:
        raise InvalidInput(f"{path}: cannot be written: {error.strerror or error}") from error


def _draw_trajectories(axes: Any, outline: Outline, data: Sequence[Observation]) -> None:
    """Two pushes: the outline and the contact at each observation, or all contacts on the outline if the poses are unknown."""
    pushes = sorted({o.push_id for o in data if o.pose is not None})
    shown = [pushes[index] for index in sorted({len(pushes) // 5, len(pushes) - 1 - len(pushes) // 5})] if pushes else []
    shift = 0.0
    for push in shown:
        course = [o for o in data if o.push_id == push and o.pose is not None]
        left = min(transform(o.pose, outline.vertices)[:, 0].min() for o in course if o.pose)
        right = max(transform(o.pose, outline.vertices)[:, 0].max() for o in course if o.pose)
        for age, o in enumerate(course):
            assert o.pose is not None
            corners = transform(o.pose, closed(outline.vertices)) + (shift - left, 0)
            axes.plot(*(corners.T * MILLIMETRE), color=GREY, lw=1, alpha=0.3 + 0.7 * (age + 1) / len(course))
            contact = transform(o.pose, o.contact_point) + (shift - left, 0)
            axes.plot(*(contact * MILLIMETRE), "o", color=INK, ms=3.5)
        shift += right - left + 0.02
    title = f"Pushes {' and '.join(str(p + 1) for p in shown)}: object and contact at each observation"
    if not shown:
        axes.plot(*(closed(outline.vertices).T * MILLIMETRE), color=INK, lw=1)
        axes.plot(*(np.array([o.contact_point for o in data]).T * MILLIMETRE), "o", color=ESTIMATE, ms=3.5, alpha=0.6)
        title = "Object and contact of each observation"
    axes.set_title(title)
    axes.set_aspect("equal", "datalim")
    axes.axis("off")  # the pushes stand side by side: no place of theirs means anything, only their size does
    left, low = axes.dataLim.min - (0, SCALE_BAR / 4)
    axes.plot((left, left + SCALE_BAR), (low, low), color=INK, lw=2)
    axes.annotate(f"{SCALE_BAR} mm", (left, low), (0, 4), textcoords="offset points")


def _draw_support_friction(axes: Any, outline: Outline, estimate: Estimate, truth: TableObject | None) -> None:
    """The estimated w and p_CF, and the true ones if they are known."""
    draw_support_friction(axes, estimate, estimate.belief, outline)
    if truth is not None and len(truth.support.points) <= 10:
        axes.scatter(
            *(truth.support.points * MILLIMETRE).T,
            s=AREA * truth.support.weights,
            facecolors="none",
            edgecolors=TRUTH,
            lw=1.2,
            label="true $w$",
        )
    if truth is not None:
        axes.plot(*(truth.support.center_of_friction * MILLIMETRE), "o", mfc="none", color=TRUTH, ms=7, label="true $p_{CF}$")
    legend(axes)


def _draw_contact_friction(axes: Any, estimate: Estimate, slipping: Sequence[bool], truth: TableObject | None) -> None:
    """Histogram of the lower bounds on mu_c, with slipping contacts marked; the last bin also holds infinite bounds."""
    bounds, slips = estimate.contact_friction, np.asarray(slipping)
    end = (BINS - 1) * BIN_WIDTH
    left = np.arange(BINS) * BIN_WIDTH
    axes.bar(left, histogram(bounds), BIN_WIDTH, align="edge", color=ESTIMATE, alpha=0.8, edgecolor="white", lw=0.5)
    if slips.any():
        axes.bar(
            left, histogram(bounds[slips]), BIN_WIDTH, align="edge", color=SLIPPING, edgecolor="white", lw=0.5, label="slipping"
        )
    marks = [
        ("90 %", estimate.mu_c_p90, {"color": INK, "ls": "--", "lw": 1}),
        ("100 %", estimate.mu_c_max, {"color": INK, "lw": 1}),
    ]
    marks += [("true", truth.mu_c, {"color": TRUTH, "lw": 1.2})] if truth is not None else []
    for name, value, style in marks:
        axes.axvline(min(value, end + BIN_WIDTH / 2), label=f"{name}: {value:.2f}", **style)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    last = max(1.0, *(min(value, end) + BIN_WIDTH for _, value, _ in marks))
    axes.set(title="Lower bounds on $\\mu_c$", xlabel="$\\mu_c$", ylabel="observations", xlim=(0, last))
    if last > end:
        axes.set_xticks(
            [*np.arange(0, end, 0.5), end + BIN_WIDTH / 2], [*(f"{tick:g}" for tick in np.arange(0, end, 0.5)), f">{end:g}"]
        )
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=4, columnspacing=1.2, handlelength=1.0)


def _draw_center_of_friction(axes: Any, outline: Outline, estimates: Sequence[Estimate], truth: TableObject | None) -> None:
    """p_CF against the number of observations: its error in percent of the sides; if the truth is unknown, its coordinates."""
    counts = [estimate.data_points for estimate in estimates]
    centers: Array = np.array([estimate.center_of_friction for estimate in estimates])
    half: Array = np.full((len(estimates), 2), np.nan)
    for end in with_belief(estimates):
        half[end] = _half_extents(estimates[end])
    known = truth is not None
    unit = 100 / outline.size if known else np.full(2, MILLIMETRE)
    for k, (label, style) in enumerate((("x", "-"), ("y", "--"))):
        course = np.abs(centers[:, k] - truth.support.center_of_friction[k]) if truth is not None else centers[:, k]
        axes.plot(counts, unit[k] * course, style, color=ESTIMATE, label=label)
        told = np.isfinite(half[:, k])
        if known:
            axes.plot(np.array(counts)[told], unit[k] * half[told, k], style, color=GREY, lw=1, label=f"{label}, belief, 90 %")
        else:
            low, high = (unit[k] * (centers[told, k] + sign * half[told, k]) for sign in (-1, 1))
            axes.fill_between(np.array(counts)[told], low, high, color=ESTIMATE, alpha=0.15, lw=0)
    if known:
        # linear below a hundredth of a percent: an error may be zero
        axes.set_yscale("symlog", linthresh=0.01)
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set(
            title="Error of the program's $p_{CF}$, and the belief's bound",
            xlabel="observations",
            ylabel="% of the side",
            ylim=(0, None),
        )
    else:
        axes.set(title="Centre of friction, with 90 % intervals", xlabel="observations", ylabel="mm")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axes.legend(ncols=2)


def _half_extents(estimate: Estimate) -> Array:
    """Half the sizes of the 90 % ellipse of p_CF along x and y (2,) [m]; NaN if they are unknown."""
    if estimate.belief is None or estimate.belief.covariance is None:
        return np.full(2, np.nan)
    return np.asarray(np.sqrt(ELLIPSE * np.diag(estimate.belief.covariance)))
