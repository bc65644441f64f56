"""The polygon outline of an object: edges and normals, points inside, grids over it, and what a round tip meets first."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import shapely

from pushfric_core.geometry.planar import UNIT, Array, as_array, check_unit, cross, frozen, left_of
from pushfric_core.plausible import FARTHEST, LARGEST, check_within, other_unit
from pushfric_core.records import comparable

ON_OUTLINE = 1e-9
"""Points this close to the outline [m] count as inside, so that a grid may touch the edges."""

SMALLEST = 0.01
"""An object is hardly smaller [m]: shows whether a length was written in millimetres or in centimetres."""

ALIKE = 0.01
"""Outlines that differ in less than this share of their area look the same."""

LARGEST_GRID = 10_000
"""Largest number of points; the program for w grows with the square of their number."""


@comparable
class Touch(NamedTuple):
    """Where a round tip, moving along a line, first meets the outline.

    Example:
        >>> from pushfric_core import Outline
        >>> touch = Outline.rectangle(0.1, 0.06).first_touch(start=(0.02, -0.1), direction=(0.0, 1.0), radius=0.003)
        >>> round(touch.distance, 3), touch.normal.tolist(), touch.edge
        (0.067, [0.0, -1.0], 0)
    """

    distance: float  # the tip's centre travels this far from the start of the line [m]; may be negative
    point: Array  # (2,) contact point on the outline [m]
    normal: Array  # (2,) unit, outward
    edge: int | None  # index of the edge; None: a corner


@comparable
class Touches(NamedTuple):
    """The first touches of r tips. If a tip passes by, its distance is infinite, and its point and normal are undefined."""

    distances: Array  # (r,) [m]
    points: Array  # (r, 2) [m]
    normals: Array  # (r, 2) unit, outward
    edges: npt.NDArray[np.int64]  # (r,) -1: a corner


@comparable
@dataclass(frozen=True)
class Outline:
    """Simple polygon in the object frame.

    Args:
        vertices: (n, 2) corners in order [m]; made counter-clockwise. Neighbours in one place, as the ends of a ring, are one.
    Raises:
        ValueError: fewer than three corners, one that is not finite or beyond FARTHEST, a side of the bounding box longer than
            LARGEST, or an outline that crosses itself or encloses no area.

    Example:
        >>> from pushfric_core import Outline
        >>> outline = Outline([(0.0, 0.0), (0.1, 0.0), (0.0, 0.06)])
        >>> outline.contains([(0.01, 0.01), (0.1, 0.06)]).tolist()
        [True, False]
        >>> outline.grid(4, 3).shape
        (6, 2)
    """

    vertices: Array

    def __post_init__(self) -> None:
        vertices = frozen(self.vertices)
        if not np.isfinite(vertices).all():
            raise ValueError("the vertices of an outline must be finite")
        if vertices.shape[1:] == (2,):
            vertices = frozen(vertices[np.abs(np.roll(vertices, -1, axis=0) - vertices).max(axis=1) > ON_OUTLINE])
        if vertices.shape[1:] != (2,) or len(vertices) < 3:
            raise ValueError(f"an outline needs at least 3 vertices (n, 2) in different places, got shape {vertices.shape}")
        length, width = np.ptp(vertices, axis=0).tolist()
        if not max(length, width) <= LARGEST:
            asked = other_unit("m", lambda factor: SMALLEST <= max(length, width) * factor <= LARGEST)
            raise ValueError(f"an outline must be at most {LARGEST:g} m long and wide, got {length:g} x {width:g} m{asked}")
        check_within("the vertices of an outline", (vertices.min(), vertices.max()), FARTHEST, "m")
        polygon = shapely.Polygon(vertices)
        if not polygon.is_valid or not polygon.area > 0:
            raise ValueError(f"the outline must be a simple polygon with an area: {shapely.is_valid_reason(polygon)}")
        if not polygon.exterior.is_ccw:
            vertices = frozen(vertices[::-1])
        object.__setattr__(self, "vertices", vertices)

    @classmethod
    def rectangle(cls, length: float, width: float) -> Outline:
        """Rectangle centred on the origin, `length` along x and `width` along y [m]."""
        x, y = length / 2, width / 2
        return cls(np.array(((-x, -y), (x, -y), (x, y), (-x, y))))

    @cached_property
    def polygon(self) -> shapely.Polygon:
        """The outline as a shapely polygon."""
        return shapely.Polygon(self.vertices)

    @cached_property
    def edges(self) -> Array:
        """Edge vectors (n, 2) [m]; edge i runs from vertex i to vertex i + 1."""
        return np.asarray(np.roll(self.vertices, -1, axis=0) - self.vertices)

    @cached_property
    def lengths(self) -> Array:
        """Edge lengths (n,) [m]."""
        return np.asarray(np.linalg.norm(self.edges, axis=1))

    @cached_property
    def normals(self) -> Array:
        """Unit outward normals (n, 2) of the edges."""
        return np.asarray(-left_of(self.edges) / self.lengths[:, None])

    @property
    def perimeter(self) -> float:
        """Length of the outline [m]."""
        return float(self.lengths.sum())

    @cached_property
    def reach(self) -> float:
        """Distance of the farthest corner from the origin [m]."""
        return float(np.hypot(*self.vertices.T).max())

    @property
    def lower(self) -> Array:
        """Lower left corner (2,) of the bounding box [m]."""
        return np.asarray(self.vertices.min(axis=0))

    @property
    def size(self) -> Array:
        """Sides (2,) of the bounding box [m]."""
        return np.asarray(np.ptp(self.vertices, axis=0))

    @cached_property
    def is_its_mirror_image(self) -> bool:
        """Whether the outline looks the same in a mirror: then only a marker shows that a picture is mirrored."""
        centroid = np.array(self.polygon.centroid.coords[0])
        around = np.concatenate((self.vertices, self.vertices + self.edges / 2)) - centroid
        for x, y in around[np.hypot(*around.T) > 0].tolist():  # an axis passes through a corner, or the middle of an edge
            c, s = (x * x - y * y) / (x * x + y * y), 2 * x * y / (x * x + y * y)
            mirrored = shapely.Polygon((self.vertices - centroid) @ np.array(((c, s), (s, -c))) + centroid)
            if self.polygon.symmetric_difference(mirrored).area < ALIKE * self.polygon.area:
                return True
        return False

    def contains(self, points: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Which points (m, 2) lie inside or on the outline."""
        return np.asarray(shapely.dwithin(self.polygon, shapely.points(as_array(points)), ON_OUTLINE))

    def distance_to(self, point: npt.ArrayLike) -> float:
        """Distance of a point (2,), inside or outside, from the outline itself [m]."""
        return float(self.distances_to(point))

    def distances_to(self, points: npt.ArrayLike) -> Array:
        """Distances (...) of points (..., 2), inside or outside, from the outline itself [m]."""
        return np.asarray(shapely.distance(self.polygon.exterior, shapely.points(as_array(points))))

    def grid(self, columns: int, rows: int, inset: float = 0.002) -> Array:
        """Points (m, 2) spaced evenly over the bounding box shrunk by `inset` [m]; points outside the outline are dropped.

        A single column or row lies in the middle. The order is along x first.

        Raises:
            ValueError: no columns or rows, too many of them, an inset that leaves no box, or no point inside.
        """
        if columns < 1 or rows < 1:
            raise ValueError(f"a grid needs at least 1 column and 1 row, got {columns} x {rows}")
        if columns * rows > LARGEST_GRID:
            raise ValueError(f"a grid may have at most {LARGEST_GRID} points, got {columns} x {rows}")
        if not 0 <= inset < min(self.size) / 2:
            asked = other_unit("m", lambda factor: 0 <= inset * factor < min(self.size) / 2)
            half = f"{min(self.size) / 2:g}"
            raise ValueError(f"inset must lie in [0, {half}) m, half the shorter side, got {inset:g} m{asked}")
        low, high = self.lower + inset, self.lower + self.size - inset
        axes = [
            np.linspace(a, b, count) if count > 1 else np.array(((a + b) / 2,))
            for a, b, count in zip(low, high, (columns, rows), strict=True)
        ]
        points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        inside = points[self.contains(points)]
        if not len(inside):
            raise ValueError(f"no point of the {columns} x {rows} grid lies inside the outline")
        return np.asarray(inside)

    def nearest(self, point: npt.ArrayLike) -> Touch:
        """The point of the outline that is nearest to a point (2,) [m].

        `distance` is that of the point from the edge's line, negative inside [m]. If a corner is nearest, it is the distance
        from that corner, and the edge is None.
        """
        at = as_array(point)
        along = np.sum((at - self.vertices) * self.edges, axis=1) / self.lengths**2
        feet = self.vertices + np.clip(along, 0.0, 1.0)[:, None] * self.edges
        edge = int(np.argmin(np.sum((at - feet) ** 2, axis=1)))
        gap = at - feet[edge]
        if not 0 < along[edge] < 1:
            size = float(np.hypot(*gap))
            return Touch(size, feet[edge], gap / size if size > 0 else self.normals[edge], None)
        return Touch(float(gap @ self.normals[edge]), feet[edge], self.normals[edge], edge)

    def outward(self, points: npt.ArrayLike, normals: npt.ArrayLike, within: float) -> npt.NDArray[np.bool_]:
        """Which normals (..., 2) point out of the outline: less than 90 degrees off that of an edge near a point (..., 2).

        Args:
            points: on the outline, or near it [m].
            normals: of any length but zero.
            within: edges this near count [m]; the nearest one always does.
        """
        offsets = as_array(points)[..., None, :] - self.vertices
        along = np.clip(np.sum(offsets * self.edges, axis=-1) / self.lengths**2, 0.0, 1.0)
        distances = np.linalg.norm(offsets - along[..., None] * self.edges, axis=-1)
        near = distances <= np.maximum(within, distances.min(axis=-1, keepdims=True))
        return np.asarray((near & (np.sum(as_array(normals)[..., None, :] * self.normals, axis=-1) > 0)).any(axis=-1))

    def first_touch(self, start: npt.ArrayLike, direction: npt.ArrayLike, radius: float = 0.0) -> Touch | None:
        """Where a round tip that moves along a line first meets the outline; None if it passes by.

        Args:
            start: (2,) centre of the tip at distance 0, outside the outline and ahead of it on the line [m].
            direction: (2,) unit vector of the motion.
            radius: of the tip [m]; at 0 a corner met exactly counts as the edge it ends.
        Raises:
            ValueError: the direction is not unit.
        """
        # in plain numbers, as every frame asks this of few edges; the same to the last bit as `first_touches`
        (x, y), (dx, dy) = as_array(start).tolist(), as_array(direction).tolist()
        if not abs(math.hypot(dx, dy) - 1) <= UNIT:
            check_unit("direction", direction)
        best, edge = math.inf, -1
        for i, (ax, ay, ex, ey, nx, ny, square) in enumerate(self._sides):
            approach = dx * nx + dy * ny
            if approach < 0:
                distance = (nx * (ax - x) + ny * (ay - y) + radius) / approach
                px, py = x + distance * dx - radius * nx, y + distance * dy - radius * ny
                if distance < best and 0 <= ((px - ax) * ex + (py - ay) * ey) / square <= 1:
                    best, edge = distance, i
                    point, normal = (px, py), (nx, ny)
        for ax, ay, *_ in self._sides if radius > 0 else ():
            ox, oy = ax - x, ay - y
            miss = dx * oy - dy * ox
            if abs(miss) < radius and (distance := ox * dx + oy * dy - math.sqrt(radius * radius - miss * miss)) < best:
                best, edge = distance, -1
                point = ax, ay
                normal = (x + distance * dx - ax) / radius, (y + distance * dy - ay) / radius
        return Touch(best, np.array(point), np.array(normal), None if edge < 0 else edge) if best < math.inf else None

    @cached_property
    def _sides(self) -> list[tuple[float, ...]]:
        """The edges: where each begins, its vector, its normal, and its length squared."""
        columns = (self.vertices, self.edges, self.normals, (self.lengths**2)[:, None])
        return [tuple(row) for row in np.hstack(columns).tolist()]

    def first_touches(self, starts: npt.ArrayLike, directions: npt.ArrayLike, radii: npt.ArrayLike) -> Touches:
        """The first touches of r round tips: starts (r, 2), directions (r, 2) and radii (r,), as for `first_touch`."""
        starts, directions, radii = as_array(starts), as_array(directions), as_array(radii)
        check_unit("directions", directions)
        each = np.arange(len(starts))
        distances, points, normals, edges = self._edge_touches(each, starts, directions, radii)
        offsets = self.vertices - starts[:, None]
        miss = cross(directions[:, None], offsets)
        reach = radii[:, None]
        before = np.sum(offsets * directions[:, None], axis=2) - np.sqrt(np.maximum(reach**2 - miss**2, 0))
        corners = np.where(np.abs(miss) < reach, before, np.inf)  # the tip's centre comes within the radius
        corner = np.argmin(corners, axis=1)
        first = corners[each, corner] < distances
        at, which = each[first], corner[first]
        distances[at], points[at], edges[at] = corners[at, which], self.vertices[which], -1
        normals[at] = (starts[at] + distances[at, None] * directions[at] - points[at]) / radii[at, None]
        return Touches(distances, points, normals, edges)

    def _edge_touches(self, each: npt.NDArray[np.int64], starts: Array, directions: Array, radii: Array) -> Touches:
        """The first edges, moved outward by the radii, that the tips' centres cross inward."""
        approach = np.sum(directions[:, None] * self.normals, axis=2)  # (r, n)
        facing = approach < 0
        gap = np.sum(self.normals * (self.vertices - starts[:, None]), axis=2) + radii[:, None]
        distance = gap / np.where(facing, approach, -1.0)
        points = starts[:, None] + distance[..., None] * directions[:, None] - radii[:, None, None] * self.normals
        along = np.sum((points - self.vertices) * self.edges, axis=2) / self.lengths**2
        distance = np.where(facing & (along >= 0) & (along <= 1), distance, np.inf)
        edge = np.argmin(distance, axis=1)
        return Touches(distance[each, edge], points[each, edge], self.normals[edge], edge)
