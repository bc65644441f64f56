"""The picture of an estimate: the object with w, p_CF and its confidence ellipse, and the pushes."""

import base64
import html
import io
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.legend_handler import HandlerPatch
from matplotlib.patches import Ellipse

from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array
from pushfric_core.mechanics.prediction import ELLIPSE, FrictionModel

if TYPE_CHECKING:
    from pushfric_core.estimation.estimate import Estimate

MILLIMETRE = 1e3
INK, GREY, ESTIMATE = "#222222", "#8c8c8c", "#0072b2"
TRUTH, SLIPPING, OTHER, REACHED = "#d55e00", "#cc79a7", "#009e73", "#56b4e9"
"""The meaning of each colour in all figures. OTHER marks what the estimate is compared with, REACHED what pushes reach. The
colours are those of Okabe and Ito (Color Universal Design, 2008), which colour-blind readers tell apart."""

STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "legend.frameon": False,
}

AREA = 1500
"""Size of the dot of a support point that bears all the friction [points^2]."""

ARROW = 0.15
"""Length of the arrow of a push, as a fraction of the extent of the contacts."""


def draw_support_friction(axes: Any, estimate: "Estimate", belief: FrictionModel | None, outline: Outline | None) -> None:
    """w as dots of proportional area, with an x where it is zero, and p_CF with its 90 % ellipse.

    They are those of the belief, or of the program where nothing is believed, or nobody knows how far it is off.
    """
    if outline is not None:
        axes.plot(*(closed(outline.vertices).T * MILLIMETRE), color=INK, lw=1)
    points = estimate.support_points * MILLIMETRE
    w, center, covariance = estimate.w, estimate.center_of_friction, None
    if belief is not None and belief.covariance is not None:
        w, center, covariance = belief.support.weights, belief.center_of_friction, belief.covariance
    zero = w < 1e-3
    axes.scatter(*points[~zero].T, s=AREA * w[~zero], color=ESTIMATE, alpha=0.8, lw=0, label="estimated $w$")
    axes.plot(*points[zero].T, "x", color=GREY, ms=5, label="$w < 0.001$" if zero.any() else "")
    x, y = center * MILLIMETRE
    axes.plot(x, y, "+", color=ESTIMATE, ms=12, mew=2, label="estimated $p_{CF}$")
    if covariance is not None:
        sizes, directions = np.linalg.eigh(covariance)
        width, height = 2 * MILLIMETRE * np.sqrt(ELLIPSE * np.maximum(sizes, 0))
        turn = np.degrees(np.arctan2(*directions[::-1, 0]))
        axes.add_patch(Ellipse((x, y), width, height, angle=turn, fill=False, ec=ESTIMATE, lw=1, label="90 % ellipse"))
    axes.set(title="Support friction distribution", xlabel="x [mm]", ylabel="y [mm]")
    axes.set_aspect("equal", "datalim")  # the layout makes room for the legend below axes that fill their place, not for others


def draw_pushes(axes: Any, estimate: "Estimate") -> None:
    """A dot at the contact of each observation, and an arrow along the inward normal where each push began."""
    contacts = np.array([observation.contact_point for observation in estimate.observations]).reshape(-1, 2)
    first = {observation.push_id: observation for observation in reversed(estimate.observations)}
    tips = np.array([observation.contact_point for observation in first.values()]).reshape(-1, 2)
    normals = np.array([observation.contact_normal for observation in first.values()]).reshape(-1, 2)
    length = ARROW * float(np.ptp(np.vstack((contacts, estimate.support_points)), axis=0).max())
    axes.plot(*(contacts.T * MILLIMETRE), "o", color=INK, ms=2.5, alpha=0.6, label="contacts")
    axes.quiver(
        *(tips.T * MILLIMETRE),
        *(-normals.T * length * MILLIMETRE),
        pivot="tip",
        angles="xy",
        scale_units="xy",
        scale=1,
        color=GREY,
        width=0.004,
    )
    axes.update_datalim((tips + length * normals) * MILLIMETRE)
    axes.autoscale_view()


def draw(axes: Any, estimate: "Estimate") -> Any:
    """Draw the whole picture; None stands for new axes of pyplot. Returns the axes."""
    with mpl.rc_context(STYLE):
        if axes is None:
            import matplotlib.pyplot as plt  # only here: it chooses how windows are shown

            axes = plt.subplots(layout="constrained")[1]
        draw_support_friction(axes, estimate, estimate.belief, estimate.outline)
        draw_pushes(axes, estimate)
        legend(axes)
    return axes


def legend(axes: Any) -> None:
    """A legend below the axes, whose keys have the shape of what they name."""
    axes.legend(
        handler_map={Ellipse: HandlerPatch(_ellipse_key)},
        loc="upper center",
        bbox_to_anchor=(0.5, -0.14),
        ncols=5,
        fontsize=8,
        columnspacing=0.8,
        handletextpad=0.4,
        markerscale=0.5,
    )


def _ellipse_key(*, xdescent: float, ydescent: float, width: float, height: float, **_: Any) -> Ellipse:
    """An ellipse that fills its place in the legend."""
    return Ellipse((width / 2 - xdescent, height / 2 - ydescent), width, height)


def as_html(estimate: "Estimate") -> str:
    """The picture, as a part of an HTML page."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6, 4), layout="constrained")
        draw(figure.subplots(), estimate)
        image = io.BytesIO()
        figure.savefig(image, format="png", dpi=100)
    data = base64.b64encode(image.getvalue()).decode()
    return f'<img alt="{html.escape(repr(estimate))}" src="data:image/png;base64,{data}">'


def closed(points: Array) -> Array:
    """The points of a polygon (n, 2), with the first one again at the end."""
    return np.concatenate((points, points[:1]))
