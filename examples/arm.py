"""A robot arm with six axes, simulated, as the drivers `twist` and `trajectory` see one: for examples/arm.yaml.

python3 examples/arm.py                                            # is the arm, until Ctrl-C
./pushfric run examples/arm.yaml --simulated-camera                # in another terminal: it pushes a rendered object
./pushfric rehearse --driver twist --stroke 0.06 --set source=pose_stamped --set topic=/tool_pose \\
    --set "origin=[0, 0, 0.12]" --set "table=[0.5, 0.1, 0.3]"      # or this: what happens when things break

A real controller does not wait for a busy machine: if this process stood still, what came meanwhile counts from when it was
sent.

It takes what MoveIt Servo takes, velocities of the tool, each good for TIMEOUT; and what the joint trajectory controller of
ros2_control takes. It answers with the tool's pose, on tool_pose and, if tf2_msgs is installed, on /tf, and with its joints.
"""

import math
from itertools import pairwise
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, PoseStamped, Quaternion, Transform, TransformStamped, TwistStamped, Vector3
from geometry_msgs.msg import Pose as PoseMsg
from rclpy.node import Node
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String
from trajectory_msgs.msg import JointTrajectory

from pushfric_core.bags.samples import stamp_from_msg
from pushfric_core.geometry.planar import Pose, transform
from pushfric_ros.messages.conversions import stamp_to_msg
from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.qos import LATCHED, NEWEST, RELIABLE
from pushfric_ros.node_kit.transforms import TransformBroadcaster

PERIOD = 0.005  # of the controller [s]
POSES = 2  # every second period has a pose
LATE = 0.02  # this process stood still, if a period took so long [s]
TIMEOUT = 0.1  # after the last command, the arm stops [s]
LAG = 0.03  # the joints follow a command with this time constant [s]
FASTEST = 2.0  # of a joint [rad/s]
REACH = math.radians(175)  # of a joint, to either side [rad]

AXES = np.array(((0, 0, 1), (0, 1, 0), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 0, 1)), float)  # of the joints, in their links
OFFSETS = np.array(((0, 0, 0.2), (0, 0, 0.1), (0, 0, 0.45), (0, 0, 0.4), (0, 0, 0.05), (0, 0, 0.05)))  # from link to link [m]
FLANGE = np.array((0, 0, 0.05))  # from the last link [m]
TOOL = 0.12  # from the flange to the tip [m]

TABLE = (0.5, 0.1, 0.3)  # x, y [m] and angle [rad] of the table frame, seen from the base; its z axis points up, too
TIP = (0.0, 0.0)  # where the tip stands at first, on the table [m]
ABOVE = 0.002  # the tip, over the table [m]
DOWN = np.diag((1.0, -1.0, -1.0))  # axes of a flange that points down
ELBOW_UP = np.array((0.2, 0.4, 1.6, 1.1, 0.0, 0.0))  # near such a place [rad]


NAMES = [f"joint_{number}" for number in range(1, 7)]
LINKS = ["base_link", *(f"link_{number}" for number in range(1, 7)), "tool0"]


def urdf() -> str:
    """The arm as robot_state_publisher would describe it; a fixed joint leads to the flange."""
    kinds = [*["revolute"] * 6, "fixed"]
    links = zip([*NAMES, "flange"], kinds, pairwise(LINKS), [*OFFSETS, FLANGE], [*AXES, AXES[0]], strict=True)
    joints = [
        f'''<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
        <origin xyz="{words(offset)}"/><axis xyz="{words(axis)}"/>
        <limit lower="{-REACH}" upper="{REACH}" velocity="{FASTEST}" effort="100"/></joint>'''
        for name, kind, (parent, child), offset, axis in links
    ]
    return f"""<robot name="arm">{"".join(f'<link name="{name}"/>' for name in LINKS)}{"".join(joints)}</robot>"""


def words(numbers: np.ndarray) -> str:
    return " ".join(map(str, numbers))


