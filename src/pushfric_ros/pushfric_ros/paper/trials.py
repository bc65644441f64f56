"""Simulated pushes for the study: its objects, how they move, and what a camera sees of them."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from pushfric_core.errors import PushfricError
from pushfric_core.estimate import Estimate
from pushfric_core.estimator import Estimator, EstimatorConfig
from pushfric_core.observation import Observation
from pushfric_core.outline import Outline
from pushfric_core.planar import Array, Pose, wrap
from pushfric_core.push_plan import PlannedPush, placement
from pushfric_core.simulation import PushedObject
from pushfric_core.support import Support
from pushfric_core.table_1 import FEET, FLAT, TABLE_1, PoseNoise
from pushfric_core.trajectory import PoseSample, PusherSample, Trajectory
from pushfric_ros.bags.zhou2015 import CORNERS, GRID
from pushfric_ros.paper.experiments import FRAME_RATE, LINE, PLACEMENT, SPEED, STROKE

NOISES = {"FEET": FEET, "FLAT": FLAT}

Frames = list[tuple[float, Pose]]
"""Stroke position [m] and pose in each frame of a push."""


class Studied(NamedTuple):
    """An object of the study."""

    outline: Outline
    support: Support
    mu_c: float
    support_points: Array
    plans: Mapping[str, tuple[int, ...]]  # pushes along each edge
    longest_turn: float  # of a push [rad]


def of_table_1(name: str) -> Studied:
    """An object of Table 1, without a plan; the flat ones turn quickly, and their pushes end early."""
    known = TABLE_1[name]
    turn = math.radians(25) if name.startswith("delrin_rect") else math.inf
    return Studied(known.outline, known.support, known.mu_c, known.support_points, {}, turn)


def objects() -> dict[str, Studied]:
    """Those whose p_CF is studied, with the numbers of pushes of each plan."""
    rectangle = TABLE_1["wood_rect4"]
    triangle = Outline(np.array(CORNERS))
    feet = Support(np.array(((0.03, 0.03), (0.09, 0.03), (0.03, 0.09))), np.full(3, 1 / 3))
    unequal = Support(rectangle.support.points, np.array((0.4, 0.3, 0.2, 0.1)))
    on_long_sides = {"all": (5, 2, 5, 2), "eight": (3, 1, 3, 1)}
    return {
        "unequal_feet": of_table_1("wood_rect4")._replace(support=unequal, plans=on_long_sides),
        "triangle": Studied(
            triangle, feet, 0.3, triangle.grid(10, 10, GRID.inset), {"all": (5, 5, 5), "eight": (3, 2, 3)}, math.inf
        ),
        "delrin_rect_right": of_table_1("delrin_rect_right")._replace(plans=on_long_sides),
    }


def moved(studied: Studied, pushes: Sequence[PlannedPush], rng: np.random.Generator) -> list[Frames]:
    """What happens in each push; a push in which the tip wedges is left out."""
    found = []
    for push in pushes:
        x, y, theta = placement(studied.outline, push, LINE, 0.0)
        dx, dy, turn = rng.normal(0.0, PLACEMENT, 3).tolist()
        start = Pose(x + dx, y + dy, theta + turn / 0.02)
        body = PushedObject(studied.outline, studied.support, studied.mu_c, start)
        frames = []
        try:
            for frame in range(int(STROKE / SPEED * FRAME_RATE) + 1):
                body.push(LINE, frame / FRAME_RATE * SPEED)
                if abs(wrap(body.pose.theta - start.theta)) > studied.longest_turn:
                    break
                frames.append((frame / FRAME_RATE * SPEED, body.pose))
        except PushfricError:
            continue
        found.append(frames)
    return found


def watched(
    outline: Outline, pushes: Sequence[Frames], noise: PoseNoise, rng: np.random.Generator, first: int = 0
) -> list[Observation]:
    """The data points that a camera with this noise makes of pushes, numbered from `first` on."""
    trajectory, data = Trajectory(outline), []
    for push_id, frames in enumerate(pushes, first):
        for frame, (position, pose) in enumerate(frames):
            stamp = round((3600 * push_id + frame / FRAME_RATE) * 1e9)
            seen = np.asarray(pose) + rng.normal(0.0, 1.0, 3) * (noise.position, noise.position, noise.angle)
            data += trajectory.add_pusher(PusherSample(stamp, position, SPEED, LINE, push_id))
            data += trajectory.add_pose(PoseSample(stamp, Pose(*seen.tolist())))
    return data


def estimated(data: Iterable[Observation], points: Array, config: EstimatorConfig) -> tuple[Estimator, Estimate]:
    """The estimator after all data points, and its estimate."""
    estimator = Estimator(points, config)
    for observation in data:
        try:
            estimator.take(observation)
        except PushfricError:
            continue  # the estimator refuses this data point, as in a live run
    return estimator, estimator.estimate()
