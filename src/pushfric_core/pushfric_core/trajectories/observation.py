"""The observation: one contact and one instantaneous motion of the pushed object (section 3)."""

import math
from dataclasses import dataclass
from numbers import Integral
from typing import Any

import numpy as np

from pushfric_core.errors import UninformativePush, blaming
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import UNIT, Array, Pose, Twist, check_unit
from pushfric_core.plausible import FARTHEST, FASTEST, FASTEST_TURN, LARGEST, LONGEST, STRONGEST, check_within, other_unit

Vector = tuple[float, float]

SLOWEST = 1e-100
"""The largest component of a twist lies between this and its inverse; beyond, the computation would under- or overflow."""

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
        push_id: number of the push that the observation belongs to.
        half_width: half the interval of possible contact points along the edge [m].
        duration: time between the two smoothed poses that were differenced [s]; None if unknown.
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

    Example:
        >>> from pushfric_core import Observation, Twist
        >>> observation = Observation((0.01, -0.03), (0.0, -1.0), Twist(0.0, 0.02, 0.1), push_id=3)
        >>> observation.twist.omega, observation.force is None
        (0.1, True)
    """

    contact_point: Vector
    contact_normal: Vector
    twist: Twist
    push_id: int = 0
    half_width: float = 0.0
    duration: float | None = None
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
            if value is not None and not _finite(*value):
                raise ValueError(f"{name} must be finite, got {tuple(value)}")
        for name in ("push_id", "stamp"):
            if not isinstance(getattr(self, name), Integral):
                raise ValueError(f"{name} must be an integer, got {getattr(self, name)!r}")
        if not 0 <= self.push_id < PUSH_IDS:
            raise ValueError(f"push_id must lie in [0, {PUSH_IDS}), got {self.push_id}")
        for name, limit, unit in (("contact_point", FARTHEST, "m"), ("pose", FARTHEST, "m"), ("force", STRONGEST, "N")):
            value = getattr(self, name)
            if value is not None:
                check_within(name, value[:2], limit, unit)
        if self.depth is not None:
            if not _finite(self.depth):
                raise ValueError(f"depth must be a finite number, got {self.depth!r}")
            check_within("depth", (self.depth,), FARTHEST, "m")
        length = math.hypot(*self.contact_normal)
        if abs(length - 1) > UNIT:
            raise ValueError(f"contact_normal must have length 1, got {self.contact_normal} of length {length:.4g}")
        duration = 0.0 if self.duration is None else self.duration
        for name, value, longest, unit in (("half_width", self.half_width, LARGEST, "m"), ("duration", duration, LONGEST, "s")):
            if not (_finite(value) and value >= 0):
                raise ValueError(f"{name} must be at least 0 and finite, got {value!r}")
            check_within(name, (value,), longest, unit)
        if any(self.twist) and not SLOWEST < max(map(abs, self.twist)) < 1 / SLOWEST:
            raise ValueError(
                f"the twist must have a size between {SLOWEST:g} and {1 / SLOWEST:g}, got {tuple(map(float, self.twist))}"
            )
        if not any(self.twist):
            raise UninformativePush("the twist of an observation must not be zero: the object did not move")

    def check_contact(self, outline: Outline) -> None:
        """Refuse a contact that is not on the object, and a motion that nothing makes, which is likely to be in other units.

        Raises:
            ValueError: the contact is farther than OFF_OUTLINE from the outline, its interval is longer than the object, or a
                velocity is larger than FASTEST or FASTEST_TURN.
        """
        _check_on(outline, "contact_point", self.contact_point)
        check_half_width(outline, self.half_width)
        check_within("the twist", self.twist[:2], FASTEST, "m/s")
        check_within("omega", self.twist[2:], FASTEST_TURN, "rad/s")
        check_within("tip_velocity", self.tip_velocity or (), FASTEST, "m/s")


def check_planned_contact(outline: Outline, point: Vector, normal: Vector) -> None:
    """Refuse a contact in a question unless it lies on the object and its normal points away from the object.

    Raises:
        ValueError: it is farther than OFF_OUTLINE from the outline, or the normal is not unit, or points inward.
    """
    check_unit("the normal", normal)
    _check_on(outline, "the contact", point)
    if not outline.outward(point, normal, OFF_OUTLINE):
        raise ValueError(f"the normal must point outward, away from the object, got ({normal[0]:g}, {normal[1]:g})")


def check_planned_contacts(outline: Outline, points: Array, normals: Array, first: int = 0) -> None:
    """Refuse contacts (k, 2) with normals (k, 2) as `check_planned_contact` does; they are counted from `first` on."""
    good = np.abs(np.hypot(normals[:, 0], normals[:, 1]) - 1) <= UNIT
    good &= outline.distances_to(points) <= OFF_OUTLINE
    good &= outline.outward(points, normals, OFF_OUTLINE)
    for number in np.flatnonzero(~good).tolist():
        with blaming(f"contact {first + number}", error=ValueError):
            check_planned_contact(outline, tuple(points[number].tolist()), tuple(normals[number].tolist()))


def check_half_width(outline: Outline, half_width: float) -> None:
    """Refuse half a contact interval that is negative, or longer than the object. Raises ValueError."""
    if not half_width >= 0:
        raise ValueError(f"half_width must be at least 0, got {half_width:g}")
    longest = float(max(outline.size))
    if half_width > longest:
        asked = other_unit("m", lambda factor: half_width * factor <= longest)
        raise ValueError(f"half_width must be at most {longest:g} m, the length of the object, got {half_width:g}{asked}")


def _check_on(outline: Outline, what: str, point: Vector) -> None:
    distance = outline.distance_to(point)
    if not distance <= OFF_OUTLINE:
        x, y = point
        asked = other_unit("m", lambda factor: outline.distance_to((x * factor, y * factor)) <= OFF_OUTLINE)
        expected = f"{what} must be within {OFF_OUTLINE * 1e3:g} mm of the outline"
        raise ValueError(f"{expected}, got ({x:g}, {y:g}) m, {distance:.3g} m away{asked}")


def _finite(*values: Any) -> bool:
    """Whether these are finite numbers; texts, which `float` would take, are none."""
    try:
        return all(map(math.isfinite, values))
    except TypeError:
        return False


def _vector(name: str, value: Any) -> Vector:
    """Two finite numbers, from any sequence of them."""
    try:
        x, y = value
        finite = math.isfinite(x) and math.isfinite(y)  # which takes no texts, as float does
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be two numbers, got {value!r}") from None
    if not finite:
        raise ValueError(f"{name} must be finite, got {(float(x), float(y))}")
    return float(x), float(y)
