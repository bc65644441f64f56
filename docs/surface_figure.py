"""The figure of a limit surface, as limit_surface.md shows it."""

import pathlib

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from bench.paper.sections import cross_section
from pushfric_core.estimation.picture import GREY, INK, MILLIMETRE, OTHER, REACHED, STYLE, closed
from pushfric_core.files.figure_file import save_figure
from pushfric_core.geometry.planar import Wrench
from pushfric_core.geometry.support import Support
from pushfric_core.mechanics.limit_surface import LimitSurface, named_ellipsoid

MERIDIANS = 8
"""Number of sections through the moment axis that show the limit surface in space."""


def limit_surface_figure(
    path: pathlib.Path, support: Support, contact_points: npt.ArrayLike, contact_normals: npt.ArrayLike, mu_c: float
) -> None:
    """Two panels: the surface with the part that pushes reach (Figure 12, in space), and a section with the ellipsoid.

    Args:
        path: where to write the image; its suffix selects the format.
        support: of an object.
        contact_points: (k, 2) where it can be pushed, object frame [m].
        contact_normals: (k, 2) unit, outward.
        mu_c: contact friction coefficient.
    Raises:
        ValueError: as for `LimitSurface.reachable`.
        SolverFailed: the motion of a push was not found.
        InvalidInput: the image cannot be written.
    """
    scale, surface = np.array((1.0, 1.0, MILLIMETRE)), LimitSurface(support)
    reached = surface.reachable(contact_points, contact_normals, mu_c).wrenches * scale
    force, moment = Wrench(0.0, 1.0, 0.0), Wrench(0.0, 0.0, 1.0)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10, 4.4), layout="constrained")
        space = figure.add_subplot(1, 2, 1, projection="3d")
        for angle in np.arange(MERIDIANS) * np.pi / MERIDIANS:
            across = Wrench(float(np.cos(angle)), float(np.sin(angle)), 0.0)
            space.plot(*closed(cross_section(surface, across, moment) @ (across, moment) * scale).T, color=GREY, lw=0.6)
        for wrenches in reached:
            (line,) = space.plot(*wrenches.T, color=REACHED, lw=3, marker="o" if len(wrenches) == 1 else None, ms=3)
        line.set_label("what pushes reach")
        space.set_box_aspect(None, zoom=1.1)
        space.set(title="Limit surface, units as on the right", xlabel="$f_x$", ylabel="$f_y$", zlabel="$m$")
        space.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1))
        section = figure.add_subplot(1, 2, 2)
        section.plot(*closed(cross_section(surface, force, moment) * scale[1:]).T, color=INK, lw=1.4, label="exact")
        angles = np.linspace(0, 2 * np.pi, 361)
        # the inverse of a square root of the form takes the circle to the ellipse
        root = np.linalg.cholesky(named_ellipsoid(support).form[1:, 1:])
        ellipse = np.column_stack((np.cos(angles), np.sin(angles))) @ np.linalg.inv(root)
        section.plot(*(ellipse * scale[1:]).T, ls="--", color=OTHER, lw=1.4, label="ellipsoid")
        section.set(title="Section $f_x = 0$", xlabel="$f_y$ [support friction]", ylabel="$m$ [support friction $\\times$ mm]")
        section.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=3)
        save_figure(figure, path)
