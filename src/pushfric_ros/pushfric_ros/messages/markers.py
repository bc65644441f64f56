"""An estimate as markers on the object for RViz and Foxglove, without rclpy."""

import math
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from pushfric_core.estimation.push_plan import PlannedPush, planned_contact
from pushfric_core.geometry.contact import friction_cone, tangent
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array
from pushfric_core.trajectories.observation import Observation
from pushfric_msgs.msg import CenterOfFrictionRegion, ContactFriction, FrictionEstimate

WHITE = ColorRGBA(r=0.9, g=0.9, b=0.9, a=1.0)
GREY = ColorRGBA(r=0.6, g=0.6, b=0.6, a=1.0)
BLUE = ColorRGBA(r=0.15, g=0.4, b=0.75, a=0.8)
RED = ColorRGBA(r=0.8, g=0.25, b=0.05, a=1.0)
GREEN = ColorRGBA(r=0.2, g=0.6, b=0.3, a=1.0)
YELLOW = ColorRGBA(r=0.85, g=0.65, b=0.1, a=1.0)

DISC_SHARE = 0.1
"""Area of the discs of all support points together, as a fraction of the outline's area."""

STEEPEST = 1e3
"""Larger values of mu_c are drawn as this one, whose friction cone is almost the half-plane."""

LINE, DOT, SYMBOL, TEXT = 0.008, 0.01, 0.06, 0.08  # sizes as fractions of the outline's diameter
CIRCLE = 36  # number of corners of a circle


def center_of_friction_from(estimate: FrictionEstimate) -> tuple[float, float]:
    """The belief's p_CF [m]; that of the program as long as nothing is believed."""
    believed = not math.isnan(estimate.confidence)
    point = estimate.spread.center_of_friction if believed else estimate.center_of_friction
    return point.x, point.y


def estimate_to_markers(estimate: FrictionEstimate, outline: Outline, newest: Observation) -> MarkerArray:
    """The object with everything known about its friction, in the object frame; it replaces all markers published before.

    The namespaces are: outline; support_points; support_friction, discs with an area proportional to w; center_of_friction;
    confidence, if it was computed; contact, contact_normal and friction_cone (the pusher's forces that mu_c, 90 %, allows) at
    the newest observation; slip, whether its tip slides along the edge; and mu_c, a text.

    Args:
        estimate: from at least one observation.
        outline: of the object.
        newest: its last observation.
    """
    size = float(np.hypot(*outline.size))
    points = np.array([(point.x, point.y) for point in estimate.support_friction.support_points])
    center = center_of_friction_from(estimate)
    friction = estimate.contact_friction
    contact, normal = np.asarray(newest.contact_point), np.asarray(newest.contact_normal)
    reach = 2 * SYMBOL * size
    edges = friction_cone(normal, min(friction.p90, STEEPEST))
    above = outline.lower + outline.size * (0.5, 1.0) + (0.0, TEXT * size)
    words = f"{estimate.object}: mu_c bounds {friction.p90:.2f} (90 %), {friction.max:.2f} (100 %)"
    markers = [
        _line("outline", (*outline.vertices, outline.vertices[0]), LINE * size, WHITE),
        Marker(ns="support_points", type=Marker.SPHERE_LIST, points=_points(points), scale=_cube(DOT * size), color=GREY),
        *_discs(points, estimate.support_friction.weights, DISC_SHARE * outline.polygon.area, DOT * size),
        _at("center_of_friction", Marker.SPHERE, center, _cube(3 * DOT * size), RED),
        _at("contact", Marker.SPHERE, contact, _cube(2 * DOT * size), GREEN),
        _arrow("contact_normal", (contact, contact + SYMBOL * size * normal), size, GREEN),
        *_slip(friction.slip, contact, normal, size),
        _line("friction_cone", (contact + reach * edges[0], contact, contact + reach * edges[1]), LINE * size, GREEN),
        _at("mu_c", Marker.TEXT_VIEW_FACING, above, Vector3(z=TEXT * size), WHITE, text=words),
    ]
    if not math.isnan(estimate.confidence):
        markers.append(_line("confidence", _circle(center, estimate.confidence), LINE * size, RED))
    return MarkerArray(markers=[Marker(header=estimate.header, action=Marker.DELETEALL), *_on_object(markers, estimate.header)])


