"""A planner that pushes an object to a goal pose with the planner node, learning on the way how it slides.

It draws random strokes, refines the best ones, and chooses the stroke after which the planner node predicts the object nearest
to the goal. The estimator learns from each stroke how the object slides, and tells the node, which knows nothing before the
first. Two other nodes are told that the pressure is even, and the true friction: that shows what learning is worth. The object,
the camera's noise and the pusher are simulated.

    object=delrin_rect_right
    ros2 run pushfric_ros estimator_node --ros-args -r __ns:=/learned -p object:=$object -p source:=observations &
    for name in learned even true; do ros2 run pushfric_ros planner_node --ros-args -r __ns:=/$name & done
    python3 examples/push_to_pose.py --object $object --seeds 20 --figure push_to_pose.png
"""

import argparse
import contextlib
import math
import time
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import rclpy
from geometry_msgs.msg import Point
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_srvs.srv import Trigger

from pushfric_core import FrictionModel, Observation, Pose, PushedObject, PushingLine, Support, Trajectory
from pushfric_core.bags.samples import stamp_from_msg
from pushfric_core.geometry.planar import Array, left_of
from pushfric_core.geometry.table_1 import TABLE_1, TableObject
from pushfric_core.trajectories.samples import PoseSample, PusherSample
from pushfric_msgs.msg import Basis
from pushfric_msgs.msg import FrictionModel as FrictionModelMsg
from pushfric_msgs.msg import Observation as ObservationMsg
from pushfric_msgs.srv import PredictStroke
from pushfric_ros.messages.conversions import MODEL_TOPIC, observation_to_msg
from pushfric_ros.node_kit.planner_client import planner_client
from pushfric_ros.node_kit.qos import LATCHED

LOADS = {"delrin_rect_right": None, "wood_rect3": (0.6, 0.25, 0.15), "wood_rect4": (0.5, 0.3, 0.1, 0.1)}
"""The objects, and how their supports are loaded; None: as in Table 1."""

GOAL = Pose(0.0, 0.0, 0.0)
FARTHEST = (0.2, 0.2, 1.0)
"""From the goal, in the beginning [m, m, rad]."""

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


class Cell:
    """The services and topics of a cell in which an object is pushed.

    Args:
        node: in the cell's namespace; not spun by others.
        name: of the object.
        step: of the predictions [m].
    """

    def __init__(self, node: Node, name: str, step: float) -> None:
        self.known = loaded(name)
        self._node, self._name, self._step = node, name, step
        self._strokes = planner_client(node, PredictStroke)
        self._reset = node.create_client(Trigger, "estimator/reset")
        self._observations = node.create_publisher(ObservationMsg, "observation", 2000)
        self._models = node.create_publisher(FrictionModelMsg, MODEL_TOPIC, LATCHED)
        self._basis = Basis()

    def wait(self, learns: bool = True) -> None:
        """Wait until the planner is there, and the estimator of a cell that learns.

        Raises:
            SystemExit: one of them is missing.
        """
        listeners = self._observations if learns else self._models
        needed = {
            "planner": self._strokes.service_is_ready,
            "estimator" if learns else "planner": listeners.get_subscription_count,
        }
        deadline = time.monotonic() + PATIENCE
        while missing := [name for name, there in needed.items() if not there()]:
            if time.monotonic() > deadline:
                where = self._node.get_namespace()
                raise SystemExit(f"error: no {missing[0]} in {where}: start the nodes as the first lines of the example say")
            rclpy.spin_once(self._node, timeout_sec=0.1)

    def ends(self, poses: Array, strokes: Array) -> Array | None:
        """Poses (k, 3) after strokes (k, 4) from poses (k, 3); None while there is no model.

        Raises:
            SystemExit: the planner refuses the request, or knows another object.
        """
        contacts, directions = tips(self.known, poses, strokes)
        origins = contacts - APPROACH * directions
        request = PredictStroke.Request(
            starts=poses.ravel(),
            origins=origins.ravel(),
            directions=directions.ravel(),
            tip_radii=np.full(len(poses), TIP_RADIUS),
            positions=APPROACH + strokes[:, 3],
            step=self._step,
            mean_only=True,
        )
        answer = self._called(self._strokes, request)
        self._basis = answer.basis
        if not answer.basis.has_model:
            return None
        known = answer.basis.object == self._name
        if not (known and answer.success):
            why = answer.message if known else f"it knows {answer.basis.object}, not {self._name}"
            raise SystemExit(f"error: {self._strokes.service_name}: {why}")
        return np.reshape(answer.ends, (-1, 3))

    def learn(self, observations: Sequence[Observation]) -> None:
        """Send observations to the estimator."""
        for observation in observations:
            self._observations.publish(observation_to_msg(observation, self._name))

    def settle(self, newest: int, pose: Array) -> None:
        """Wait for a model with the observation of this time [ns]."""
        deadline = time.monotonic() + SETTLED
        while stamp_from_msg(self._basis.header.stamp) < newest and time.monotonic() < deadline:
            rclpy.spin_once(self._node, timeout_sec=0.05)
            self.ends(pose[None], np.zeros((1, 4)))

    def forget(self) -> None:
        """Let the estimation start again."""
        self._called(self._reset, Trigger.Request())

    def tell(self, model: FrictionModel) -> None:
        """Tell the planner a friction model, in place of an estimator; return once it has it."""
        msg = FrictionModelMsg(basis=Basis(object=self._name, has_model=True))
        msg.outline, msg.support_points = (
            [Point(x=x, y=y) for x, y in points.tolist()] for points in (self.known.outline.vertices, model.support_points)
        )
        msg.w, msg.mu_c, msg.weights, msg.total_friction = model.w.ravel(), model.mu_c, model.share, math.nan
        self._models.publish(msg)
        while self.ends(np.zeros((1, 3)), np.zeros((1, 4))) is None:
            rclpy.spin_once(self._node, timeout_sec=0.05)

    def _called(self, client, request):
        future = client.call_async(request)
        rclpy.spin_until_future_complete(self._node, future, timeout_sec=PATIENCE)
        if not future.done():
            raise SystemExit(f"error: {client.service_name} has not answered for {PATIENCE:.0f} s")
        return future.result()