def forward(joints: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The flange's place [m] and axes, and the Jacobian (6, 6): its velocity and rotational velocity for that of each joint."""
    place, axes, hinges = np.zeros(3), np.eye(3), []
    turns = Rotation.from_rotvec(AXES * joints[:, None]).as_matrix()
    for offset, axis, turn in zip(OFFSETS, AXES, turns, strict=True):
        place = place + axes @ offset
        hinges.append((place, axes @ axis))
        axes = axes @ turn
    place = place + axes @ FLANGE
    return place, axes, np.array([(*np.cross(about, place - at), *about) for at, about in hinges]).T


def backward(place: np.ndarray, axes: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """The joints with the flange at a place, from others that are near (Newton)."""
    for _ in range(100):
        here, now, jacobian = forward(joints)
        turned = Rotation.from_matrix(axes @ now.T).as_rotvec()
        joints = joints + np.clip(np.linalg.solve(jacobian, np.array((*(place - here), *turned))), -0.3, 0.3)
    return joints


def at_first() -> np.ndarray:
    """The joints with the tip at TIP."""
    return backward(np.array((*transform(Pose(*TABLE), TIP), TOOL + ABOVE)), DOWN, ELBOW_UP)


def stamp_of(msg: Any) -> float:
    """When a message was stamped [s]."""
    return 1e-9 * stamp_from_msg(msg.header.stamp)


class Arm(Node):
    """The arm with its controller."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("arm", **kwargs)
        self.joints, self._speeds = at_first(), np.zeros(6)
        self._wanted, self._good_until = np.zeros(6), 0.0
        self._course: CubicHermiteSpline | None = None  # of the joints, and since when
        self._now, self._count, self._listens = self._time(), 0, False
        self._pose_out = self.create_publisher(PoseStamped, "/tool_pose", RELIABLE)
        self._joints_out = self.create_publisher(JointState, "/joint_states", RELIABLE)
        self._description_out = self.create_publisher(String, "/robot_description", LATCHED)
        self._description_out.publish(String(data=urdf()))
        self._broadcaster = TransformBroadcaster(self, "")
        self.create_subscription(TwistStamped, "/servo_node/delta_twist_cmds", self._on_twist, NEWEST)
        trajectories = "/joint_trajectory_controller/joint_trajectory"
        self.create_subscription(JointTrajectory, trajectories, self._on_trajectory, NEWEST)
        self.create_timer(PERIOD, self._step)

    def _on_twist(self, msg: TwistStamped) -> None:
        """Follow a velocity, if it is not too old already."""
        self._go_on(stamp_of(msg))
        self._good_until, self._course = stamp_of(msg) + TIMEOUT, None
        linear, angular = msg.twist.linear, msg.twist.angular
        self._wanted = np.array((linear.x, linear.y, linear.z, angular.x, angular.y, angular.z))

    def _on_trajectory(self, msg: JointTrajectory) -> None:
        """Go on from here through the points that are not past; the last one is held.

        The joints keep to the speeds that the points name: an arm that is told late falls behind, and does not catch up.
        """
        order = [msg.joint_names.index(name) for name in NAMES]
        self._go_on(stamp_of(msg))
        times, places, speeds = [self._now], [self.joints], [self._speeds]
        for point in msg.points:
            when = stamp_of(msg) + point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec
            if when > self._now:
                speeds.append(np.array(point.velocities)[order])
                reach = (when - times[-1]) * (np.abs(speeds[-2]) + np.abs(speeds[-1])) / 2
                places.append(np.clip(np.array(point.positions)[order], places[-1] - reach, places[-1] + reach))
                times.append(when)
        if len(times) > 1:
            self._course = CubicHermiteSpline(times, places, speeds)

    def _step(self) -> None:
        now = self._time()
        self._listens = not self._listens and now - self._now > LATE
        if self._listens:  # what came meanwhile is taken first
            return
        self._go_on(now)
        self._count += 1
        if self._count % POSES == 0:
            self._publish(*forward(self.joints)[:2])

    def _time(self) -> float:
        return 1e-9 * self.get_clock().now().nanoseconds

    def _go_on(self, until: float) -> None:
        """Follow the last command, while it is good; not back, and not beyond the present."""
        then, self._now = self._now, max(self._now, min(until, self._time()))
        seconds = min(self._now - then, 0.05)
        if self._course is not None:
            self._speeds = self._course(self._now, 1) if self._now < self._course.x[-1] else np.zeros(6)
            self.joints = np.clip(self._course(min(self._now, self._course.x[-1])), -REACH, REACH)
        else:
            wanted = np.zeros(6)
            if self._now < self._good_until:
                jacobian = forward(self.joints)[2]
                wanted = np.clip(np.linalg.solve(jacobian, self._wanted), -FASTEST, FASTEST)
            self._speeds = self._speeds + (wanted - self._speeds) * (1 - math.exp(-seconds / LAG))
            self.joints = np.clip(self.joints + self._speeds * seconds, -REACH, REACH)

    def _publish(self, place: np.ndarray, axes: np.ndarray) -> None:
        header = Header(frame_id="base_link", stamp=stamp_to_msg(round(1e9 * self._now)))
        at = dict(zip("xyz", place.tolist(), strict=True))
        turn = Quaternion(**dict(zip("xyzw", Rotation.from_matrix(axes).as_quat().tolist(), strict=True)))
        self._pose_out.publish(PoseStamped(header=header, pose=PoseMsg(position=Point(**at), orientation=turn)))
        self._joints_out.publish(JointState(header=header, name=NAMES, position=self.joints.tolist()))
        frame = Transform(translation=Vector3(**at), rotation=turn)
        self._broadcaster.broadcast(TransformStamped(header=header, child_frame_id="tool0", transform=frame))


if __name__ == "__main__":
    run_node(Arm)
