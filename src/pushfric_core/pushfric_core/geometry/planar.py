"""Rigid motions of the plane: poses, twists and wrenches in SE(2), with all signs defined here; and the frames of a cell.

Angles are counter-clockwise. A twist (vx, vy, omega) is the velocity of the object-frame origin, in the object frame. A
wrench (fx, fy, m) holds the moment about the object-frame origin. Points are arrays whose last axis is (x, y).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

UNIT = 1e-3
"""A unit vector may be longer or shorter than 1 by this much: its digits may have been rounded."""

LEAST_DIVISOR = 1e-300
"""Keeps a division by zero defined where its quotient is not used, or multiplied by zero."""


class Pose(NamedTuple):
    """Where a frame lies in another: its origin (x, y) [m] and orientation theta [rad].

    Example:
        >>> from pushfric_core import Pose
        >>> pose = Pose(0.1, 0.0, 1.57)
        >>> pose.theta
        1.57
    """

    x: float
    y: float
    theta: float


class Twist(NamedTuple):
    """Velocity of a rigid body: of its origin (vx, vy) [m/s] in its own frame, and omega [rad/s].

    Example:
        >>> from pushfric_core import Twist
        >>> vx, vy, omega = Twist(0.0, 0.02, 0.1)
        >>> omega
        0.1
    """

    vx: float
    vy: float
    omega: float


class Wrench(NamedTuple):
    """Force (fx, fy) and moment m about the origin of the frame.

    Example:
        >>> from pushfric_core import TABLE_1, Twist
        >>> wrench = TABLE_1["wood_rect4"].support.friction_wrench(Twist(0.0, 0.02, 0.0))
        >>> round(wrench.fy, 3)
        -1.0
    """

    fx: float
    fy: float
    m: float


def as_array(values: npt.ArrayLike) -> Array:
    """Numbers from outside, in the one form in which the core computes with them: float64, in C order without gaps.

    Every public function takes its arrays in through this or `frozen`, because the last bits of a sum, a product or a function
    may depend on how an array lies in memory. NumPy 2.2 to 2.4 even negates a column of eight to another place wrongly.
    """
    return np.asarray(values, dtype=np.float64, order="C")


def check_unit(name: str, vectors: npt.ArrayLike) -> None:
    """Refuse vectors (..., 2) unless each has length 1, within UNIT.

    Raises:
        ValueError: one has not; the text calls them `name`.
    """
    given = np.asarray(vectors, dtype=np.float64)
    lengths = np.hypot(given[..., 0], given[..., 1])
    good = np.abs(lengths - 1) <= UNIT  # not those that are not a number
    if not good.all():
        raise ValueError(f"{name} must have length 1, got {lengths[~good][0] if given.ndim > 1 else lengths:g}")


def frozen(values: npt.ArrayLike) -> Array:
    """A read-only copy of numbers from outside, in the same form as `as_array` gives them."""
    array = np.array(values, dtype=np.float64, order="C")
    array.setflags(write=False)
    return array


def cross(a: npt.ArrayLike, b: npt.ArrayLike) -> Array:
    """Scalar cross product a x b of planar vectors (..., 2)."""
    a, b = as_array(a), as_array(b)
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def left_of(vectors: npt.ArrayLike) -> Array:
    """Vectors (..., 2) turned by +90 degrees: (x, y) -> (-y, x)."""
    v = as_array(vectors)
    turned = np.empty(v.shape)
    turned[..., 0], turned[..., 1] = -v[..., 1], v[..., 0]
    return turned


def rotation(theta: float) -> Array:
    """Rotation matrix (2, 2) by theta [rad]."""
    c, s = np.cos(theta), np.sin(theta)
    return np.array(((c, -s), (s, c)))


def transform(pose: Pose, points: npt.ArrayLike) -> Array:
    """Points (..., 2) [m] given in the frame at `pose`, expressed in the frame in which `pose` itself is given."""
    return np.asarray(as_array(points) @ rotation(pose.theta).T + (pose.x, pose.y))


def inverse(pose: Pose) -> Pose:
    """Pose of the outer frame seen from the inner one."""
    x, y = -rotation(-pose.theta) @ (pose.x, pose.y)
    return Pose(float(x), float(y), -pose.theta)


def compose(outer: Pose, inner: Pose) -> Pose:
    """Pose of a frame at `inner` in a frame that is itself at `outer`. Angles add without wrapping."""
    x, y = transform(outer, (inner.x, inner.y))
    return Pose(float(x), float(y), outer.theta + inner.theta)


def exp(twist: Twist, duration: float = 1.0) -> Pose:
    """The pose after `duration` [s] of a body that moves with a constant body twist, relative to its first pose."""
    angle = twist.omega * duration
    # sin(a)/a and (1 - cos a)/a, the latter from the half angle to keep its digits near 0
    along = np.sinc(angle / np.pi)
    across = np.sin(angle / 2) * np.sinc(angle / (2 * np.pi))
    x = duration * (along * twist.vx - across * twist.vy)
    y = duration * (across * twist.vx + along * twist.vy)
    return Pose(float(x), float(y), angle)


def log(pose: Pose) -> Twist:
    """The constant body twist that reaches `pose` in unit time with less than half a turn; there, the inverse of `exp`."""
    angle = wrap(pose.theta)
    half = angle / 2
    # a/2 * cot(a/2), finite at 0
    cot = np.cos(half) / np.sinc(half / np.pi)
    return Twist(float(cot * pose.x + half * pose.y), float(-half * pose.x + cot * pose.y), angle)


def velocity_at(twist: Twist, points: npt.ArrayLike) -> Array:
    """Velocities (..., 2) of body points (..., 2): (vx - omega y, vy + omega x)."""
    p = as_array(points)
    velocities = np.empty(p.shape)
    velocities[..., 0], velocities[..., 1] = twist.vx - twist.omega * p[..., 1], twist.vy + twist.omega * p[..., 0]
    return velocities


def wrap(angle: float) -> float:
    """The same angle in [-pi, pi)."""
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


TABLE = "table"
OBJECT = "object"
CAMERA = "camera_optical"
FRAMES = (TABLE, OBJECT, CAMERA)
"""The frames of a cell.

`table` is its world: the z axis points up, the plane z = 0 is the table top. `object` is fixed to the object. `camera_optical`
is the camera, with the axes of REP 103: z along the line of sight, x to the right and y down in the image. Cells that share a
tree of transforms put a prefix before these names.
"""


def put_prefix(msg: Any, prefix: str) -> None:
    """Put a prefix before the names of the frames in the headers of a message that is to be published.

    Messages that share a header get the prefix once.
    """
    if not prefix:
        return
    for part in (msg, getattr(msg, "basis", None), *getattr(msg, "markers", ())):
        header = getattr(part, "header", None)
        if header is not None and header.frame_id in FRAMES:
            header.frame_id = prefix + header.frame_id


def is_frame(name: str, frame: str) -> bool:
    """Whether a name is that of a frame, with whatever prefix."""
    return name.rpartition("/")[2] == frame
