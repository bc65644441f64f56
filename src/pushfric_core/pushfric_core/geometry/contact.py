"""The contact between pusher and object: point, normal, interval, friction cone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.outline import Outline, Touch
from pushfric_core.geometry.planar import UNIT, Array, Pose, as_array, check_unit, left_of, rotation


@dataclass(frozen=True, slots=True)
class PushingLine:
    """The straight line, fixed in the table frame, on which a round tip moves.

    Raises:
        ValueError: the origin or the radius is not finite, the direction has not length 1, or the radius is negative.

    Example:
        >>> from pushfric_core import Outline, Pose, PushingLine
        >>> line = PushingLine(origin=(0.0, -0.1), direction=(0.0, 1.0), tip_radius=0.003)
        >>> touch = line.touch(Outline.rectangle(0.1, 0.06), Pose(0.0, 0.0, 0.0))
        >>> round(touch.distance, 3)
        0.067
    """

    origin: tuple[float, float]  # centre of the tip at stroke position 0 [m]
    direction: tuple[float, float]  # unit vector of the forward stroke
    tip_radius: float  # [m]

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, self.origin)):
            raise ValueError(f"the origin of the pushing line must be finite, got {self.origin}")
        if not abs(math.hypot(*self.direction) - 1) <= UNIT:  # in plain numbers, as each pusher state has a line
            check_unit("the direction of the pushing line", self.direction)
        if not 0 <= self.tip_radius < math.inf:
            raise ValueError(f"a tip radius must be at least 0 and finite, got {self.tip_radius:g}")

    def touch(self, outline: Outline, pose: Pose) -> Touch | None:
        """Where the tip would first meet an object at `pose` (in the table frame); None if it passes by.

        `distance` is the stroke position at that moment; point and normal are in the object frame.
        """
        start, direction = self._seen_from(pose)
        return outline.first_touch(start, direction, self.tip_radius)

    def passed(self, outline: Outline, pose: Pose) -> bool:
        """Whether an object at `pose` lies wholly behind stroke position 0, so that no stroke meets it."""
        start, direction = self._seen_from(pose)
        last = outline.first_touch(start, -direction, self.tip_radius)
        return last is not None and last.distance >= 0

    def _seen_from(self, pose: Pose) -> tuple[Array, Array]:
        """Origin and direction in the frame of an object at `pose`."""
        back = rotation(-pose.theta)  # `transform` by the inverse of the pose, and the direction turned back by it
        return as_array(self.origin) @ back.T - back @ (pose.x, pose.y), back @ as_array(self.direction)


def tangent(normal: npt.ArrayLike) -> Array:
    """t: the contact normal (2,) turned by +90 degrees."""
    return left_of(normal)


def contact_interval(point: npt.ArrayLike, normal: npt.ArrayLike, half_width: float) -> tuple[Array, Array]:
    """The ends c-, c+ of the interval of possible contact points, along -t and +t; not clipped to the edge (section 3.1).

    Args:
        point: (2,) middle of the interval [m].
        normal: (2,) unit, outward.
        half_width: half the length of the interval [m].
    Returns:
        c-, c+: (2,) each [m], in the frame of the arguments.
    """
    point, reach = as_array(point), half_width * tangent(normal)
    return np.asarray(point - reach), np.asarray(point + reach)


def friction_cone(normal: npt.ArrayLike, mu: float) -> tuple[Array, Array]:
    """Unit forces (2,) of the pusher ON the object at the edges of the friction cone: tilted towards -t, then towards +t."""
    inward, along = -as_array(normal), mu * tangent(normal)
    norm = np.hypot(1.0, mu)
    return (inward - along) / norm, (inward + along) / norm
