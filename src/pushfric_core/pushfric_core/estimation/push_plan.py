"""Where an object is to be pushed, and how it must lie in front of the pusher for that."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pushfric_core.geometry.contact import PushingLine
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, Pose, as_array, rotation, wrap
from pushfric_core.plausible import other_unit

SHARP, SHARP_OFFSET = math.radians(55), 0.12
"""Pushes at this angle to the normal, this share of the edge from its middle, slip."""


class PlannedPush(NamedTuple):
    """A push against an edge of the outline."""

    edge: int  # index; edge i runs counter-clockwise from vertex i to vertex i + 1
    offset: float  # of the contact from the middle of the edge, along the edge [m]
    angle: float = 0.0  # of the push direction from the inward normal, counter-clockwise [rad]


def even_pushes(outline: Outline, counts: Sequence[int]) -> list[PlannedPush]:
    """Pushes equally spaced along each edge, perpendicular to it (section 5).

    Args:
        outline: of the object.
        counts: number of pushes for each edge.
    Raises:
        ValueError: not one count for each edge, or a negative count.
    """
    if len(counts) != len(outline.vertices) or min(counts) < 0:
        raise ValueError(f"expected {len(outline.vertices)} counts, one for each edge, none negative; got {tuple(counts)}")
    return [
        PlannedPush(edge, ((index + 1) / (count + 1) - 0.5) * float(outline.lengths[edge]))
        for edge, count in enumerate(counts)
        for index in range(count)
    ]


def slipping_pushes(outline: Outline, edges: Sequence[int]) -> list[PlannedPush]:
    """Four pushes at a sharp angle for each two edges: either way, on either side of the middle. They slip (section 5.1.3)."""
    return [
        PlannedPush(edge, side * SHARP_OFFSET * float(outline.lengths[edge]), side * SHARP)
        for edge in edges
        for side in (-1, 1)
    ]


def planned_contact(outline: Outline, push: PlannedPush) -> tuple[Array, Array]:
    """The point (2,) of the outline that a push is to touch [m], and the unit vector (2,) of its direction; object frame."""
    along = 0.5 + push.offset / outline.lengths[push.edge]
    point = outline.vertices[push.edge] + along * outline.edges[push.edge]
    return point, rotation(push.angle) @ -outline.normals[push.edge]


def placement(outline: Outline, push: PlannedPush, line: PushingLine, position: float) -> Pose:
    """The pose in the table frame at which the tip, at stroke `position` [m], touches the planned point at the planned angle.

    Args:
        outline: of the object.
        push: which point is to be touched, and from which direction.
        line: on which the tip moves, table frame.
        position: of the tip along the line [m].
    Raises:
        ValueError: the outline has no such edge, the offset lies off it, or the push would come from inside.
    """
    if not 0 <= push.edge < len(outline.vertices):
        raise ValueError(f"edge must lie in [0, {len(outline.vertices) - 1}], got {push.edge}")
    half = float(outline.lengths[push.edge]) / 2
    if not abs(push.offset) < half:
        asked = other_unit("m", lambda factor: abs(push.offset * factor) < half)
        raise ValueError(f"offset must lie within {half:g} m of the middle of edge {push.edge}, got {push.offset:g} m{asked}")
    if not abs(push.angle) < np.pi / 2:
        raise ValueError(f"angle must lie within 90 degrees of the inward normal, got {np.rad2deg(push.angle):g} degrees")
    contact, direction = planned_contact(outline, push)
    theta = float(np.arctan2(line.direction[1], line.direction[0]) - np.arctan2(direction[1], direction[0]))
    tip = as_array(line.origin) + position * as_array(line.direction)
    x, y = tip - rotation(theta) @ (contact + line.tip_radius * outline.normals[push.edge])
    return Pose(float(x), float(y), wrap(theta))


def index_of(push_id: int, count: int) -> int:
    """The index of a push in a plan of `count` pushes: each time it is repeated, its id grows by the count."""
    return push_id % max(count, 1)


def number_of(push_id: int, count: int | None) -> str:
    """The number of a push for people: its place in a plan of `count` pushes, as 3, or 3 (again) when it is repeated; without a
    plan its id."""
    return f"{index_of(push_id, count) + 1}" + " (again)" * (push_id >= count) if count else f"{push_id}"


def purpose_of(outline: Outline, push: PlannedPush, chosen: bool) -> str:
    """The purpose of a push, in a sentence for people.

    Args:
        outline: of the object.
        push: the push.
        chosen: whether it was chosen from the region of p_CF.
    """
    off = push.offset * 1e3
    where = "at its middle" if abs(off) < 0.5 else f"{abs(off):.0f} mm {'after' if off > 0 else 'before'} its middle"
    slanting = f", at {abs(np.rad2deg(push.angle)):.0f} degrees to the perpendicular" if abs(push.angle) > 0.01 else ""
    slips = abs(push.angle) > SHARP - 1e-6
    shows = "shrinks the region of p_CF most" if chosen else "shows on which side of its force p_CF lies"
    what = "slips, which shows mu_c" if slips else shows
    return f"A push on side {push.edge + 1} of {len(outline.vertices)}, {where}{slanting}: it {what}."
