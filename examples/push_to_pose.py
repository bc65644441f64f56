"""A planner that pushes an object to a goal pose, learning on the way how it slides.

It draws random strokes, refines the best ones, and chooses the stroke after which the exact quasi-static model predicts the
object nearest to the goal. The model comes from the data points of the strokes so far. The same planner with uniform pressure,
and with wrong friction, shows what learning is worth. The object, the camera's noise and the pusher are simulated;
pushfric_core is all it needs.

    python3 examples/push_to_pose.py --seeds 20 --figure push_to_pose.png
"""

import argparse
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from pushfric_core import (
    Estimator,
    FrictionModel,
    Observation,
    Outline,
    Pose,
    PushedObject,
    PushfricError,
    PushingLine,
    Support,
    Trajectory,
    friction_model,
    predict_strokes,
)
from pushfric_core.geometry.planar import transform
from pushfric_core.geometry.table_1 import TABLE_1
from pushfric_core.trajectories.trajectory import PoseSample, PusherSample

GOAL = Pose(0.0, 0.0, 0.0)
NAME = "wood_rect3"
STROKES, ROUNDS, FEWEST = 5, 3, 4
CANDIDATES, GOOD, REFINEMENTS = 200, 10, (0.1, 0.03, 0.01, 0.003)
TIP_RADIUS, APPROACH, SPEED, FRAME_RATE = 0.003, 0.01, 0.02, 14.0  # [m], [m], [m/s], [Hz]
LONGEST, STEEPEST = 0.05, math.radians(25)  # of a stroke [m], against the contact normal [rad]
STEP = 0.004  # of the prediction [m]
GUESS = 0.3
"""mu_c before the first data point."""


class Course(NamedTuple):
    """One try."""

    poses: list[Pose]  # true ones, before the first stroke and after each
    errors: list[float]  # how far each is from the goal [m]: the position, and the angle times the arm of the support points


def wrong(support: Support, mu_c: float) -> FrictionModel:
    """Friction as a careless user might guess it: p_CF is wrong by 8 mm, and mu_c is half of the true one."""
    points = support.points + (0.008, 0.0)
    return FrictionModel.of(Support(points, support.weights), mu_c / 2)


def uniform(points: np.ndarray) -> FrictionModel:
    """The same pressure on all support points: the usual assumption before any push."""
    return FrictionModel.of(Support(points, np.full(len(points), 1 / len(points))), GUESS)


def random_strokes(outline: Outline, rng: np.random.Generator) -> np.ndarray:
    """Strokes (CANDIDATES, 4): edge, place along it from 0 to 1, tilt against its normal [rad], length [m]; most are short."""
    edges = rng.choice(len(outline.edges), CANDIDATES, p=outline.lengths / outline.perimeter)
    along, tilts = rng.uniform(0.1, 0.9, CANDIDATES), rng.uniform(-STEEPEST, STEEPEST, CANDIDATES)
    return np.column_stack((edges, along, tilts, LONGEST * rng.uniform(0.0, 1.0, CANDIDATES) ** 2))