def loaded(name: str) -> TableObject:
    """An object of Table 1, with its load; nodes know its outline and where its supports are."""
    known, load = TABLE_1[name], LOADS.get(name)
    return known if load is None else known._replace(support=Support(known.support.points, np.array(load)))


def turned(vectors: Array, angles: Array) -> Array:
    """Vectors (k, 2) turned by angles (k,)."""
    return np.cos(angles)[:, None] * vectors + np.sin(angles)[:, None] * left_of(vectors)


def tips(known: TableObject, poses: Array, strokes: Array) -> tuple[Array, Array]:
    """Where the tip's centre touches (k, 2), and its directions (k, 2), table frame."""
    outline, edges = known.outline, strokes[:, 0].astype(int)
    contacts = outline.vertices[edges] + strokes[:, 1:2] * outline.edges[edges] + TIP_RADIUS * outline.normals[edges]
    directions = turned(-outline.normals[edges], poses[:, 2] + strokes[:, 2])
    return poses[:, :2] + turned(contacts, poses[:, 2]), directions / np.linalg.norm(directions, axis=1)[:, None]


def random_strokes(known: TableObject, shape: int | tuple[int, ...], rng: np.random.Generator) -> Array:
    """Strokes (*shape, 4): edge, place along it from 0 to 1, tilt against its normal [rad], length [m]; most are short."""
    edges = rng.choice(len(known.outline.edges), shape, p=known.outline.lengths / known.outline.perimeter)
    along, tilts = rng.uniform(0.1, 0.9, shape), rng.uniform(-STEEPEST, STEEPEST, shape)
    return np.stack((edges, along, tilts, LONGEST * rng.uniform(0.0, 1.0, shape) ** 2), axis=-1)


def nearby(strokes: Array, share: float, rng: np.random.Generator) -> Array:
    """Strokes (..., 4) that differ from others by a share of the range of each number."""
    found = strokes.copy()
    found[..., 1:] += share * rng.normal(size=found[..., 1:].shape) * (0.8, 2 * STEEPEST, LONGEST)
    found[..., 1:] = np.clip(found[..., 1:], (0.1, -STEEPEST, 0.0), (0.9, STEEPEST, LONGEST))
    return found


def even(known: TableObject) -> FrictionModel:
    """The same pressure on all support points: the usual assumption before any push."""
    points = known.support_points
    return FrictionModel.of(Support(points, np.full(len(points), 1 / len(points))), 0.3)


def true(known: TableObject) -> FrictionModel:
    """The friction that the object has."""
    return FrictionModel.of(known.support, known.mu_c)


TOLD = {"learned": None, "even": even, "true": true}
"""What the planner of each cell is told; None: by an estimator."""


def distance(known: TableObject, poses: Array) -> Array:
    """Distance (...) of poses (..., 3) from the goal [m]; at the arm of the support points, an angle counts as a position."""
    angles = (poses[..., 2] - GOAL.theta + math.pi) % (2 * math.pi) - math.pi
    arm = even(known).length
    return np.sqrt((poses[..., 0] - GOAL.x) ** 2 + (poses[..., 1] - GOAL.y) ** 2 + (arm * angles) ** 2)


