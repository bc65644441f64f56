"""The data point: one contact and one instantaneous motion of the pushed object (section 3)."""

import math
from dataclasses import dataclass
from numbers import Integral

from pushfric_core.errors import UninformativePush
from pushfric_core.outline import Outline
from pushfric_core.planar import FARTHEST, Pose, Twist

Vector = tuple[float, float]

UNIT = 1e-3
"""The length of a contact normal may differ from 1 by this much, because text files round."""


TINY = 1e-100
"""The largest component of a twist lies between this and its inverse; beyond, the computation would under- or overflow."""

STRONGEST = 1e9
"""No force is larger [N]."""

PUSH_IDS = 2**31
"""Push ids lie in [0, PUSH_IDS): messages carry them as int32."""

OFF_OUTLINE = 0.005
"""A contact may lie this far from the outline [m], because outlines and poses are measured."""


@dataclass(frozen=True)
class Observation:
    """Contact and motion, in the object frame.

    Args:
        contact_point: p_c [m].
        contact_normal: n, unit, outward.
        twist: velocity of the object-frame origin [m/s, m/s, rad/s]; only its direction matters.
        push_id: number of the push that the data point belongs to.
        half_width: half the interval of possible contact points along the edge [m].
        duration: time between the two smoothed poses that were differenced [s]; 0 if unknown.
        stamp: mean time of the images that were smoothed [ns]; 0 if unknown.
        pose: of the object in the table frame at the stamp; None if unknown.
        force: measured force of the pusher ON the object [N]; None without a force sensor.
        tip_velocity: of the pusher's tip over the table, in the object frame [m/s], in the unit of time of the twist; None
            if unknown.
        depth: how far the tip would be inside the outline, along -n [m]; an outline that is right makes it zero but for
            errors of the poses. None if unknown.
    Raises:
        ValueError: a value is not finite, beyond its limit or of another type; the normal does not have unit length; the
            half-width or the duration is negative.
        UninformativePush: the twist is zero.
    """

    contact_point: Vector
    contact_normal: Vector
    twist: Twist
    push_id: int = 0
    half_width: float = 0.0
    duration: float = 0.0
    stamp: int = 0
    pose: Pose | None = None
    force: Vector | None = None
    tip_velocity: Vector | None = None
    depth: float | None = None

    def __post_init__(self) -> None:
        for name in ("contact_point", "contact_normal", "force", "tip_velocity"):
            if name.startswith("contact") or getattr(self, name) is not None:
                object.__setattr__(self, name, _vector(name, getattr(self, name)))
        if not isinstance(self.twist, Twist):
            raise ValueError(f"twist must be a Twist(vx, vy, omega), got {self.twist!r}")
        if not isinstance(self.pose, Pose | None):
            raise ValueError(f"pose must be a Pose(x, y, theta) or None, got {self.pose!r}")
        for name in ("twist", "pose"):
            value = getattr(self, name)
            if value is not None and not all(map(math.isfinite, value)):
                raise ValueError(f"{name} must be finite, got {tuple(map(float, value))}")
        for name in ("push_id", "stamp"):
            if not isinstance(getattr(self, name), Integral):
                raise ValueError(f"{name} must be an integer, got {getattr(self, name)!r}")
        if not 0 <= self.push_id < PUSH_IDS:
            raise ValueError(f"push_id must lie in [0, {PUSH_IDS}), got {self.push_id}")
        for name, limit, unit in (("contact_point", FARTHEST, "m"), ("pose", FARTHEST, "m"), ("force", STRONGEST, "N")):
            value = getattr(self, name)
            if value is not None and max(map(abs, value[:2])) > limit:
                raise ValueError(f"{name} must lie within {limit:g} {unit}, got {tuple(map(float, value))}")
        if self.depth is not None and not abs(self.depth) <= FARTHEST:
            raise ValueError(f"depth must lie within {FARTHEST:g} m, got {self.depth}")
        length = math.hypot(*self.contact_normal)
        if abs(length - 1) > UNIT:
            raise ValueError(f"contact_normal must have length 1, got {self.contact_normal} of length {length:.4g}")
        for name in ("half_width", "duration"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be at least 0 and finite, got {getattr(self, name)}")
        if self.half_width > FARTHEST:
            raise ValueError(f"half_width must lie within {FARTHEST:g} m, got {self.half_width:g}")
        if any(self.twist) and not TINY < max(map(abs, self.twist)) < 1 / TINY:
            raise ValueError(
                f"the twist must have a size between {TINY:g} and {1 / TINY:g}, got {tuple(map(float, self.twist))}"
            )
        if not any(self.twist):
            raise UninformativePush("the twist of a data point must not be zero: the object did not move")

    def check_contact(self, outline: Outline) -> None:
        """Refuse a contact that is not on the object.

        Raises:
            ValueError: the contact is farther than OFF_OUTLINE from the outline.
        """
        distance = outline.distance_to(self.contact_point)
        if distance > OFF_OUTLINE:
            x, y = self.contact_point
            limit = f"{OFF_OUTLINE * 1e3:g} mm"
            raise ValueError(
                f"contact_point must be within {limit} of the outline, got ({x:g}, {y:g}) m, {distance:.3g} m away"
            )


def check_planned_contact(outline: Outline, point: Vector, normal: Vector) -> None:
    """Refuse a contact in a question unless it lies on the object and its normal points away from the object.

    Raises:
        ValueError: it is farther than OFF_OUTLINE from the outline, or the normal is not unit, or points inward.
    """
    x, y = normal
    if not abs(math.hypot(x, y) - 1) <= UNIT:
        raise ValueError(f"the normal must have length 1, got ({x:g}, {y:g})")
    if not (distance := outline.distance_to(point)) <= OFF_OUTLINE:
        expected = f"the contact must be within {OFF_OUTLINE * 1e3:g} mm of the outline"
        raise ValueError(f"{expected}, got ({point[0]:g}, {point[1]:g}) m, {distance:.3g} m away")
    if not outline.outward(point, normal, OFF_OUTLINE):
        raise ValueError(f"the normal must point outward, away from the object, got ({x:g}, {y:g})")


def _vector(name: str, value: object) -> Vector:
    """Two numbers, from any sequence of them."""
    try:
        x, y = map(float, value)  # type: ignore[call-overload]
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be two numbers, got {value!r}") from None
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ValueError(f"{name} must be finite, got {(x, y)}")
    return x, y
