"""Sections of limit surfaces, as Figure 12 shows them."""

import math

import numpy as np

from pushfric_core.geometry.planar import Array, Wrench, cross, left_of
from pushfric_core.mechanics.limit_surface import LimitSurface


def cross_section(surface: LimitSurface, first: Wrench, second: Wrench, count: int = 180) -> Array:
    """The closed convex curve (k, 2) in which the plane of two wrenches cuts a surface; its straight parts are exact.

    The points go round counter-clockwise; their coordinates are those along the two wrenches.

    The plane fx = 0 of Figure 12 is that of (0, 1, 0) and (0, 0, 1).

    Args:
        surface: of an object.
        first: the wrench whose multiples are the first coordinate.
        second: the wrench whose multiples are the second coordinate, not parallel to the first.
        count: number of points of the curve, not counting the ends of its straight parts.
    Raises:
        SolverFailed: a motion was not found.
    """

    def on_surface(wrenches: Array) -> Array:
        """What brings wrenches (s, 3) to the surface: factors (s, 1)."""
        return 1 / np.sum(wrenches * surface.twists(wrenches), axis=1, keepdims=True)

    basis = np.array((first, second))
    extent = on_surface(basis)[:, 0]
    angles = np.linspace(-np.pi, np.pi, count, endpoint=False)
    rays = extent * np.column_stack((np.cos(angles), np.sin(angles)))
    rays *= on_surface(rays @ basis)
    half = [chord @ np.linalg.pinv(basis) for chord in _chords(surface, np.cross(*basis))]
    points = np.concatenate((rays, *half, *(-chord for chord in half)))
    x, y = (points / extent).T
    return np.asarray(points[np.argsort(np.arctan2(y, x))])


def _chords(surface: LimitSurface, normal: Array) -> list[Array]:
    """Where the plane through the origin with this normal cuts the facets: ends (2, 3) each."""
    chords = []
    for facet in surface.facets:
        # normal . (center + (u, p x u)) = 0, a line in the plane of u
        slope = normal[:2] + normal[2] * left_of(facet.point)
        size = float(np.hypot(*slope))
        distance = -float(normal @ facet.center)
        if abs(distance) < facet.radius * size:
            nearest, half = distance / size**2 * slope, math.sqrt(facet.radius**2 - (distance / size) ** 2) / size
            forces = np.array((nearest - half * left_of(slope), nearest + half * left_of(slope)))
            chords.append(np.asarray(facet.center) + np.column_stack((forces, cross(facet.point, forces))))
    return chords
