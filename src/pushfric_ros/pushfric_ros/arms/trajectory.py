"""Short trajectories of the joints, for the joint trajectory controller of ros2_control: the entry point `trajectory`.

Its topic is used, not its action. On both, a trajectory replaces the last one; but what became of it, the tip's pose says at
once, and the result of an action only when it is over. Servo sends its trajectories to this topic, too.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, Self
from xml.etree import ElementTree

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from pushfric_core.errors import blaming
from pushfric_core.geometry.planar import Array
from pushfric_core.pushers.clock import clock
from pushfric_core.settings import setting
from pushfric_ros.arms.arm import DEAD_MAN, ArmConfig, Command
from pushfric_ros.messages.conversions import stamp_to_msg
from pushfric_ros.node_kit.bodies import messages
from pushfric_ros.node_kit.losses import waited, waiting
from pushfric_ros.node_kit.qos import LATCHED, NEWEST, SENSOR_DATA

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
        with blaming("is not XML", ElementTree.ParseError, error=ValueError):
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
                axes = axes @ Rotation.from_rotvec(position * joint.axis).as_matrix()
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
        place, axes = place + axes @ here[:3], axes @ Rotation.from_euler("xyz", here[3:]).as_matrix()
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


LEGS = ((0.06, True), (0.09, True), (0.1, False))
"""Parts of a trajectory: how long each lasts, in sum DEAD_MAN [s], and whether the joints still move after it.

The first one brings them to the speed that is wanted, the last one to rest; a stop has no other.
"""


@dataclass(frozen=True)
class JointTrajectoryConfig(ArmConfig):
    """An arm that gets the next DEAD_MAN of its motion again and again: each trajectory ends at rest."""

    command: str = setting(
        "/joint_trajectory_controller/joint_trajectory", "topic of the trajectories, trajectory_msgs/JointTrajectory"
    )
    joint_states: str = setting("/joint_states", "topic of the joints' positions, sensor_msgs/JointState")
    description: str = setting("/robot_description", "topic of the arm's URDF, std_msgs/String")

    def open_command(self, node: Any) -> Command:
        """Trajectories on the topic."""
        return Trajectories(node, self)


class Trajectories:
    """A stream of JointTrajectory, each from where the last one would be by now."""

    def __init__(self, node: Any, config: JointTrajectoryConfig) -> None:
        self.topic, self._config = config.command, config
        self._out = node.create_publisher(JointTrajectory, config.command, NEWEST)
        self._states = node.create_subscription(JointState, config.joint_states, lambda _: None, SENSOR_DATA)
        self._description = node.create_subscription(String, config.description, lambda _: None, LATCHED)
        self._chain: Chain | None = None
        self._problem = f"no URDF on {config.description}"
        self._positions: dict[str, float] = {}  # of the joints, as last heard,
        self._heard: dict[str, float] = {}  # and when [s]
        self._course: CubicHermiteSpline | None = None  # of the joints, in the last trajectory
        self._braking = False  # in it

    @property
    def lacks(self) -> str | None:
        self._listen()
        if not self._out.get_subscription_count():
            return f"nobody listens to {self.topic}"
        if self._chain is None:
            return self._problem
        silent = self._silent(self._chain)
        return f"no positions of {', '.join(silent)} on {self._config.joint_states}" if silent else None

    def _silent(self, chain: Chain) -> list[str]:
        """The joints of which nobody knows where they are now."""
        since = clock() - self._config.silence
        return [name for name in chain.names if self._heard.get(name, -math.inf) < since]

    def send(self, velocity: Array, stamp: int) -> None:
        """See Command. The joints go on from where the last trajectory has them by now, if they are about there.

        If nobody knows where they are, the last trajectory ends their motion.
        """
        self._listen()
        assert self._chain is not None
        if (self._braking and not velocity.any()) or self._silent(self._chain):
            return
        self._braking = not velocity.any()
        here = np.array([self._positions[name] for name in self._chain.names])
        now, at, speeds = 1e-9 * stamp, here, np.zeros(len(here))
        if self._course is not None and now < self._course.x[-1]:
            at, speeds = self._course(now), self._course(now, 1)
            lead = DEAD_MAN * np.abs(speeds)  # an arm that is held back is not pulled ever harder
            at = here + np.clip(at - here, -lead, lead)
        wanted = self._chain.speeds(here, velocity)
        still = np.zeros(len(here))
        msg = JointTrajectory(joint_names=self._chain.names)
        msg.header.stamp = stamp_to_msg(stamp)  # however late it comes, it goes on where the one before would be
        times, places, rates = [0.0], [at], [speeds]
        for lasting, after in LEGS[-1:] if self._braking else LEGS:
            after_it = wanted if after else still
            places.append(self._chain.within(places[-1] + lasting / 2 * (rates[-1] + after_it)))
            times.append(times[-1] + lasting)
            rates.append(after_it)
            point = JointTrajectoryPoint(positions=places[-1].tolist(), velocities=after_it.tolist())
            point.time_from_start.nanosec = round(1e9 * times[-1])
            msg.points.append(point)
        self._course = CubicHermiteSpline(np.add(now, times), places, rates)
        self._out.publish(msg)

    def _listen(self) -> None:
        for msg in messages(self._description):
            try:
                self._chain = Chain.between(msg.data, self._config.reference, self._config.frame)
            except ValueError as error:
                self._problem = f"the URDF on {self._config.description}: {error}"
        for msg, info in waiting(self._states):
            for name, position in zip(msg.name, msg.position, strict=False):
                if math.isfinite(position):
                    self._positions[name], self._heard[name] = position, clock() - waited(info)
