"""The six objects of Table 1: their true values, the noise with which they are seen, and the hypotheses of the paper."""

import math
from typing import Any, NamedTuple

import numpy as np

from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array
from pushfric_core.geometry.support import Support
from pushfric_core.records import comparable


class PoseNoise(NamedTuple):
    """Standard deviations of the error of a pose in a single frame, before any smoothing."""

    position: float  # of each coordinate [m]
    angle: float  # [rad]


FEET = PoseNoise(1e-4, math.radians(0.12))
"""Noise for the objects on felt feet; with it, simulated pushes fit as well as those of the paper."""

FLAT = PoseNoise(3.5e-4, math.radians(0.45))
"""Noise for the flat objects, which are the smallest."""


@comparable
class TableObject(NamedTuple):
    """An object of Table 1: its true values, the noise with which it is seen, and the grid of hypothesised support points."""

    outline: Outline
    support: Support
    mu_c: float
    grid: tuple[int, int]  # columns and rows
    inset: float  # of the grid [m]
    pushes: tuple[int, ...]  # along each edge, from the lower one counter-clockwise
    noise: PoseNoise

    @property
    def support_points(self) -> Array:
        """Hypothesised support points (n, 2) [m]."""
        return self.outline.grid(*self.grid, self.inset)

    def to_dict(self) -> dict[str, Any]:
        """The true values under the names of the command line's JSON; SI units, object frame."""
        return {
            "center_of_friction": self.support.center_of_friction.tolist(),
            "support_points": self.support.points.tolist(),
            "w": self.support.weights.tolist(),
            "mu_c": self.mu_c,
        }


def _on_feet(
    length: float, width: float, feet: list[tuple[float, float]], mu_c: float, grid: tuple[int, int], pushes: tuple[int, ...]
) -> TableObject:
    """An object on felt feet with equal loads; the outer lines of the grid are `INSET` inside the edges, as the feet are."""
    support = Support(np.array(feet), np.full(len(feet), 1 / len(feet)))
    return TableObject(Outline.rectangle(length, width), support, mu_c, grid, INSET, pushes, FEET)


def _flat(length: float, width: float, offset: float, mu_c: float) -> TableObject:
    """An object with a flat, slightly crowned bottom: it presses on an ellipse, and the pressure falls off parabolically.

    A weight on top shifts the centre of friction along x by `offset` [m].
    """
    outline = Outline.rectangle(length, width)
    points = outline.grid(25, 15, inset=0.001)
    pressure = 1 - np.sum((2 * points / (length, width)) ** 2, axis=1)
    points, pressure = points[pressure > 0], pressure[pressure > 0]
    shift = offset * pressure.sum() / (pressure @ points[:, 0] ** 2)
    weights = pressure * (1 + shift * points[:, 0])
    return TableObject(outline, Support(points, weights / weights.sum()), mu_c, (6, 4), 0.002, (5, 2, 5, 2), FLAT)


INSET = 0.01
"""Distance of the felt feet from the edges [m]."""

_CORNERS = [(-0.0535, -0.022), (0.0535, -0.022), (-0.0535, 0.022), (0.0535, 0.022)]

TABLE_1 = {
    "delrin_square3": _on_feet(0.076, 0.076, [(-0.028, -0.014), (0.028, -0.014), (0.0, 0.028)], 0.2, (6, 6), (5, 5, 5, 5)),
    "wood_rect3": _on_feet(0.127, 0.064, [(-0.02675, -0.022), (-0.02675, 0.022), (0.0535, 0.0)], 0.3, (5, 3), (7, 0, 7, 0)),
    "wood_rect4": _on_feet(0.127, 0.064, _CORNERS, 0.3, (5, 3), (7, 0, 7, 0)),
    "rubber_rect4": _on_feet(0.127, 0.064, _CORNERS, 0.9, (5, 3), (7, 0, 7, 0)),
    "delrin_rect_center": _flat(0.083, 0.051, 0.0, 0.2),
    "delrin_rect_right": _flat(0.083, 0.051, 0.007, 0.2),
}
"""The six objects of Table 1. Materials give mu_c as measured for Table 3; the paper does not say where the feet are, only that
the corners of the grid correspond to them (section 5.1.2) and where p_CF lies."""

LOOKALIKES = {"delrin_rect_left": (-0.007, 0.0), "delrin_rect_center": (0.0, 0.0), "delrin_rect_right": (0.007, 0.0)}
"""Objects that look the same, with their centres of friction [m]: the hypotheses of section 5.2.1."""

ORIENTATIONS = {"delrin_square3": (0, 90, 180, 270), "wood_rect3": (0, 180)}
"""Rotations after which an object looks the same but its feet are elsewhere [degrees], the true one first (section 5.2.2)."""
