"""A body that another system tracks, such as a tag on the object or an arm's last link, and its transform to the table."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from pushfric_core.bags.samples import quaternion_length, stamp_from_msg
from pushfric_core.geometry.planar import Array, Pose, inverse, transform, wrap
from pushfric_core.plausible import FARTHEST
from pushfric_core.settings import Ranged, setting


class Body(NamedTuple):
    """Where a body was seen, in the frame of its tracker."""

    stamp: int  # [ns]
    position: Array  # (3,) [m]
    axes: Array  # (3, 3) rotation matrix: its axes as columns

    @classmethod
    def of(cls, stamp: Any, position: Any, quaternion: Any) -> "Body":
        """From the parts of a ROS message: builtin_interfaces/Time, Point or Vector3, Quaternion.

        Raises:
            ValueError: a value is not finite, or the quaternion's length is out of range.
        """
        at = np.array((position.x, position.y, position.z), dtype=float)
        length = quaternion_length(at.tolist(), quaternion)
        x, y, z, w = np.array((quaternion.x, quaternion.y, quaternion.z, quaternion.w), dtype=float) / length
        axes = np.array(
            (
                (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
                (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
                (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
            )
        )
        return cls(stamp_from_msg(stamp), at, axes)

    def before(self, inner: "Body") -> "Body":
        """A body given in this one's frame, expressed in the frame in which this one was seen; the newer stamp of the two."""
        axes = np.asarray(self.axes @ inner.axes)
        return Body(max(self.stamp, inner.stamp), self.position + self.axes @ inner.position, axes)

    def inverted(self) -> "Body":
        """The frame in which this body was seen, expressed in the body's frame."""
        return Body(self.stamp, -self.axes.T @ self.position, self.axes.T)


@dataclass(frozen=True)
class MountConfig(Ranged):
    """How a tracked body relates to what pushes or is pushed, and its tracker to the table. Sections `poses` and `tip`."""

    source: str = setting("pose_stamped", "kind of message: an entry point of the group pushfric.sources")
    origin: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0), "place of the object's origin, or of the tip's centre, in the frame of the body [m]", -10.0, 10.0
    )
    turn: float = setting(0.0, "angle of the object's x axis from that of the body, about z [rad]", -math.pi, math.pi)
    table: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0),
        "x, y [m] and angle [rad] of the table frame in the tracker's frame, whose z axis points up",
        -FARTHEST,
        FARTHEST,
    )
    time_offset: float = setting(0.0, "added to the stamps [s]", -10.0, 10.0)

    def stamp(self, body: Body) -> int:
        """When the body was seen, by the cell's clock [ns]."""
        return body.stamp + round(self.time_offset * 1e9)

    def place(self, body: Body) -> Array:
        """The place (3,) of the origin, in the tracker's frame [m]."""
        return np.asarray(body.position + body.axes @ np.array(self.origin))

    def point(self, body: Body) -> Array:
        """The place (2,) of the origin, table frame [m]."""
        return transform(inverse(Pose(*self.table)), self.place(body)[:2])

    def pose(self, body: Body) -> Pose:
        """The pose of the object in the table frame: the body's, without its tilt.

        Raises:
            ValueError: the x axis of the body points up or down.
        """
        x, y = body.axes[:2, 0]
        if math.hypot(x, y) < 1e-3:
            raise ValueError("the x axis of the body is upright, so it does not give the angle on the table")
        at = self.point(body)
        return Pose(float(at[0]), float(at[1]), wrap(math.atan2(y, x) + self.turn - self.table[2]))
