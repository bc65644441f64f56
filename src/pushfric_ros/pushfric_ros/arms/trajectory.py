"""Short trajectories of the joints, for the joint trajectory controller of ros2_control: the entry point `trajectory`.

Its topic is used, not its action. On both, a trajectory replaces the last one; but what became of it, the tip's pose says at
once, and the result of an action only when it is over. Servo sends its trajectories to this topic, too.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from pushfric_core.geometry.planar import Array
from pushfric_core.settings import setting
from pushfric_ros.arms.arm import DEAD_MAN, ArmConfig, Command
from pushfric_ros.arms.chain import Chain
from pushfric_ros.messages.conversions import stamp_to_msg
from pushfric_ros.node_kit.bodies import messages
from pushfric_ros.node_kit.qos import LATCHED, NEWEST, SENSOR_DATA

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
        self._positions: dict[str, float] = {}  # of the joints, as last heard
        self._course: CubicHermiteSpline | None = None  # of the joints, in the last trajectory
        self._braking = False  # in it

    @property
    def lacks(self) -> str | None:
        self._listen()
        if not self._out.get_subscription_count():
            return f"nobody listens to {self.topic}"
        if self._chain is None:
            return self._problem
        silent = [name for name in self._chain.names if name not in self._positions]
        return f"no positions of {', '.join(silent)} on {self._config.joint_states}" if silent else None

    def send(self, velocity: Array, stamp: int) -> None:
        """See Command. The joints go on from where the last trajectory has them by now, if they are about there."""
        self._listen()
        assert self._chain is not None
        if self._braking and not velocity.any():
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
        for msg in messages(self._states):
            self._positions.update(zip(msg.name, msg.position, strict=False))
