"""The figure of a run, in the style of the paper's."""

import itertools
import math
import textwrap
from collections.abc import Collection, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import MaxNLocator

from pushfric_core.estimation.estimate import Estimate
from pushfric_core.estimation.estimate_report import BIN_WIDTH, BINS, histogram
from pushfric_core.estimation.picture import (
    AREA,
    ESTIMATE,
    GREY,
    INK,
    MILLIMETRE,
    SLIPPING,
    STYLE,
    TRUTH,
    closed,
    draw_support_friction,
    legend,
)
from pushfric_core.estimation.push_plan import number_of
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, transform
from pushfric_core.geometry.table_1 import TableObject
from pushfric_core.mechanics.prediction import ELLIPSE
from pushfric_core.trajectories.observation import Observation

BELIEFS = 15
"""At most about so many times within a run, the figure shows how far p_CF may be off: it takes longer than an observation."""

SCALE_BAR = 50
"""Length of the bar that gives the scale [mm]."""


def with_belief(estimates: Sequence[Estimate]) -> list[int]:
    """Which of the estimates after each observation the figure and the page of a run show with their beliefs: the last, and at
    most about BELIEFS others, each after the last observation of a push."""
    ends = [k for k, (one, next_) in enumerate(itertools.pairwise(estimates)) if next_.pushes > one.pushes]
    return [*ends[:: math.ceil(len(ends) / BELIEFS) or 1], len(estimates) - 1]


def run_figure(
    outline: Outline,
    estimates: Sequence[Estimate],
    data: Sequence[Observation],
    truth: TableObject | None,
    slipping: Collection[int] = (),
    doubts: Sequence[str] = (),
    planned: int | None = None,
) -> Figure:
    """Four panels: trajectories with contacts (Figure 3), w (Figure 5), mu_c (Figure 8), error of p_CF (Figure 11).

    Args:
        outline: of the object.
        estimates: the estimates after each observation, at least one; w and mu_c are drawn from the last.
        data: the observations of the last estimate.
        truth: the simulated object; None if it is not known: then the last panel shows p_CF itself instead of its error.
        slipping: ids of the pushes whose contact is known to slip; the figure marks their lower bounds on mu_c.
        doubts: about the data, in words; they stand above the panels.
        planned: number of pushes that were to be made; None: nobody says.
    Returns:
        The figure, laid out, because that takes as long as to draw it.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 8.4))
        figure.suptitle("\n".join(line for doubt in doubts for line in textwrap.wrap(doubt, 120)), fontsize="medium")
        trajectories, friction, contact, errors = figure.subplots(2, 2, height_ratios=(1, 1)).ravel()
        _draw_trajectories(trajectories, outline, data, planned)
        _draw_support_friction(friction, outline, estimates[-1], truth)
        _draw_contact_friction(contact, estimates[-1], [one.push_id in slipping for one in data], truth)
        _draw_center_of_friction(errors, outline, estimates, truth)
        ConstrainedLayoutEngine().execute(figure)
    return figure


def _draw_trajectories(axes: Any, outline: Outline, data: Sequence[Observation], planned: int | None) -> None:
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
    title = f"Pushes {' and '.join(number_of(push, planned) for push in shown)}: object and contact at each observation"
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
    legend(axes)


def _draw_center_of_friction(axes: Any, outline: Outline, estimates: Sequence[Estimate], truth: TableObject | None) -> None:
    """p_CF against the number of observations: its error in percent of the sides; if the truth is unknown, its coordinates."""
    counts = [estimate.data_points for estimate in estimates]
    centers: Array = np.array([estimate.center_of_friction for estimate in estimates])
    regions: Array = np.full((len(estimates), 2, 2), np.nan)
    for end in with_belief(estimates):
        regions[end] = _region(estimates[end])
    known = truth is not None
    unit = 100 / outline.size if known else np.full(2, MILLIMETRE)
    for k, (label, style) in enumerate((("x", "-"), ("y", "--"))):
        course = np.abs(centers[:, k] - truth.support.center_of_friction[k]) if truth is not None else centers[:, k]
        axes.plot(counts, unit[k] * course, style, marker="." if len(counts) == 1 else "", color=ESTIMATE, label=label)
        told = np.isfinite(regions[:, 1, k])
        middle, half = (unit[k] * regions[told, row, k] for row in (0, 1))
        if known:
            axes.plot(np.array(counts)[told], half, style, color=GREY, lw=1, label=f"{label}, belief, 90 %")
        else:
            axes.fill_between(np.array(counts)[told], middle - half, middle + half, color=ESTIMATE, alpha=0.15, lw=0)
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
        axes.set(title="$p_{CF}$ by the program, and the belief's 90 % intervals", xlabel="observations", ylabel="mm")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    legend(axes)


def _region(estimate: Estimate) -> Array:
    """The middle of the 90 % ellipse of p_CF, and half its sizes along x and y (2, 2) [m]; NaN if they are unknown."""
    belief = estimate.belief
    if belief is None or belief.covariance is None:
        return np.full((2, 2), np.nan)
    return np.array((belief.center_of_friction, np.sqrt(ELLIPSE * np.diag(belief.covariance))))
