"""A sampling planner with the planner node: brings an object to a pose behind an obstacle, while its friction is learned.

Up to ten times a second, it tries 256 pairs of strokes by the cross-entropy method: the pairs that come nearest to the goal on
a way around the obstacle are varied for the next round. It plans the next stroke while the present one is carried out. The
planner node predicts where strokes lead; the estimator learns the friction from the strokes. The object is simulated.

    ros2 run pushfric_ros estimator_node --ros-args -r __ns:=/cell -p object:=wood_rect3 -p source:=observations &
    ros2 run pushfric_ros planner_node --ros-args -r __ns:=/cell &
    python3 examples/around_obstacle.py
"""

import argparse
import contextlib
import math
import time
from typing import NamedTuple

import numpy as np
import rclpy
from push_to_pose import APPROACH, FRAME_RATE, TIP_RADIUS, Cell, carried_out, even, nearby, random_strokes, tips, turned
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from pushfric_core import TABLE_1, Pose, PushedObject
from pushfric_core.geometry.planar import Array

START, GOAL = Pose(-0.15, 0.0, 0.3), np.array((0.15, 0.0, 0.0))
OBSTACLE, RADIUS = np.array((0.0, -0.01)), 0.03  # [m]
ROLLOUTS, AHEAD, GOOD = 256, 2, 16
"""Number of plans in a round, of strokes in a plan, and of plans that are varied."""

PERIOD, ROUNDS = 0.1, 8
"""Time of a round [s], and the least number of rounds before a stroke."""

STEP = 0.008  # of the prediction [m]
FIRST = 4
"""Strokes that only serve to learn the friction."""

CLOSE = 0.002
"""The goal is reached at this distance [m], an angle counted with the arm of the support points."""

NAME = "wood_rect3"
KNOWN = TABLE_1[NAME]
OUTLINE = KNOWN.outline
ARM = even(KNOWN).length


class Outcome(NamedTuple):
    """How a try went."""

    errors: list[float]  # distance from the goal before the first stroke and after each [m]
    clearances: list[float]  # of object and obstacle [m], the same
    rounds: list[float]  # how long each took [s]


def varied(plans: Array, share: float, rng: np.random.Generator) -> Array:
    """Good plans, others that differ from them by a share of the range of each number, and some new ones."""
    new = ROLLOUTS // 4
    many = plans[rng.integers(len(plans), size=ROLLOUTS - new - len(plans))]
    return np.concatenate((plans, nearby(many, share, rng), random_strokes(KNOWN, (new, AHEAD), rng)))


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
    return np.sqrt(way(poses[:, :2]) ** 2 + (ARM * angles) ** 2)


def costs(cell: Cell, pose: Array, plans: Array) -> Array | None:
    """What plans (k, AHEAD, 4) from a pose cost (k,) [m]; None while there is no model."""
    poses = np.repeat(pose[None], len(plans), axis=0)
    found = np.zeros(len(plans))
    for number in range(AHEAD):
        ends = cell.ends(poses, plans[:, number])
        if ends is None:
            return None
        contacts, directions = tips(KNOWN, poses, plans[:, number])
        tip = np.linalg.norm(contacts - APPROACH * directions - OBSTACLE, axis=1) - RADIUS - TIP_RADIUS
        free = np.minimum.reduce((clearance(ends), clearance((poses + ends) / 2), tip))
        found += np.where(free < 0.002, 1.0, 0.0)
        # the sooner the better
        found += errors(ends) * (0.3 if number < AHEAD - 1 else 1.0)
        poses = ends
    return found


def reach(node: Node, strokes: int, seed: int, pace: float = 1.0) -> Outcome:
    """Bring the object to the goal with at most this many strokes.

    Args:
        node: in the cell's namespace; not spun by others.
        strokes: largest number of them.
        seed: of the plans and the camera's noise.
        pace: strokes and rounds take this share of their time; 0: no longer than they need.
    """
    rng = np.random.default_rng(seed)
    cell = Cell(node, NAME, STEP)
    cell.wait()
    cell.forget()  # the pushes of a try before have the same numbers
    pushed = PushedObject(OUTLINE, KNOWN.support, KNOWN.mu_c, START)
    plans, rounds = random_strokes(KNOWN, (ROLLOUTS, AHEAD), rng), []
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
        for frame, data in enumerate(carried_out(KNOWN, pushed, pose, chosen, number, rng)):
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
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        main()
