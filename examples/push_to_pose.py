"""A planner that pushes an object to a goal pose with the planner node, learning on the way how it slides.

It draws random strokes, refines the best ones, and chooses the stroke after which the object is predicted nearest to the goal.
The estimator learns from each stroke how the object slides, and tells the planner node, which predicts; before the first stroke
the pressure is taken to be even. Two other planners always take it to be even, and know the true friction: that shows what
learning is worth. The object, the camera's noise and the pusher are simulated.

    object=delrin_rect_right
    ros2 run pushfric_ros estimator_node --ros-args -r __ns:=/cell -p object:=$object -p source:=observations &
    ros2 run pushfric_ros planner_node --ros-args -r __ns:=/cell &
    python3 examples/push_to_pose.py --object $object --seeds 20 --figure push_to_pose.png
"""

import argparse
import contextlib
import math
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_srvs.srv import Trigger

from pushfric_core import FrictionModel, Observation, Pose, PushedObject, PushingLine, Support, Trajectory, predict_strokes
from pushfric_core.bags.samples import stamp_from_msg
from pushfric_core.geometry.planar import Array, left_of
from pushfric_core.geometry.table_1 import TABLE_1, TableObject
from pushfric_core.trajectories.samples import PoseSample, PusherSample
from pushfric_msgs.msg import Observation as ObservationMsg
from pushfric_msgs.srv import PredictStroke
from pushfric_ros.messages.conversions import observation_to_msg
from pushfric_ros.node_kit.planner_client import planner_client

LOADS = {"delrin_rect_right": None, "wood_rect3": (0.6, 0.25, 0.15), "wood_rect4": (0.5, 0.3, 0.1, 0.1)}
"""The objects, and how their supports are loaded; None: as in Table 1."""

FARTHEST = (0.2, 0.2, 1.0)
"""From the goal, the pose (0, 0, 0), in the beginning [m, m, rad]."""

STROKES = 10
"""Number of strokes to the goal: some more than it takes to get there."""

CANDIDATES, GOOD, REFINEMENTS = 200, 10, (0.1, 0.03, 0.01, 0.003)
TIP_RADIUS, APPROACH, SPEED, FRAME_RATE = 0.003, 0.01, 0.02, 14.0  # [m], [m], [m/s], [Hz]
LONGEST, STEEPEST = 0.03, math.radians(25)  # of a stroke [m], against the contact normal [rad]
STEP = 0.004  # of the prediction [m]
PATIENCE = 20.0
"""For a node, or its answer [s]."""

SETTLED = 3.0
"""For a model with all observations [s]; the estimator may refuse the last ones."""


class Course(NamedTuple):
    """One try."""

    poses: list[Pose]  # true ones, before the first stroke and after each
    errors: list[float]  # how far each is from the goal [m]: the position, and the angle times the arm of the support points