def best_stroke(cell: Cell, pose: Array, rng: np.random.Generator) -> tuple[Array, float]:
    """The stroke (4,) that leaves the object nearest to the goal, and how near that is [m]: random, then refined."""
    strokes = random_strokes(cell.known, CANDIDATES, rng)
    for share in (*REFINEMENTS, None):
        ends = cell.ends(np.repeat(pose[None], len(strokes), axis=0), strokes)
        while ends is None:  # nothing has been learned yet, and the estimator may just be saying so
            cell.tell(even(cell.known))
            ends = cell.ends(np.repeat(pose[None], len(strokes), axis=0), strokes)
        costs = distance(cell.known, ends)
        if share is not None:
            good = strokes[np.argsort(costs)[:GOOD]]
            strokes = np.concatenate((good, nearby(np.repeat(good, CANDIDATES // GOOD, axis=0), share, rng)))
    best = int(np.argmin(costs))
    return strokes[best], float(costs[best])


def carried_out(
    known: TableObject, pushed: PushedObject, pose: Array, chosen: Array, push_id: int, rng: np.random.Generator
) -> Iterator[list[Observation]]:
    """Carry out a stroke (4,) that was planned for a pose (3,); yields what is observed in each frame of the camera."""
    contacts, directions = tips(known, pose[None], chosen[None])
    (x, y), (dx, dy) = (contacts - APPROACH * directions)[0].tolist(), directions[0].tolist()
    line, end = PushingLine((x, y), (dx, dy), TIP_RADIUS), float(APPROACH + chosen[3])
    trajectory = Trajectory(known.outline)
    frames = math.ceil(end / SPEED * FRAME_RATE)
    for frame in range(frames + 1):
        position = end * frame / frames
        pushed.push(line, position)
        stamp = 10**10 * push_id + round(frame * 1e9 / FRAME_RATE)
        seen = Pose(*np.add(pushed.pose, noise(known, rng)).tolist())
        yield trajectory.add_pose(PoseSample(stamp, seen)) + trajectory.add_pusher(
            PusherSample(stamp + 1, position, SPEED, line, push_id)
        )


def noise(known: TableObject, rng: np.random.Generator) -> Array:
    """The error of a pose in a single frame (3,) [m, m, rad]."""
    return rng.normal(0.0, (known.noise.position, known.noise.position, known.noise.angle))


def place(cell: Cell, seed: int, learns: bool) -> Course:
    """Push the object from a random pose to the goal; a cell that learns begins without a model."""
    known = cell.known
    if learns:
        cell.forget()
    rng = np.random.default_rng(seed)
    start = Pose(*rng.uniform(np.negative(FARTHEST), FARTHEST).tolist())
    pushed = PushedObject(known.outline, known.support, known.mu_c, start)
    poses = [pushed.pose]
    for push_id in range(STROKES * seed, STROKES * (seed + 1)):
        seen = np.add(pushed.pose, noise(known, rng) / 3)  # the object rests: a mean of nine frames
        chosen, cost = best_stroke(cell, seen, rng)
        if cost < distance(known, seen):  # else none of the candidates helps; the next ones may
            data = [one for some in carried_out(known, pushed, seen, chosen, push_id, rng) for one in some]
            if learns and data:
                cell.learn(data)
                cell.settle(data[-1].stamp, seen)
        poses.append(pushed.pose)
    return Course(poses, distance(known, np.array(poses)).tolist())


def run(cells: dict[str, Cell], seeds: Sequence[int]) -> dict[str, list[Course]]:
    """Tries from the same poses in each cell."""
    courses = {}
    for name, cell in cells.items():
        told = TOLD[name]
        cell.wait(learns=told is None)
        if told is not None:
            cell.tell(told(cell.known))
        courses[name] = [place(cell, seed, learns=told is None) for seed in seeds]
    return courses


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
    axes.set(xlabel="strokes", ylabel="distance from the goal pose [mm]")
    axes.set_xticks(range(errors.shape[1]))
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
    courses = run(
        {name: Cell(Node("push_to_pose", namespace=f"/{name}"), given.object, STEP) for name in TOLD}, range(given.seeds)
    )
    for name, tries in courses.items():
        final = 1e3 * np.array([each.errors[-1] for each in tries])
        print(f"{name}: median final error {np.median(final):.2f} mm, 90 % below {np.percentile(final, 90):.2f} mm")
    if given.figure:
        draw(courses, given.figure)


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        main()