def region_to_markers(region: CenterOfFrictionRegion, outline: Outline) -> list[Marker]:
    """The region in which p_CF can lie, and the push that would shrink it most, to be shown with the markers of an estimate.

    The namespaces are: center_of_friction_region, its border; and next_push, an arrow that ends at the contact. Once the region
    has collapsed, there are no such markers.

    Args:
        region: of the object.
        outline: of the object.
    """
    size = float(np.hypot(*outline.size))
    corners = [(point.x, point.y) for point in region.polygon.polygon.points]
    markers = [_line("center_of_friction_region", [*corners, corners[0]], LINE * size, YELLOW)] if corners else []
    for push in region.next_pushes[:1]:
        contact, direction = planned_contact(outline, PlannedPush(push.edge, push.offset, push.angle))
        markers.append(_arrow("next_push", (contact - 2 * SYMBOL * size * direction, contact), size, YELLOW))
    return _on_object(markers, region.header)


def _on_object(markers: list[Marker], header: Header) -> list[Marker]:
    for marker in markers:
        marker.header = header
        marker.frame_locked = True  # so that a viewer moves them with the object, which moves on after the observation
    return markers


def _slip(state: int, contact: Array, normal: Array, size: float) -> list[Marker]:
    """An arrow along the edge if the tip slides, a dot if it sticks; nothing if that is not known."""
    if state == ContactFriction.SLIP_STICKING:
        return [_at("slip", Marker.SPHERE, contact, _cube(3 * DOT * size), YELLOW)]
    if state in (ContactFriction.SLIP_LEFT, ContactFriction.SLIP_RIGHT):
        along = tangent(normal) * (1 if state == ContactFriction.SLIP_LEFT else -1)
        return [_arrow("slip", (contact, contact + SYMBOL * size * along), size, YELLOW)]
    return []


def _discs(points: Array, weights: Iterable[float], area: float, smallest: float) -> list[Marker]:
    """A flat cylinder for each support point (n, 2) whose share of the area [m^2] is at least as large as its dot."""
    diameters = np.sqrt(np.asarray(weights) * area * 4 / math.pi)
    shown = [(j, Vector3(x=size, y=size, z=smallest / 2)) for j, size in enumerate(diameters.tolist()) if size > smallest]
    return [_at("support_friction", Marker.CYLINDER, points[j], size, BLUE, j) for j, size in shown]


def _at(
    namespace: str, kind: int, place: npt.ArrayLike, scale: Vector3, color: ColorRGBA, number: int = 0, text: str = ""
) -> Marker:
    marker = Marker(ns=namespace, id=number, type=kind, scale=scale, color=color, text=text)
    (marker.pose.position,) = _points(np.reshape(place, (1, 2)))
    return marker


def _arrow(namespace: str, ends: npt.ArrayLike, size: float, color: ColorRGBA) -> Marker:
    """An arrow from the first of its ends (2, 2) to the second, on an object of this diameter [m]."""
    scale = Vector3(x=LINE * size, y=3 * LINE * size)
    return Marker(ns=namespace, type=Marker.ARROW, points=_points(ends), scale=scale, color=color)


def _line(namespace: str, course: npt.ArrayLike, width: float, color: ColorRGBA) -> Marker:
    return Marker(ns=namespace, type=Marker.LINE_STRIP, points=_points(course), scale=Vector3(x=width), color=color)


def _circle(center: npt.ArrayLike, radius: float) -> Array:
    angles = np.linspace(0, 2 * math.pi, CIRCLE + 1)
    return np.asarray(center) + radius * np.column_stack((np.cos(angles), np.sin(angles)))


def _points(xy: npt.ArrayLike) -> list[Point]:
    return [Point(x=float(x), y=float(y)) for x, y in np.asarray(xy)]


def _cube(side: float) -> Vector3:
    return Vector3(x=side, y=side, z=side)