class Planner:
    """Chooses strokes with a friction that stays as it is.

    Args:
        known: the object.
        model: its friction.
    """

    def __init__(self, known: TableObject, model: FrictionModel) -> None:
        self.known, self._model = known, model

    def ends(self, poses: Array, strokes: Array) -> Array:
        """Poses (k, 3) after strokes (k, 4) from poses (k, 3)."""
        origins, directions = ways(self.known, poses, strokes)
        lines = [PushingLine(*line, TIP_RADIUS) for line in zip(origins.tolist(), directions.tolist(), strict=True)]
        starts = [Pose(*pose) for pose in poses.tolist()]
        return predict_strokes(self._model, self.known.outline, starts, lines, APPROACH + strokes[:, 3], STEP).means

    def forget(self) -> None:
        """Begin again, without a model."""

    def learn(self, observations: Sequence[Observation]) -> None:
        """Take what was observed in a stroke."""

    def best_stroke(self, pose: Array, rng: np.random.Generator) -> tuple[Array, float]:
        """The stroke (4,) that leaves the object nearest to the goal, and how near that is [m]: random, then refined."""
        strokes = random_strokes(self.known, rng)
        for share in (*REFINEMENTS, None):
            costs = distance(self.known, self.ends(np.repeat(pose[None], len(strokes), axis=0), strokes))
            if share is not None:
                good = strokes[np.argsort(costs)[:GOOD]]
                strokes = np.concatenate((good, nearby(np.repeat(good, CANDIDATES // GOOD, axis=0), share, rng)))
        best = int(np.argmin(costs))
        return strokes[best], float(costs[best])


class LearningPlanner(Planner):
    """Asks the planner node once there is a model, which the estimator learns from what is observed.

    Args:
        node: in the cell's namespace; not spun by others.
        name: of the object, as the estimator knows it.
    Raises:
        SystemExit: a node is missing or refuses, or the planner knows another object; also in its methods.
    """

    def __init__(self, node: Node, name: str) -> None:
        known = loaded(name)
        super().__init__(known, even(known))
        self._node, self._name = node, name
        self._strokes = planner_client(node, PredictStroke)
        self._reset = node.create_client(Trigger, "estimator/reset")
        self._observations = node.create_publisher(ObservationMsg, "observation", 2000)
        there = {"planner": self._strokes.service_is_ready, "estimator": self._observations.get_subscription_count}
        deadline = time.monotonic() + PATIENCE
        while missing := [other for other, is_there in there.items() if not is_there()]:
            if time.monotonic() > deadline:
                where = node.get_namespace()
                raise SystemExit(f"error: no {missing[0]} in {where}: start the nodes as the first lines of the example say")
            rclpy.spin_once(node, timeout_sec=0.1)

    def forget(self) -> None:
        self._called(self._reset, Trigger.Request())

    def ends(self, poses: Array, strokes: Array) -> Array:
        origins, directions = ways(self.known, poses, strokes)
        request = PredictStroke.Request(
            starts=poses.ravel(),
            origins=origins.ravel(),
            directions=directions.ravel(),
            tip_radii=np.full(len(poses), TIP_RADIUS),
            positions=APPROACH + strokes[:, 3],
            step=STEP,
            mean_only=True,
        )
        answer = self._called(self._strokes, request)
        self._newest = stamp_from_msg(answer.basis.header.stamp)
        if not answer.basis.has_model:
            return super().ends(poses, strokes)
        known = answer.basis.object == self._name
        if not (known and answer.success):
            why = answer.message if known else f"it knows {answer.basis.object}, not {self._name}"
            raise SystemExit(f"error: {self._strokes.service_name}: {why}")
        return np.reshape(answer.ends, (-1, 3))

    def learn(self, observations: Sequence[Observation]) -> None:
        """Send observations to the estimator, and wait for a model with all of them."""
        for observation in observations:
            self._observations.publish(observation_to_msg(observation, self._name))
        deadline = time.monotonic() + SETTLED
        while observations and self._newest < observations[-1].stamp and time.monotonic() < deadline:
            rclpy.spin_once(self._node, timeout_sec=0.05)
            self.ends(np.zeros((1, 3)), np.zeros((1, 4)))

    def _called(self, client, request):
        future = client.call_async(request)
        rclpy.spin_until_future_complete(self._node, future, timeout_sec=PATIENCE)
        if not future.done():
            raise SystemExit(f"error: {client.service_name} has not answered for {PATIENCE:.0f} s")
        return future.result()


def loaded(name: str) -> TableObject:
    """An object of Table 1, with its load; nodes know its outline and where its supports are."""
    known, load = TABLE_1[name], LOADS[name]
    return known if load is None else known._replace(support=Support(known.support.points, np.array(load)))


def even(known: TableObject) -> FrictionModel:
    """The same pressure on all support points: the usual assumption before any push."""
    points = known.support_points
    return FrictionModel.of(Support(points, np.full(len(points), 1 / len(points))), 0.3)


def turned(vectors: Array, angles: Array) -> Array:
    """Vectors (k, 2) turned by angles (k,)."""
    return np.cos(angles)[:, None] * vectors + np.sin(angles)[:, None] * left_of(vectors)


def ways(known: TableObject, poses: Array, strokes: Array) -> tuple[Array, Array]:
    """Where strokes (k, 4) from poses (k, 3) begin (k, 2), APPROACH from the contact, and their directions; table frame."""
    outline, edges = known.outline, strokes[:, 0].astype(int)
    contacts = outline.vertices[edges] + strokes[:, 1:2] * outline.edges[edges] + TIP_RADIUS * outline.normals[edges]
    directions = turned(-outline.normals[edges], poses[:, 2] + strokes[:, 2])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return poses[:, :2] + turned(contacts, poses[:, 2]) - APPROACH * directions, directions


def random_strokes(known: TableObject, rng: np.random.Generator) -> Array:
    """Strokes (k, 4): edge, place along it from 0 to 1, tilt against its normal [rad], length [m]; most are short."""
    edges = rng.choice(len(known.outline.edges), CANDIDATES, p=known.outline.lengths / known.outline.perimeter)
    along, tilts = rng.uniform(0.1, 0.9, CANDIDATES), rng.uniform(-STEEPEST, STEEPEST, CANDIDATES)
    return np.stack((edges, along, tilts, LONGEST * rng.uniform(0.0, 1.0, CANDIDATES) ** 2), axis=-1)


def nearby(strokes: Array, share: float, rng: np.random.Generator) -> Array:
    """Strokes (k, 4) that differ from others by a share of the range of each number."""
    found = strokes.copy()
    found[:, 1:] += share * rng.normal(size=(len(found), 3)) * (0.8, 2 * STEEPEST, LONGEST)
    found[:, 1:] = np.clip(found[:, 1:], (0.1, -STEEPEST, 0.0), (0.9, STEEPEST, LONGEST))
    return found


def distance(known: TableObject, poses: Array) -> Array:
    """Distance (...) of poses (..., 3) from the goal [m]; at the arm of the support points, an angle counts as a position."""
    angles = (poses[..., 2] + math.pi) % (2 * math.pi) - math.pi
    return np.sqrt(poses[..., 0] ** 2 + poses[..., 1] ** 2 + (even(known).length * angles) ** 2)


def carried_out(
    known: TableObject, pushed: PushedObject, pose: Array, chosen: Array, push_id: int, rng: np.random.Generator
) -> list[Observation]:
    """Carry out a stroke (4,) that was planned for a pose (3,); returns what the camera's frames tell."""
    (origin, direction), end = ways(known, pose[None], chosen[None]), float(APPROACH + chosen[3])
    line = PushingLine(*origin.tolist(), *direction.tolist(), TIP_RADIUS)
    trajectory, observations = Trajectory(known.outline), []
    frames = math.ceil(end / SPEED * FRAME_RATE)
    for frame in range(frames + 1):
        position = end * frame / frames
        pushed.push(line, position)
        stamp = 10**10 * push_id + round(frame * 1e9 / FRAME_RATE)
        seen = Pose(*np.add(pushed.pose, noise(known, rng)).tolist())
        observations += trajectory.add_pose(PoseSample(stamp, seen))
        observations += trajectory.add_pusher(PusherSample(stamp + 1, position, SPEED, line, push_id))
    return observations


def noise(known: TableObject, rng: np.random.Generator) -> Array:
    """The error of a pose in a single frame (3,) [m, m, rad]."""
    return rng.normal(0.0, (known.noise.position, known.noise.position, known.noise.angle))


def place(planner: Planner, seed: int) -> Course:
    """Push the object from a random pose to the goal."""
    planner.forget()
    known, rng = planner.known, np.random.default_rng(seed)
    start = Pose(*rng.uniform(np.negative(FARTHEST), FARTHEST).tolist())
    pushed = PushedObject(known.outline, known.support, known.mu_c, start)
    poses = [pushed.pose]
    for push_id in range(STROKES * seed, STROKES * (seed + 1)):
        seen = np.add(pushed.pose, noise(known, rng) / 3)  # the object rests: a mean of nine frames
        chosen, cost = planner.best_stroke(seen, rng)
        if cost < distance(known, seen):  # else none of the candidates helps; the next ones may
            planner.learn(carried_out(known, pushed, seen, chosen, push_id, rng))
        poses.append(pushed.pose)
    return Course(poses, distance(known, np.array(poses)).tolist())


def run(node: Node, name: str, seeds: Sequence[int]) -> dict[str, list[Course]]:
    """Tries from the same poses: with a friction that is learned in each, with even pressure, and with the true friction."""
    known = loaded(name)
    planners = {
        "learned": LearningPlanner(node, name),
        "even": Planner(known, even(known)),
        "true": Planner(known, FrictionModel.of(known.support, known.mu_c)),
    }
    return {kind: [place(planner, seed) for seed in seeds] for kind, planner in planners.items()}


def draw(courses: dict[str, list[Course]], path: str) -> None:
    """Median error after each stroke, and half of the tries as a band."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 3.5), layout="tight")
    axes = figure.subplots()
    looks = {"learned": ("#0072b2", "-"), "even": ("#009e73", "--"), "true": ("#cc79a7", ":")}  # Okabe and Ito's colours
    for name, tries in courses.items():
        color, line = looks[name]
        errors = 1e3 * np.array([each.errors for each in tries])
        axes.semilogy(np.median(errors, axis=0), line, color=color, label=f"{name}: {np.median(errors[:, -1]):.2f} mm")
        low, high = np.percentile(errors, (25, 75), axis=0)
        axes.fill_between(np.arange(errors.shape[1]), low, high, color=color, alpha=0.2, lw=0)
    axes.set(xlabel="strokes", ylabel="distance from the goal pose [mm]", xticks=range(errors.shape[1]))
    axes.legend(title=f"median of {len(tries)} tries, in the end", fontsize=9)
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--object", choices=LOADS, default="delrin_rect_right", help="what is pushed; the estimator must know it"
    )
    parser.add_argument("--seeds", type=int, default=20, help="how many tries with each kind of friction")
    parser.add_argument("--figure", help="draw the errors there (.png, .svg, .pdf)")
    given = parser.parse_args()
    rclpy.init()
    courses = run(Node("push_to_pose", namespace="/cell"), given.object, range(given.seeds))
    for name, tries in courses.items():
        final = 1e3 * np.array([each.errors[-1] for each in tries])
        print(f"{name}: median final error {np.median(final):.2f} mm, 90 % below {np.percentile(final, 90):.2f} mm")
    if given.figure:
        draw(courses, given.figure)


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        main()
