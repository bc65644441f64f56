"""A sampling planner with the planner node: brings an object to a pose behind an obstacle, while its friction is learned.

Up to ten times a second, it tries 256 pairs of strokes by the cross-entropy method: the pairs that come nearest to the goal on
a way around the obstacle are varied for the next round. It plans the next stroke while the present one is carried out. The
planner node predicts where strokes lead; the estimator learns the friction from the strokes. The object is simulated.

    ros2 run pushfric_ros estimator_node --ros-args -r __ns:=/cell -p object:=wood_rect3 -p source:=observations &
    ros2 run pushfric_ros planner_node --ros-args -r __ns:=/cell &
    python3 examples/around_obstacle.py
"""

import argparse
import math
import time
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import rclpy
from geometry_msgs.msg import Point, Vector3
from push_to_pose import APPROACH, FRAME_RATE, NAME, STEEPEST, TIP_RADIUS, arm, stroke
from rclpy.node import Node

from pushfric_core import Observation, Pose, PushedObject, PushingLine, Trajectory
from pushfric_core.geometry.planar import Array, left_of
from pushfric_core.geometry.table_1 import TABLE_1
from pushfric_msgs.msg import Observation as ObservationMsg
from pushfric_msgs.msg import PlanarPose
from pushfric_msgs.srv import PredictStroke
from pushfric_ros.messages.conversions import observation_to_msg

START, GOAL = Pose(-0.15, 0.0, 0.3), np.array((0.15, 0.0, 0.0))
OBSTACLE, RADIUS = np.array((0.0, -0.01)), 0.03  # [m]
ROLLOUTS, AHEAD, GOOD = 256, 2, 16
"""Number of plans in a round, of strokes in a plan, and of plans that are varied."""

PERIOD, ROUNDS = 0.1, 8
"""Time of a round [s], and the least number of rounds before a stroke."""

LONGEST, SHORTEST = 0.04, 0.001  # strokes [m]
STEP = 0.008  # of the prediction [m]
FIRST = 4
"""Strokes that only serve to learn the friction."""

CLOSE = 0.002
"""The goal is reached at this distance [m], an angle counted with the arm of the support points."""

KNOWN = TABLE_1[NAME]
OUTLINE = KNOWN.outline


class Outcome(NamedTuple):
    """How a try went."""

    errors: list[float]  # distance from the goal before the first stroke and after each [m]
    clearances: list[float]  # of object and obstacle [m], the same
    rounds: list[float]  # how long each took [s]


class Cell:
    """The services and topics of the cell."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._client = node.create_client(PredictStroke, "planner/predict_stroke")
        self._out = node.create_publisher(ObservationMsg, "observation", 2000)

    def wait(self) -> None:
        """Wait until both nodes are there."""
        while not (self._client.wait_for_service(1.0) and self._out.get_subscription_count()):
            print("waiting for the estimator and the planner", flush=True)

    def learn(self, observations: Sequence[Observation]) -> None:
        """Send observations to the estimator."""
        for observation in observations:
            self._out.publish(observation_to_msg(observation, NAME))

    def ends(self, poses: Array, strokes: Array) -> Array | None:
        """Poses (k, 3) after strokes (k, 4) from poses (k, 3); None while there is no model."""
        contacts, directions = tips(poses, strokes)
        origins = contacts - APPROACH * directions
        request = PredictStroke.Request(
            starts=[PlanarPose(x=x, y=y, theta=theta) for x, y, theta in poses.tolist()],
            origins=[Point(x=x, y=y) for x, y in origins.tolist()],
            directions=[Vector3(x=x, y=y) for x, y in directions.tolist()],
            tip_radii=np.full(len(poses), TIP_RADIUS),
            positions=APPROACH + strokes[:, 3],
            step=STEP,
            mean_only=True,
        )
        future = self._client.call_async(request)
        rclpy.spin_until_future_complete(self._node, future)
        answer = future.result()
        return np.array([(end.x, end.y, end.theta) for end in answer.ends]) if answer.success else None


def turned(vectors: Array, angles: Array) -> Array:
    """Vectors (k, 2) turned by angles (k,)."""
    return np.cos(angles)[:, None] * vectors + np.sin(angles)[:, None] * left_of(vectors)


def tips(poses: Array, strokes: Array) -> tuple[Array, Array]:
    """Where the tip's centre touches (k, 2), and its directions (k, 2), table frame."""
    edges = strokes[:, 0].astype(int)
    contacts = OUTLINE.vertices[edges] + strokes[:, 1:2] * OUTLINE.edges[edges] + TIP_RADIUS * OUTLINE.normals[edges]
    directions = turned(-OUTLINE.normals[edges], poses[:, 2] + strokes[:, 2])
    return poses[:, :2] + turned(contacts, poses[:, 2]), directions / np.linalg.norm(directions, axis=1)[:, None]


