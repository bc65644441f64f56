"""The centre of friction from test pushes, without support points: each push bounds it by a half-plane (section 6.2).

There are three directed lines through the contact: the line along which the contact moves, the line along which the pusher
moves, and the line of the pusher's force. If the object turns counter-clockwise, p_CF lies to the left of them; if it turns
clockwise, to their right; if it does not turn, on each of them. This always holds for the first line; the functions say when it
holds for the others.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import shapely

from pushfric_core.errors import UninformativePush
from pushfric_core.geometry.contact import friction_cone
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, as_array, left_of, velocity_at
from pushfric_core.program.constraints import ConstraintRows
from pushfric_core.records import comparable
from pushfric_core.settings import Ranged, setting
from pushfric_core.solvers import empty_program
from pushfric_core.solvers.program import Program, Status
from pushfric_core.trajectories.observation import Observation

SLACK = 1e-9
"""Half-planes are cut this far outside their boundary [m], so that a region of a mere line or point keeps an interior."""


@dataclass(frozen=True)
class RegionConfig(Ranged):
    """How far the half-planes from measured observations are trusted."""

    region_margin: float = setting(
        0.002, "margin of the half-planes that bound the region of p_CF [m]; 0: as in the paper", 0.0, 0.1
    )


class HalfPlane(NamedTuple):
    """The points p with normal . p >= offset."""

    normal: tuple[float, float]  # unit, into the half-plane
    offset: float  # [m]

    @property
    def opposite(self) -> HalfPlane:
        """The half-plane on the other side of the boundary."""
        (x, y), offset = self
        return HalfPlane((-x, -y), -offset)

    def widened(self, margin: float) -> HalfPlane:
        """The half-plane with its boundary moved outwards by a margin [m]."""
        return self._replace(offset=self.offset - margin)


def line_of_motion(observation: Observation) -> tuple[HalfPlane, ...]:
    """p_CF and the centre of rotation lie on the same side of the line along which the contact moves, in any push.

    Mason's theorem 2, as cited in section 6.2.

    Returns:
        The half-plane of p_CF, object frame; for a translation two, with p_CF on their common boundary.
    Raises:
        UninformativePush: the object turned about the contact, which does not move.
    """
    velocity = velocity_at(observation.twist, observation.contact_point)
    if not velocity.any():
        raise UninformativePush("the object turned about its contact, whose line of motion is therefore not known")
    return _sides(observation, velocity, velocity)


def line_of_pushing(observation: Observation, direction: npt.ArrayLike) -> tuple[HalfPlane, ...]:
    """p_CF and the centre of rotation lie on the same side of the line along which the pusher moves.

    This holds if the pusher moves opposite to n (Mason's theorem 4, as cited in section 6.2), and more generally if it moves
    within the friction cone, whether the contact sticks or slides. p_CF must lie on the inner side of the edge that is pushed,
    which is always so if the outline is convex.

    Args:
        observation: contact and twist, object frame.
        direction: (2,) of the pusher's motion, object frame, of any length.
    Returns:
        As for `line_of_motion`.
    Raises:
        ValueError: the pusher does not move into the object.
    """
    direction = as_array(direction)
    if direction.shape != (2,) or not direction @ observation.contact_normal < 0:
        raise ValueError(f"direction must be (2,) and point into the object, got {direction}")
    return _sides(observation, direction, direction)


def line_of_force(observation: Observation, mu_bound: float) -> tuple[HalfPlane, ...]:
    """The object turns the way the pusher's force turns it about p_CF, and the force lies in the friction cone (eqs 9, 10).

    The force itself is not known, but p_CF lies on the correct side of at least one edge of the cone. A contact without
    friction, mu_bound = 0, gives the line of the normal. p_CF must lie on the inner side of the edge that is pushed, as for
    `line_of_pushing`.

    Args:
        observation: contact, normal and twist, object frame.
        mu_bound: known upper bound on mu_c, >= 0.
    Returns:
        The half-plane of p_CF, object frame; for a translation two, which leave the friction cone.
    Raises:
        ValueError: mu_bound is negative or not finite.
    """
    if not 0 <= mu_bound < np.inf:
        raise ValueError(f"mu_bound must be at least 0 and finite, got {mu_bound}")
    left, right = friction_cone(observation.contact_normal, mu_bound)  # as seen by the pusher
    return _sides(observation, right, left)


def _sides(observation: Observation, counterclockwise: Array, clockwise: Array) -> tuple[HalfPlane, ...]:
    """The left side of one line through the contact if the object turns counter-clockwise, the right side of the other if it
    turns clockwise, and both if it does not turn."""
    omega = observation.twist.omega
    sides = []
    if omega >= 0:
        sides.append(left_of_line(observation.contact_point, counterclockwise))
    if omega <= 0:
        sides.append(left_of_line(observation.contact_point, -clockwise))
    return tuple(sides)


def left_of_line(point: npt.ArrayLike, direction: npt.ArrayLike) -> HalfPlane:
    """The half-plane to the left of the line through a point (2,) along a direction (2,) of any length."""
    direction = as_array(direction)
    x, y = left_of(direction) / np.hypot(*direction)
    return HalfPlane((float(x), float(y)), float((x, y) @ as_array(point)))


@comparable
@dataclass(frozen=True)
class Region:
    """Where p_CF can lie after some test pushes, object frame.

    Attributes:
        polygon: convex; empty if the half-planes contradict each other, even with their margin.
        center: (2,) the centroid of the polygon; without one, the point that violates the half-planes least [m].
        violation: how far that point lies outside of them, summed, without a margin [m]; 0 if there is a polygon.
        status: OPTIMAL unless the least violation could not be certified.

    Example:
        >>> from pushfric_core import HalfPlanes, Outline
        >>> region = HalfPlanes(Outline.rectangle(0.12, 0.06)).region()
        >>> round(region.area, 4), len(region.corners), region.collapsed
        (0.0072, 4, False)
    """

    polygon: shapely.Polygon
    center: Array
    violation: float = 0.0
    status: Status = Status.OPTIMAL

    @property
    def area(self) -> float:
        """Area of the polygon [m^2]."""
        return float(self.polygon.area)

    @property
    def corners(self) -> Array:
        """Corners (k, 2) of the polygon [m], counter-clockwise; none if the half-planes contradict each other."""
        return np.asarray(shapely.get_coordinates(shapely.orient_polygons(self.polygon))[:-1])

    @property
    def collapsed(self) -> bool:
        """Whether the half-planes contradict each other."""
        return bool(self.polygon.is_empty)


class HalfPlanes:
    """Narrows down p_CF within the convex hull of an outline, one push after another.

    Args:
        outline: of the object; its supports lie inside.
        margin: by how much the half-planes are widened (see RegionConfig) [m]; by default 0, as in the paper.
    Attributes:
        polygon: the part of the convex hull that is left: convex, or without area if the half-planes contradict each other.
    Raises:
        ValueError: the margin is negative or not finite.

    Example:
        >>> from pushfric_core import HalfPlanes, Outline
        >>> half_planes = HalfPlanes(Outline.rectangle(0.12, 0.06))
        >>> round(half_planes.region().area, 4)
        0.0072
    """

    def __init__(self, outline: Outline, margin: float = 0.0) -> None:
        if not 0 <= margin < np.inf:
            raise ValueError(f"margin must be at least 0 and finite, got {margin}")
        self.outline, self.margin = outline, margin
        self.polygon = shapely.convex_hull(outline.polygon)
        self._corners = shapely.get_coordinates(self.polygon)[:-1]
        # p_CF as a convex combination of the corners, which take the place of support points; made when it is needed
        self._program: Program | None = None
        self._rows: list[ConstraintRows] = []  # rows that are not in the program yet

    def add(self, half_planes: Iterable[HalfPlane]) -> Region:
        """Take the half-planes of an observation; once they contradict the others, the region stays empty."""
        for half_plane in half_planes:
            widened = half_plane.widened(self.margin)
            if not _holds(self.polygon, widened):
                self.polygon = cut(self.polygon, widened)
            depths = self._corners @ as_array(half_plane.normal) - half_plane.offset
            self._rows.append(ConstraintRows(depths[None], np.zeros(1), np.ones(1)))
        return self.region()

    def region(self) -> Region:
        """The present region; before the first push, the convex hull of the outline.

        The linear program that estimates w also minimises the sum of violations (sections 6.2 and 3.3).
        """
        if self.polygon.area > 0:
            return Region(self.polygon, shapely.get_coordinates(self.polygon.centroid)[0])
        self._program = self._program or empty_program(len(self._corners))
        for rows in self._rows:
            self._program.add(rows)
        self._rows.clear()
        optimum = self._program.solve()
        return Region(shapely.Polygon(), optimum.w @ self._corners, optimum.objective, optimum.status)


def _holds(polygon: shapely.Polygon, half_plane: HalfPlane) -> bool:
    """Whether a half-plane holds all of a polygon: most observations of a push leave the region as it is."""
    return bool((shapely.get_coordinates(polygon) @ as_array(half_plane.normal) >= half_plane.offset - SLACK).all())


def cut(polygons: Any, half_plane: HalfPlane) -> Any:
    """The part of a polygon, or of each polygon in an array, that lies in a half-plane."""
    corners = shapely.get_coordinates(polygons)
    if not len(corners):
        return polygons
    normal = as_array(half_plane.normal)
    middle = corners.mean(axis=0)
    reach = 2 * float(np.ptp(corners, axis=0).sum()) + abs(float(middle @ normal) - half_plane.offset) + SLACK
    boundary = middle + (half_plane.offset - SLACK - middle @ normal) * normal
    along, inward = reach * left_of(normal), reach * normal
    box = shapely.Polygon((boundary - along, boundary + along, boundary + along + inward, boundary - along + inward))
    return shapely.intersection(polygons, box)
