"""The joints between two links of a robot, from its URDF, and what they do to the last link."""

from typing import NamedTuple, Self
from xml.etree import ElementTree

import numpy as np

from pushfric_core.geometry.planar import Array

DAMPING = 1e-2
"""Near a singular posture, joints would have to move fast to move the link little; this bounds them [m, rad]."""

TURNS, SLIDES = ("revolute", "continuous"), ("prismatic",)


class Joint(NamedTuple):
    """A joint that moves; its own frame is where it is at 0."""

    name: str
    slides: bool
    place: Array  # (3,) of its frame, in that of the joint before [m]
    axes: Array  # (3, 3) the same: rotation matrix
    axis: Array  # (3,) unit vector, in its frame
    lower: float  # [rad, m]
    upper: float  # [rad, m]
    fastest: float  # [rad/s, m/s]


class Chain:
    """The joints from a reference link to another one.

    Args:
        joints: that move, from the reference on.
        end: place (3,) of the last link in the frame of the last joint [m].
    """

    def __init__(self, joints: list[Joint], end: Array) -> None:
        self.joints, self._end = joints, end

    @classmethod
    def between(cls, urdf: str, reference: str, frame: str) -> Self:
        """From a URDF.

        Raises:
            ValueError: it is none, or no chain of joints leads from the reference to the frame.
        """
        try:
            root = ElementTree.fromstring(urdf)
            above = {_of(joint, "child", "link"): joint for joint in root.iter("joint") if joint.find("child") is not None}
            path: list[ElementTree.Element] = []
            link = frame
            while link != reference:
                if link not in above or above[link] in path:
                    raise ValueError(f"no joints lead from {reference!r} to {frame!r}")
                path.insert(0, above[link])
                link = _of(above[link], "parent", "link")
            return cls(*_joints(path))
        except ElementTree.ParseError as error:
            raise ValueError(f"is not XML: {error}") from error

    @property
    def names(self) -> list[str]:
        return [joint.name for joint in self.joints]

    def jacobian(self, positions: Array) -> Array:
        """The velocity and the rotational velocity (6, n) of the last link for those of each joint, in the reference frame.

        Args:
            positions: (n,) of the joints [rad, m].
        """
        place, axes, hinges = np.zeros(3), np.eye(3), []
        for joint, position in zip(self.joints, positions, strict=True):
            place, axes = place + axes @ joint.place, axes @ joint.axes
            hinges.append((place, axes @ joint.axis))
            if joint.slides:
                place = place + position * axes @ joint.axis
            else:
                axes = axes @ turn(joint.axis, position)
        end = place + axes @ self._end
        columns = [
            np.concatenate((axis, np.zeros(3)) if joint.slides else (np.cross(axis, end - at), axis))
            for joint, (at, axis) in zip(self.joints, hinges, strict=True)
        ]
        return np.array(columns).T

    def speeds(self, positions: Array, velocity: Array) -> Array:
        """The speeds (n,) of the joints that move the last link with a velocity (3,) [m/s] and do not turn it."""
        jacobian = self.jacobian(positions)
        damped = jacobian @ jacobian.T + DAMPING**2 * np.eye(6)
        speeds = jacobian.T @ np.linalg.solve(damped, np.concatenate((velocity, np.zeros(3))))
        return np.asarray(speeds / max(1.0, *(abs(speeds) / [joint.fastest for joint in self.joints])))

    def within(self, positions: Array) -> Array:
        """The nearest positions (n,) that are within the joints' limits."""
        return np.clip(positions, [joint.lower for joint in self.joints], [joint.upper for joint in self.joints])


def _joints(path: list[ElementTree.Element]) -> tuple[list[Joint], Array]:
    """The joints that move, and the place of the end after the last of them."""
    joints = []
    place, axes = np.zeros(3), np.eye(3)  # since the last joint that moves
    for joint in path:
        kind, name = joint.get("type"), joint.get("name", "")
        origin = joint.find("origin")
        here = np.zeros(6) if origin is None else np.array((_numbers(origin, "xyz"), _numbers(origin, "rpy"))).ravel()
        roll, pitch, yaw = here[3:]
        place, axes = place + axes @ here[:3], axes @ turn(UP, yaw) @ turn(LEFT, pitch) @ turn(AHEAD, roll)
        if kind == "fixed":
            continue
        kind = kind if joint.find("mimic") is None else "mimic"
        if kind not in TURNS + SLIDES:
            raise ValueError(f"joint {name!r} must turn or slide by itself, got {kind}")
        element, limit = joint.find("axis"), joint.find("limit")
        axis = np.array((1.0, 0.0, 0.0) if element is None else _numbers(element, "xyz"))
        bounds = {} if limit is None else limit.attrib
        endless = kind == "continuous"
        lower, upper = (
            sign * np.inf if endless else float(bounds.get(key, 0.0)) for sign, key in ((-1, "lower"), (1, "upper"))
        )
        fastest = float(bounds.get("velocity", 0.0)) or np.inf
        joints.append(Joint(name, kind in SLIDES, place, axes, axis / np.linalg.norm(axis), lower, upper, fastest))
        place, axes = np.zeros(3), np.eye(3)
    if not joints:
        raise ValueError("no joint moves the frame")
    return joints, place


def _of(joint: ElementTree.Element, tag: str, key: str) -> str:
    element = joint.find(tag)
    return "" if element is None else element.get(key, "")


def _numbers(element: ElementTree.Element, key: str) -> list[float]:
    """Three numbers of an attribute. Raises ValueError."""
    text = element.get(key, "0 0 0")
    try:
        x, y, z = map(float, text.split())
    except ValueError:
        x = y = z = np.nan
    if not np.isfinite((x, y, z)).all():
        raise ValueError(f"{key} must be three numbers, got {text!r}")
    return [x, y, z]


def turn(axis: Array, angle: float) -> Array:
    """Rotation matrix about a unit vector (3,), by Rodrigues' formula."""
    x, y, z = axis
    k = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k)


AHEAD, LEFT, UP = np.eye(3)