def random_plans(count: int, rng: np.random.Generator) -> Array:
    """Plans (count, AHEAD, 4): edge, place along it from 0 to 1, tilt against its normal [rad], length [m] of each stroke."""
    shape = count, AHEAD
    edges = rng.choice(len(OUTLINE.edges), shape, p=OUTLINE.lengths / OUTLINE.perimeter)
    lengths = SHORTEST + (LONGEST - SHORTEST) * rng.uniform(size=shape) ** 2
    return np.stack((edges, rng.uniform(0.1, 0.9, shape), rng.uniform(-STEEPEST, STEEPEST, shape), lengths), axis=2)


def varied(plans: Array, share: float, rng: np.random.Generator) -> Array:
    """Good plans, others that differ from them by a share of the range of each number, and some new ones."""
    new = ROLLOUTS // 4
    many = plans[rng.integers(len(plans), size=ROLLOUTS - new - len(plans))].copy()
    many[..., 1:] += share * rng.normal(size=many[..., 1:].shape) * (0.8, 2 * STEEPEST, LONGEST)
    many[..., 1:] = np.clip(many[..., 1:], (0.1, -STEEPEST, SHORTEST), (0.9, STEEPEST, LONGEST))
    return np.concatenate((plans, many, random_plans(new, rng)))


def clearance(poses: Array) -> Array:
    """Distances (k,) of the object from the obstacle [m]; negative where they overlap."""
    centers = turned(OBSTACLE - poses[:, :2], -poses[:, 2])
    return np.where(OUTLINE.contains(centers), -1.0, 1.0) * OUTLINE.distances_to(centers) - RADIUS


def way(places: Array) -> Array:
    """Lengths (k,) of the shortest ways from places (k, 2) to the goal around a circle that holds obstacle and object [m]."""
    around = RADIUS + float(np.hypot(*OUTLINE.size)) / 2
    far = np.maximum(np.linalg.norm(places - OBSTACLE, axis=1), around)
    goal_far = float(np.linalg.norm(GOAL[:2] - OBSTACLE))
    between = np.sum((places - OBSTACLE) * (GOAL[:2] - OBSTACLE), axis=1) / (far * goal_far)
    arc = np.arccos(np.clip(between, -1, 1)) - np.arccos(around / far) - math.acos(around / goal_far)
    straight = np.linalg.norm(GOAL[:2] - places, axis=1)
    bent = np.sqrt(far**2 - around**2) + math.sqrt(goal_far**2 - around**2) + around * arc
    return np.where(arc > 0, bent, straight)


def errors(poses: Array) -> Array:
    """How far poses (k, 3) are from the goal (k,) [m], an angle counted with the arm of the support points."""
    angles = (poses[:, 2] - GOAL[2] + math.pi) % (2 * math.pi) - math.pi
    return np.sqrt(way(poses[:, :2]) ** 2 + (arm() * angles) ** 2)


