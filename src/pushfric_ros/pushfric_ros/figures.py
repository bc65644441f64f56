"""The figures of a run, in the manner of the paper's."""

import pathlib
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from pushfric_core.estimator import Estimate
from pushfric_core.observation import Observation
from pushfric_core.outline import Outline
from pushfric_core.planar import Array, transform
from pushfric_core.simulation import TableObject

MILLIMETRE = 1e3
INK, BLUE, RED, GREY = "#222222", "#2563a8", "#c2410c", "#9a9a9a"


def summary_figure(
    path: pathlib.Path,
    outline: Outline,
    estimates: Sequence[Estimate],
    data: Sequence[Observation],
    truth: TableObject | None,
) -> None:
    """Four panels: trajectories with contacts (Figure 3), w (Figure 5), mu_c (Figure 8), error of p_CF (Figure 11).

    Args:
        path: where the image goes; its suffix tells the format.
        outline: of the object.
        estimates: after each data point, at least one; the last is drawn.
        data: the data points.
        truth: of a simulated object; without it the last panel shows p_CF itself.
    """
    with mpl.rc_context(
        {
            "font.size": 9,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.titlesize": 10,
            "axes.titlelocation": "left",
            "legend.frameon": False,
        }
    ):
        figure = Figure(figsize=(11, 7.6), layout="constrained")
        trajectories, friction, contact, errors = figure.subplots(2, 2, height_ratios=(1, 1)).ravel()
        _draw_trajectories(trajectories, outline, data)
        _draw_support_friction(friction, outline, estimates[-1], truth)
        _draw_contact_friction(contact, estimates[-1], truth)
        _draw_center_of_friction(errors, outline, estimates, truth)
        figure.savefig(path, dpi=130)


def _draw_trajectories(axes: Any, outline: Outline, data: Sequence[Observation]) -> None:
    """Two pushes: where the object was at each data point, and where the pusher touched it."""
    pushes = sorted({o.push_id for o in data if o.pose is not None})
    shown = [pushes[index] for index in sorted({len(pushes) // 5, len(pushes) - 1 - len(pushes) // 5})] if pushes else []
    shift = 0.0
    for color, push in zip((BLUE, RED), shown, strict=False):
        course = [o for o in data if o.push_id == push and o.pose is not None]
        left = min(transform(o.pose, outline.vertices)[:, 0].min() for o in course if o.pose)
        right = max(transform(o.pose, outline.vertices)[:, 0].max() for o in course if o.pose)
        for age, o in enumerate(course):
            assert o.pose is not None
            corners = transform(o.pose, np.vstack((outline.vertices, outline.vertices[:1]))) + (shift - left, 0)
            axes.plot(*(corners.T * MILLIMETRE), color=color, lw=1, alpha=0.3 + 0.7 * (age + 1) / len(course))
            contact = transform(o.pose, o.contact_point) + (shift - left, 0)
            axes.plot(*(contact * MILLIMETRE), "o", color=INK, ms=3.5)
        shift += right - left + 0.02
    axes.set(
        title=f"Pushes {' and '.join(str(p + 1) for p in shown)}: object and contact at each data point",
        xlabel="mm",
        ylabel="mm",
    )
    axes.set_aspect("equal")


def _draw_support_friction(axes: Any, outline: Outline, estimate: Estimate, truth: TableObject | None) -> None:
    """w as dots of proportional area, an x where it is zero."""
    corners = np.vstack((outline.vertices, outline.vertices[:1])) * MILLIMETRE
    axes.plot(*corners.T, color=INK, lw=1)
    points = estimate.support_points * MILLIMETRE
    zero = estimate.w < 1e-3
    axes.plot(*points[zero].T, "x", color=GREY, ms=5)
    axes.scatter(*points[~zero].T, s=1500 * estimate.w[~zero], color=BLUE, alpha=0.8, lw=0, label="estimated $w$")
    if truth is not None and len(truth.support.points) <= 10:
        axes.scatter(
            *(truth.support.points * MILLIMETRE).T,
            s=1500 * truth.support.weights,
            facecolors="none",
            edgecolors=RED,
            lw=1.2,
            label="true $w$",
        )
    axes.plot(*(estimate.center_of_friction * MILLIMETRE), "+", color=BLUE, ms=12, mew=2, label="estimated $p_{CF}$")
    if truth is not None:
        axes.plot(*(truth.support.center_of_friction * MILLIMETRE), "o", mfc="none", color=RED, ms=7, label="true $p_{CF}$")
    axes.set(title="Support friction distribution", xlabel="x [mm]", ylabel="y [mm]")
    axes.set_aspect("equal")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=4, columnspacing=1.2, handletextpad=0.3, markerscale=0.5)


def _draw_contact_friction(axes: Any, estimate: Estimate, truth: TableObject | None) -> None:
    """Histogram of the lower bounds on mu_c."""
    bounds = estimate.contact_friction[np.isfinite(estimate.contact_friction)]
    top = max(1.0, float(bounds.max(initial=0.0)), truth.mu_c if truth else 0.0)
    axes.hist(bounds, bins=np.arange(0, top + 0.1, 0.05), color=BLUE, alpha=0.8)
    axes.axvline(estimate.mu_c_p90, color=INK, ls="--", lw=1, label=f"90 %: {estimate.mu_c_p90:.2f}")
    if np.isfinite(estimate.mu_c_max):
        axes.axvline(estimate.mu_c_max, color=INK, lw=1, label=f"100 %: {estimate.mu_c_max:.2f}")
    if truth is not None:
        axes.axvline(truth.mu_c, color=RED, lw=1.2, label=f"true: {truth.mu_c:.2f}")
    axes.set(title="Lower bounds on $\\mu_c$", xlabel="$\\mu_c$", ylabel="data points")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, columnspacing=1.0, handlelength=1.0)


def _draw_center_of_friction(axes: Any, outline: Outline, estimates: Sequence[Estimate], truth: TableObject | None) -> None:
    """p_CF against the number of data points: its error in percent of the sides, or where it is."""
    counts = [estimate.data_points for estimate in estimates]
    centers: Array = np.array([estimate.center_of_friction for estimate in estimates])
    if truth is None:
        axes.plot(counts, centers * MILLIMETRE, label=("x", "y"))
        axes.set(title="Centre of friction", xlabel="data points", ylabel="mm")
    else:
        percent = 100 * np.abs(centers - truth.support.center_of_friction) / outline.size
        for side, color, label in zip(percent.T, (BLUE, RED), ("x", "y"), strict=True):
            axes.plot(counts, side, color=color, label=label)
        axes.axhline(2, color=GREY, ls=":", lw=1)
        axes.set(title="Error of $p_{CF}$", xlabel="data points", ylabel="% of the side", yscale="log")
    axes.legend()
