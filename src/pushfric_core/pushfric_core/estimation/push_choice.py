"""Test pushes that narrow down the centre of friction: the best next one, and the best sequence (section 6.2); and pushes that
slip, for mu_c (section 5.1.3).

The line along which the pusher will move cuts the region of p_CF into two parts. The sense of rotation leaves one of them (see
`region.line_of_pushing`).
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import shapely

from pushfric_core.estimation.push_plan import SHARP, PlannedPush, planned_contact
from pushfric_core.estimation.region import HalfPlane, HalfPlanes, cut, left_of_line
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, left_of

USABLE = 0.9
"""Planned pushes meet this middle fraction of an edge, because near a corner the tip slips off."""

LIKELY_MU = 0.3
"""A mu_c that most materials are near, as long as nothing is known of it."""

NEGLIGIBLE = 1e-9
"""Parts smaller than this fraction of the region are no longer planned for."""


class RankedPush(NamedTuple):
    """A test push, and how far it is expected to shrink the region."""

    push: PlannedPush
    expected_area: float  # of the region after the push, if p_CF is equally likely anywhere in the present region [m^2]


def next_pushes(half_planes: HalfPlanes) -> list[RankedPush]:
    """For each edge, the perpendicular push that shrinks the region most, best first.

    At best, a push halves the region. An edge that no straight push reaches is left out. The list is empty once the region has
    collapsed.

    Example:
        >>> from pushfric_core import HalfPlanes, Outline, next_pushes
        >>> pushes = next_pushes(HalfPlanes(Outline.rectangle(0.12, 0.06)))
        >>> len(pushes)
        4
    """
    return _ranked(half_planes.outline, half_planes.margin, _whole(half_planes))


def slip_pushes(outline: Outline, center: npt.ArrayLike) -> list[PlannedPush]:
    """For each edge, a push to either side that slips, best first: from it, mu_c gets a value (section 5.1.3).

    A slipping tip pushes along an edge of its friction cone. If that line passes p_CF, the object hardly turns: its centre of
    rotation is far from every support, so the direction of each support's friction is known. The best pushes come nearest to
    that, for a mu_c of LIKELY_MU, and leave the tip most room to slide.

    Args:
        outline: of the object.
        center: p_CF (2,), as far as it is known [m].

    Example:
        >>> from pushfric_core import Outline, slip_pushes
        >>> slip_pushes(Outline.rectangle(0.12, 0.06), (0.0, 0.0))[0].edge
        0
    """
    found: list[tuple[float, float, PlannedPush]] = []
    for edge, (vertex, vector) in enumerate(zip(outline.vertices, outline.edges, strict=True)):
        length = float(outline.lengths[edge])
        reach, along = USABLE * length / 2, vector / length
        way = np.asarray(center) - (vertex + vector / 2)
        for side in (-1, 1):
            wanted = float(way @ along + side * LIKELY_MU * (way @ left_of(along)))
            offset = round(min(max(wanted, -reach), reach), 6) + 0.0  # never -0.0
            push = PlannedPush(edge, offset, side * SHARP)
            if _reached(outline, push):
                found.append((round(abs(wanted - offset), 6), -round(reach + side * offset, 6), push))
    return [push for *_, push in sorted(found)]


def planned_pushes(half_planes: HalfPlanes, count: int) -> list[RankedPush]:
    """Pushes to be carried out without looking at their outcomes, in the order that shrinks the region fastest.

    Their lines cut the region into parts, and the outcomes leave one of them. Each push is the one after which, together with
    all pushes before it, the expected area is least. If you can look at each outcome, `next_pushes` does better. Once the
    region has collapsed, there are no pushes.

    Args:
        half_planes: what is known before the first push.
        count: number of pushes, >= 1.
    Raises:
        ValueError: count < 1.
    """
    if count < 1:
        raise ValueError(f"count must be at least 1, got {count}")
    outline, margin, parts = half_planes.outline, half_planes.margin, _whole(half_planes)
    planned: list[RankedPush] = []
    while len(planned) < count and (ranked := _ranked(outline, margin, parts)):
        planned.append(ranked[0])
        parts = parts.split(_left_of_push(outline, ranked[0].push), margin)
    return planned


class _Parts(NamedTuple):
    """The parts into which the lines of some pushes cut the region."""

    cells: Array  # (k,) polygons, one of which contains p_CF
    left: Array  # (k,) polygons that the outcomes leave if p_CF is in the cell: the cell, widened by the margin

    @property
    def expected_area(self) -> float:
        """Expected area of what is left, if p_CF is equally likely anywhere in the cells [m^2]."""
        chances = shapely.area(self.cells)
        return float(chances @ shapely.area(self.left) / chances.sum())

    def split(self, half_plane: HalfPlane, margin: float) -> "_Parts":
        """The parts after one more push, whose outcome says on which side of the boundary of a half-plane p_CF lies."""
        sides = half_plane, half_plane.opposite
        cells = np.concatenate([cut(self.cells, side) for side in sides])
        left = np.concatenate([cut(self.left, side.widened(margin)) for side in sides])
        areas = shapely.area(cells)
        kept = areas > NEGLIGIBLE * areas.sum()
        return _Parts(cells[kept], left[kept])


def _whole(half_planes: HalfPlanes) -> _Parts:
    region = np.array([polygon for polygon in (half_planes.polygon,) if polygon.area > 0])
    return _Parts(region, region)


def _ranked(outline: Outline, margin: float, parts: _Parts) -> list[RankedPush]:
    """The best push against each edge, best first."""
    total = float(np.sum(shapely.area(parts.cells)))

    def rank(one: RankedPush) -> float:
        # areas that differ only by rounding count as equal, in the order given
        return round(one.expected_area / total, 12)

    best = []
    for edge in range(len(outline.vertices)):
        pushes = (PlannedPush(edge, offset) for offset in _offsets(outline, edge, parts.cells))
        ranked = [
            RankedPush(push, parts.split(_left_of_push(outline, push), margin).expected_area)
            for push in pushes
            if _reached(outline, push)
        ]
        best += sorted(ranked, key=rank)[:1]
    return sorted(best, key=rank)


def _offsets(outline: Outline, edge: int, cells: Array) -> list[float]:
    """Where pushes against an edge halve one of the cells, or nearly, in order along the edge."""
    along = outline.edges[edge] / outline.lengths[edge]
    middle = float((outline.vertices[edge] + outline.edges[edge] / 2) @ along)
    reach = USABLE * float(outline.lengths[edge]) / 2
    offsets = (min(max(_halving(cell, along) - middle, -reach), reach) for cell in cells)
    # an object cannot be placed more precisely than to a micrometre; never at -0.0
    return sorted({round(offset, 6) + 0.0 for offset in offsets})


def _reached(outline: Outline, push: PlannedPush) -> bool:
    """Whether a tip that comes straight from outside meets the planned edge first."""
    point, direction = planned_contact(outline, push)
    touch = outline.first_touch(point - outline.perimeter * direction, direction)
    return touch is not None and touch.edge == push.edge


def _left_of_push(outline: Outline, push: PlannedPush) -> HalfPlane:
    return left_of_line(*planned_contact(outline, push))


def _halving(polygon: shapely.Polygon, along: Array) -> float:
    """Where on an axis, a unit vector (2,), the line across it halves a convex polygon."""
    corners = shapely.get_coordinates(polygon)
    middle = corners.mean(axis=0)
    corners = corners - middle
    places, heights = corners @ along, corners @ left_of(along)

    def area_up_to(ends: Array) -> Array:
        """Area of the parts on this side of lines across (k,): the integral of height along each edge, as far as a line."""
        reached = np.minimum(places, ends[:, None])
        slopes = np.diff(heights) / np.where(np.diff(places) == 0, 1.0, np.diff(places))
        means = heights[:-1] + slopes * ((reached[:, :-1] + reached[:, 1:]) / 2 - places[:-1])
        return np.asarray(np.abs(np.sum(means * np.diff(reached), axis=1)))

    ends = np.sort(places)
    areas = area_up_to(ends)
    half = float(areas[-1]) / 2
    after = int(np.searchsorted(areas, half))
    # the area grows with the square of the place from one corner to the next
    low, high = ends[after - 1 : after + 1].tolist()
    first, between, last = area_up_to(np.array((low, (low + high) / 2, high))).tolist()
    bend = 2 * (first + last - 2 * between)
    rise, missing = last - first - bend, half - first
    share = 2 * missing / (rise + math.sqrt(max(rise * rise + 4 * bend * missing, 0.0)))
    return float(low + share * (high - low) + middle @ along)