def costs(cell: Cell, pose: Array, plans: Array) -> Array | None:
    """What plans (k, AHEAD, 4) from a pose cost (k,) [m]; None while there is no model."""
    poses = np.repeat(pose[None], len(plans), axis=0)
    found = np.zeros(len(plans))
    for number in range(AHEAD):
        ends = cell.ends(poses, plans[:, number])
        if ends is None:
            return None
        contacts, directions = tips(poses, plans[:, number])
        tip = np.linalg.norm(contacts - APPROACH * directions - OBSTACLE, axis=1) - RADIUS - TIP_RADIUS
        free = np.minimum.reduce((clearance(ends), clearance((poses + ends) / 2), tip))
        found += np.where(free < 0.002, 1.0, 0.0)
        # the sooner the better
        found += errors(ends) * (0.3 if number < AHEAD - 1 else 1.0)
        poses = ends
    return found


def carried_out(
    pushed: PushedObject, pose: Array, chosen: Array, number: int, rng: np.random.Generator
) -> Iterator[list[Observation]]:
    """Carry out a stroke that was planned for a pose; yields what is observed in each frame."""
    contacts, directions = tips(pose[None], chosen[None])
    (x, y), (dx, dy) = (contacts - APPROACH * directions)[0].tolist(), directions[0].tolist()
    line, end = PushingLine((x, y), (dx, dy), TIP_RADIUS), float(APPROACH + chosen[3])
    trajectory = Trajectory(OUTLINE)
    for pose_sample, state in stroke(pushed, line, end, number, 10**10 * number, KNOWN.noise, rng):
        yield trajectory.add_pose(pose_sample) + trajectory.add_pusher(state)


def reach(node: Node, strokes: int, seed: int, pace: float = 1.0) -> Outcome:
    """Bring the object to the goal with at most this many strokes.

    Args:
        node: in the cell's namespace; not spun by others.
        strokes: largest number of them.
        seed: of the plans and the camera's noise.
        pace: strokes and rounds take this share of their time; 0: no longer than they need.
    """
    rng = np.random.default_rng(seed)
    cell = Cell(node)
    cell.wait()
    pushed = PushedObject(OUTLINE, KNOWN.support, KNOWN.mu_c, START)
    plans, rounds = random_plans(ROLLOUTS, rng), []
    outcome = Outcome([], [], rounds)

    def note() -> None:
        pose = np.array(pushed.pose)[None]
        outcome.errors.append(float(errors(pose)[0]))
        outcome.clearances.append(float(clearance(pose)[0]))

    def plan(pose: Array, share: float) -> None:
        nonlocal plans
        begin = time.perf_counter()
        found = costs(cell, pose, plans)
        if found is not None:
            best = plans[np.argsort(found)[:GOOD]]
            plans = varied(best, share, rng)
            rounds.append(time.perf_counter() - begin)
        time.sleep(max(0.0, pace * PERIOD - (time.perf_counter() - begin)))

    note()
    for number in range(strokes):
        pose = np.array(pushed.pose)
        for k in range(ROUNDS):
            plan(pose, 0.3 * 0.5**k)
        learning = number < FIRST
        # at first the edges' middles, one after another
        chosen = np.array((number % len(OUTLINE.edges), 0.3 + 0.4 * (number % 2), 0.0, 0.02)) if learning else plans[0, 0]
        ends = cell.ends(pose[None], chosen[None])
        if not learning:  # what was to come next is a start for the next plans
            plans = varied(np.roll(plans[:GOOD], -1, axis=1), 0.3, rng)
        begin = time.perf_counter()
        for frame, data in enumerate(carried_out(pushed, pose, chosen, number, rng)):
            while time.perf_counter() < begin + frame * pace / FRAME_RATE:
                plan(ends[0] if ends is not None else pose, 0.2)
            cell.learn(data)
        note()
        print(
            f"stroke {number + 1}: {1e3 * outcome.errors[-1]:.1f} mm to go, {1e3 * outcome.clearances[-1]:.0f} mm clear",
            flush=True,
        )
        if outcome.errors[-1] < CLOSE:
            break
    return outcome


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--strokes", type=int, default=40, help="largest number of strokes")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    rclpy.init()
    outcome = reach(Node("around_obstacle", namespace="/cell"), given.strokes, given.seed)
    print(f"{ROLLOUTS} plans of {AHEAD} strokes in {1e3 * np.median(outcome.rounds):.0f} ms (median)")


if __name__ == "__main__":
    main()
