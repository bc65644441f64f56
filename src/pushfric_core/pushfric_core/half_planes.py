"""The centre of friction from test pushes, without support points: each push bounds it by a half-plane (section 6.2).

While the object turns counter-clockwise, p_CF lies to the left of three directed lines through the contact, and while it turns
clockwise to their right: of the line along which the contact moves, the line along which the pusher moves, and the line of the
pusher's force. Where it does not turn, p_CF lies on each of them. The first holds always; the functions say when the others do.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import shapely

from pushfric_core.constraints import ConstraintRows
from pushfric_core.contact import friction_cone
from pushfric_core.errors import UninformativePush
from pushfric_core.linear_program import Status
from pushfric_core.observation import Observation
from pushfric_core.outline import Outline
from pushfric_core.planar import Array, left_of, rotation, velocity_at
from pushfric_core.push_plan import PlannedPush
from pushfric_core.simplex import Simplex

SLACK = 1e-9
"""Half-planes are cut this far outside their boundary [m]: a region that is a mere line or point keeps an interior."""


class HalfPlane(NamedTuple):
    """The points p with normal . p >= offset."""

    normal: tuple[float, float]  # unit, into the half-plane
    offset: float  # [m]


def line_of_motion(observation: Observation) -> tuple[HalfPlane, ...]:
    """p_CF and the centre of rotation lie on the same side of the line along which the contact moves, in any push.

    Mason's theorem 2, as cited in section 6.2.

    Returns:
        The half-plane of p_CF, object frame; for a translation two, whose common boundary it lies on.
    Raises:
        UninformativePush: the object turned about the contact, which does not move.
    """
    velocity = velocity_at(observation.twist, observation.contact_point)
    if not velocity.any():
        raise UninformativePush("the object turned about its contact, whose line of motion is therefore not known")
    return _sides(observation, velocity, velocity)


def line_of_pushing(observation: Observation, direction: npt.ArrayLike) -> tuple[HalfPlane, ...]:
    """p_CF and the centre of rotation lie on the same side of the line along which the pusher moves.

    This holds where the pusher moves opposite to n (Mason's theorem 4, as cited in section 6.2), and more generally within the
    friction cone, whether the contact sticks or slides. p_CF must lie to the inside of the edge that is pushed, as it always
    does where the outline is convex.

    Args:
        observation: contact and twist, object frame.
        direction: (2,) of the pusher's motion, object frame, of any length.
    Returns:
        As `line_of_motion`.
    Raises:
        ValueError: the pusher does not move into the object.
    """
    direction = np.asarray(direction, dtype=float)
    if direction.shape != (2,) or not direction @ observation.contact_normal < 0:
        raise ValueError(f"direction must be (2,) and point into the object, got {direction}")
    return _sides(observation, direction, direction)


def line_of_force(observation: Observation, mu_bound: float) -> tuple[HalfPlane, ...]:
    """The object turns the way the pusher's force turns it about p_CF, and the force lies in the friction cone (eqs 9, 10).

    Not knowing the force, p_CF lies on the right side of at least one edge of the cone. A contact without friction, mu_bound =
    0, gives the line of the normal. p_CF must lie to the inside of the edge that is pushed, as for `line_of_pushing`.

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
    """The left side of one line through the contact where the object turns counter-clockwise, the right side of the other
    where clockwise, both where it does not turn."""
    omega = observation.twist.omega
    sides = []
    if omega >= 0:
        sides.append(_left_of_line(observation.contact_point, counterclockwise))
    if omega <= 0:
        sides.append(_left_of_line(observation.contact_point, -clockwise))
    return tuple(sides)


def _left_of_line(point: npt.ArrayLike, direction: Array) -> HalfPlane:
    x, y = left_of(direction) / np.hypot(*direction)
    return HalfPlane((float(x), float(y)), float((x, y) @ np.asarray(point)))


@dataclass(frozen=True)
class Region:
    """Where p_CF can lie after some test pushes, object frame.

    Attributes:
        polygon: convex; empty where the half-planes contradict each other.
        center: (2,) the centroid of the polygon; without one, the point that violates the half-planes least [m].
        violation: how far that point lies outside of them, summed [m]; 0 where there is a polygon.
        status: OPTIMAL unless the least violation could not be certified.
    """

    polygon: shapely.Polygon
    center: Array
    violation: float = 0.0
    status: Status = Status.OPTIMAL

    @property
    def area(self) -> float:
        """[m^2]"""
        return float(self.polygon.area)


class HalfPlanes:
    """Narrows down p_CF within the convex hull of an outline, one push after the other.

    Args:
        outline: of the object; its supports lie inside.
    """

    def __init__(self, outline: Outline) -> None:
        self._polygon = shapely.convex_hull(outline.polygon)
        self._corners = shapely.get_coordinates(self._polygon)[:-1]
        # p_CF as a convex combination of the corners: they take the place of the support points
        self._program = Simplex(len(self._corners))

    def add(self, half_planes: Iterable[HalfPlane]) -> Region:
        """Take the half-planes of a data point; from the moment they contradict the others, the region stays empty."""
        for half_plane in half_planes:
            self._polygon = _cut(self._polygon, half_plane)
            depths = self._corners @ half_plane.normal - half_plane.offset
            self._program.add(ConstraintRows(depths[None], np.zeros(1), np.ones(1)))
        return self.region()

    def region(self) -> Region:
        """What is known now; before the first push, the convex hull of the outline.

        The sum of violations is least by the same linear program that estimates w (sections 6.2 and 3.3).
        """
        if self._polygon.area > 0:
            return Region(self._polygon, shapely.get_coordinates(self._polygon.centroid)[0])
        optimum = self._program.solve()
        return Region(shapely.Polygon(), optimum.w @ self._corners, optimum.objective, optimum.status)


class RankedPush(NamedTuple):
    """A test push and what it promises."""

    push: PlannedPush
    expected_area: float  # of the region after it, were p_CF equally likely anywhere in the present one [m^2]


def rank_pushes(region: Region, outline: Outline, candidates: Iterable[PlannedPush]) -> list[RankedPush]:
    """Which push will shrink the region most, best first (section 6.2).

    The line along which the pusher will move cuts the region in two, of which the sense of rotation leaves one: at best, half.
    So it is for pushes within the friction cone (see `line_of_pushing`); candidates at other angles promise too much.

    Raises:
        ValueError: the region is empty, or a candidate's edge does not exist.
    """
    if not region.area > 0:
        raise ValueError("the region must have an area for a push to shrink: its half-planes contradict each other")
    ranked = []
    for push in candidates:
        if not 0 <= push.edge < len(outline.vertices):
            raise ValueError(f"edge must lie in [0, {len(outline.vertices) - 1}], got {push.edge}")
        contact = outline.vertices[push.edge] + outline.edges[push.edge] * (0.5 + push.offset / outline.lengths[push.edge])
        direction = rotation(push.angle) @ -outline.normals[push.edge]
        left = float(_cut(region.polygon, _left_of_line(contact, direction)).area) / region.area
        ranked.append(RankedPush(push, (left**2 + (1 - left) ** 2) * region.area))
    return sorted(ranked, key=lambda one: one.expected_area)


def _cut(polygon: shapely.Polygon, half_plane: HalfPlane) -> shapely.Geometry:
    """The part of a polygon that lies in a half-plane."""
    if polygon.is_empty:
        return polygon
    normal = np.asarray(half_plane.normal)
    corners = shapely.get_coordinates(polygon)
    middle = corners.mean(axis=0)
    reach = 2 * float(np.ptp(corners, axis=0).sum()) + abs(float(middle @ normal) - half_plane.offset) + SLACK
    boundary = middle + (half_plane.offset - SLACK - middle @ normal) * normal
    along, inward = reach * left_of(normal), reach * normal
    box = shapely.Polygon((boundary - along, boundary + along, boundary + along + inward, boundary - along + inward))
    return shapely.intersection(polygon, box)
