"""The contact between pusher and object: point, normal, interval, friction cone."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.outline import Outline, Touch
from pushfric_core.planar import Array, Pose, inverse, left_of, rotation, transform


class PushingLine(NamedTuple):
    """The straight line, fixed in the table frame, on which a round tip moves."""

    origin: tuple[float, float]  # centre of the tip at stroke position 0 [m]
    direction: tuple[float, float]  # unit vector of the forward stroke
    tip_radius: float  # [m]

    def touch(self, outline: Outline, pose: Pose) -> Touch | None:
        """Where the tip would first meet the object lying at `pose` (in the table frame); None where it passes by.

        `distance` is the stroke position of that moment; point and normal are in the object frame.
        """
        start = transform(inverse(pose), self.origin)
        direction = rotation(-pose.theta) @ np.asarray(self.direction)
        return outline.first_touch(start, direction, self.tip_radius)


def tangent(normal: npt.ArrayLike) -> Array:
    """t: the contact normal (2,) turned by +90 degrees."""
    return left_of(normal)


def interval(point: npt.ArrayLike, normal: npt.ArrayLike, half_width: float) -> tuple[Array, Array]:
    """The ends c-, c+ of the interval of possible contact points, along -t and +t; not clipped to the edge (section 3.1)."""
    reach = half_width * tangent(normal)
    return np.asarray(point) - reach, np.asarray(point) + reach


def friction_cone(normal: npt.ArrayLike, mu: float) -> tuple[Array, Array]:
    """Unit forces of the pusher ON the object at the edges of the friction cone, tilted towards -t and +t."""
    inward, along = -np.asarray(normal, dtype=float), mu * tangent(normal)
    norm = np.hypot(1.0, mu)
    return (inward - along) / norm, (inward + along) / norm