def nearby(strokes: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """CANDIDATES strokes: some good ones, and others that differ from them by a share of the range of each number."""
    many = np.repeat(strokes, CANDIDATES // len(strokes), axis=0)
    noise = share * rng.normal(size=(len(many), 3)) * (0.8, 2 * STEEPEST, LONGEST)
    low, high = (0.1, -STEEPEST, 0.0), (0.9, STEEPEST, LONGEST)
    many[:, 1:] = np.clip(many[:, 1:] + noise, low, high)
    return np.concatenate((strokes, many))


def lines_of(outline: Outline, pose: Pose, strokes: np.ndarray) -> tuple[list[PushingLine], np.ndarray]:
    """The lines of the tip on the table, and where strokes along them end [m]."""
    lines = []
    for number, along, tilt, _ in strokes:
        edge = int(number)
        contact, normal = outline.vertices[edge] + along * outline.edges[edge], outline.normals[edge]
        direction = transform(Pose(0, 0, pose.theta + tilt), -normal)
        start = transform(pose, contact + TIP_RADIUS * normal) - APPROACH * direction
        lines.append(PushingLine((start[0], start[1]), (direction[0], direction[1]), TIP_RADIUS))
    return lines, APPROACH + strokes[:, 3]


def best_stroke(
    model: FrictionModel, outline: Outline, pose: Pose, rng: np.random.Generator
) -> tuple[PushingLine, float, float]:
    """The stroke that leaves the object nearest to the goal, where it ends, and how near that is [m]: random, then refined.

    The mean friction of the model plans: the mean cost over its samples would hardly fall with a short stroke.
    """
    mean = FrictionModel.of(model.support, model.mean_mu_c)
    strokes = random_strokes(outline, rng)
    for share in (*REFINEMENTS, None):
        lines, ends = lines_of(outline, pose, strokes)
        left = predict_strokes(mean, outline, [pose] * len(lines), lines, ends, STEP).poses[:, 0]
        costs = distance(left, arm())
        if share is not None:
            strokes = nearby(strokes[np.argsort(costs)[:GOOD]], share, rng)
    best = int(np.argmin(costs))
    return lines[best], float(ends[best]), float(costs[best])


def arm() -> float:
    """Arm at which a rotation counts as much as a translation [m]: the rms distance of the support points from their middle."""
    return uniform(TABLE_1[NAME].support_points).length


def distance(poses: np.ndarray, length: float) -> np.ndarray:
    """Distance (...) of poses (..., 3) from the goal [m]; at the arm `length` [m], an angle counts as much as a position."""
    angles = (poses[..., 2] - GOAL.theta + math.pi) % (2 * math.pi) - math.pi
    return np.sqrt((poses[..., 0] - GOAL.x) ** 2 + (poses[..., 1] - GOAL.y) ** 2 + (length * angles) ** 2)


def stroke(
    pushed: PushedObject,
    line: PushingLine,
    end: float,
    push_id: int,
    start: int,
    noise: tuple[float, float],
    rng: np.random.Generator,
) -> Iterator[tuple[PoseSample, PusherSample]]:
    """Carry out a stroke; frames of the camera and reports of the pusher."""
    frames = math.ceil(end / SPEED * FRAME_RATE)
    for frame in range(frames + 1):
        position = end * frame / frames
        pushed.push(line, position)
        stamp = start + round(frame * 1e9 / FRAME_RATE)
        x, y, theta = np.add(pushed.pose, rng.normal(0.0, (noise[0], noise[0], noise[1])))
        yield PoseSample(stamp, Pose(x, y, theta)), PusherSample(stamp + 1, position, SPEED, line, push_id)


def place(seed: int, fixed: FrictionModel | None) -> Course:
    """Push the object from a random pose to the goal, with a fixed model, or with one that learns.

    The model that learns has placed the object ROUNDS - 1 times before, from other poses: at first with uniform pressure, and
    with what it has learned once there are FEWEST pushes.
    """
    known = TABLE_1[NAME]
    model = uniform(known.support_points) if fixed is None else fixed
    estimator = Estimator(known.support_points)
    for turn in range(ROUNDS):
        rng = np.random.default_rng([seed, turn])
        pushed = PushedObject(
            known.outline, known.support, known.mu_c, Pose(*rng.uniform((-0.1, -0.1, -1), (0.1, 0.1, 1)).tolist())
        )
        if fixed is None or turn == ROUNDS - 1:
            course, model = _placed(pushed, model, estimator if fixed is None else None, STROKES * turn, rng)
    return course


def _placed(
    pushed: PushedObject, model: FrictionModel, estimator: Estimator | None, first: int, rng: np.random.Generator
) -> tuple[Course, FrictionModel]:
    """Strokes towards the goal, and the model after them; without an estimator it stays as it is."""
    known = TABLE_1[NAME]
    trajectory = Trajectory(known.outline)
    poses = [pushed.pose]
    for push_id in range(first, first + STROKES):
        seen = Pose(*np.add(pushed.pose, rng.normal(0.0, (*(known.noise.position,) * 2, known.noise.angle)) / 3).tolist())
        line, end, cost = best_stroke(model, known.outline, seen, rng)
        if cost < distance(np.array(seen), arm()):  # else none of the candidates helps; the next ones may
            data: list[Observation] = []
            for pose, state in stroke(pushed, line, end, push_id, 10**10 * push_id, known.noise, rng):
                data += trajectory.add_pose(pose) + trajectory.add_pusher(state)
            if estimator is not None:
                model = learned(estimator, data) or model
        poses.append(pushed.pose)
    return Course(poses, distance(np.array(poses), arm()).tolist()), model


def learned(estimator: Estimator, data: Sequence[Observation]) -> FrictionModel | None:
    """The model that follows from all data points so far; None while there are too few, or they contradict each other."""
    for observation in data:
        try:
            estimator.add(observation)
        except PushfricError:
            continue  # the object rotated about a support point
    estimate = estimator.estimate()
    if estimate.pushes < FEWEST or estimate.contradiction is not None:
        return None
    return friction_model(estimate)


def run(seeds: Sequence[int]) -> dict[str, list[Course]]:
    """Tries from the same poses with each kind of model."""
    known = TABLE_1[NAME]
    fixed = {"learned": None, "uniform": uniform(known.support_points), "wrong": wrong(known.support, known.mu_c)}
    return {name: [place(seed, model) for seed in seeds] for name, model in fixed.items()}


def draw(courses: dict[str, list[Course]], path: str) -> None:
    """Median error after each stroke, and half of the tries as a band."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 3.5), layout="tight")
    axes = figure.subplots()
    looks = {"learned": ("#0072b2", "-"), "uniform": ("#009e73", "--"), "wrong": ("#cc79a7", ":")}  # Okabe and Ito's colours
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


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20, help="how many tries with each kind of friction")
    parser.add_argument("--figure", help="draw the errors there (.png, .svg, .pdf)")
    given = parser.parse_args(arguments)
    courses = run(range(given.seeds))
    for name, tries in courses.items():
        final = 1e3 * np.array([each.errors[-1] for each in tries])
        print(f"{name}: median final error {np.median(final):.2f} mm, 90 % below {np.percentile(final, 90):.2f} mm")
    if given.figure:
        draw(courses, given.figure)


if __name__ == "__main__":
    main()
