"""Bad pushes and changed objects for the study: does outlier rejection find them, and does it leave the good pushes in?"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from bench.paper.pushes import NOISES, Frames, filmed, moved
from pushfric_core import Observation, Pose, Support
from pushfric_core.estimation.push_plan import even_pushes
from pushfric_core.geometry.planar import Array
from pushfric_core.geometry.table_1 import TableObject

BAD_TURN = math.radians(25)
"""The orientation of a bad push drifts or wanders by this much."""

LEAP = (0.006, 0.010)
"""... or its position jumps by between these distances [m]."""

BEFORE, AFTER = 10, 3
"""Pushes before a change of the object, and after it."""

SHIFTS = (0.008, 0.004)
"""Shift of p_CF by a load that is moved [m]."""

SPOILT = ("drift", "wander", "jump", "lost contact")
"""Faults of a push."""

CHANGE = "change"
"""What should be said of a load that is moved."""

LEAST_WEIGHT = 0.02
"""Share of its weight that each support keeps when the load is moved."""


def runs(studied: TableObject, rng: np.random.Generator) -> Iterator[tuple[str, int | str | None, list[Observation]]]:
    """Runs without a fault, with a bad push of each kind, and with loads that are moved, in each noise of the camera.

    Yields:
        The name of the case; what should be said: the bad push, CHANGE, or None if no observation is wrong; the observations.
    """
    plan = even_pushes(studied.outline, studied.pushes)
    pushes = [plan[index] for index in rng.permutation(len(plan)).tolist()]
    before = moved(studied, pushes, rng)
    after = {}
    for shift in SHIFTS:
        other = studied._replace(support=with_moved_load(studied.support, shift, rng))
        after[shift] = moved(other, [pushes[index] for index in rng.permutation(len(pushes))[:AFTER].tolist()], rng)
    for noise, spread in NOISES.items():
        camera = int(rng.integers(2**32))  # the same noise with every bad push
        clean = filmed(studied.outline, before, spread, np.random.default_rng(camera))
        yield f"none/{noise}", None, clean
        for kind in SPOILT:
            bad, seen = with_bad_push(kind, before, rng)
            data = filmed(studied.outline, seen, spread, np.random.default_rng(camera))
            harmless = {one.twist for one in data} <= {one.twist for one in clean}
            yield f"{kind}/{noise}", None if harmless else bad, data
        for shift, pushed in after.items():
            data = filmed(studied.outline, [*before[:BEFORE], *pushed], spread, rng)
            yield f"shift of {1e3 * shift:g} mm/{noise}", CHANGE, data


def with_moved_load(support: Support, shift: float, rng: np.random.Generator) -> Support:
    """A support after a load was moved so that p_CF shifts by this much [m], in any direction.

    It shifts less if a support would have to lose more than nearly all of its weight.
    """
    angle = float(rng.uniform(0.0, 2 * math.pi))
    arms = support.points - support.center_of_friction
    moments = (support.weights[:, None] * arms).T @ arms
    tilt = np.linalg.solve(moments, shift * np.array((math.cos(angle), math.sin(angle))))
    weights = support.weights * np.maximum(1 + arms @ tilt, LEAST_WEIGHT)
    return Support(support.points, weights / weights.sum())


def with_bad_push(kind: str, pushes: Sequence[Frames], rng: np.random.Generator) -> tuple[int, list[Frames]]:
    """A push that is chosen at random, and all pushes, of which this one has a fault, one of SPOILT."""
    bad = int(rng.integers(len(pushes)))
    return bad, [spoilt(kind, frames, rng) if index == bad else frames for index, frames in enumerate(pushes)]


def spoilt(kind: str, frames: Frames, rng: np.random.Generator) -> Frames:
    """A push with a fault, one of SPOILT, as the camera sees it."""
    count = len(frames)
    if kind in ("drift", "wander"):  # the tracked orientation drifts, or walks at random
        turns = BAD_TURN * (rng.choice((-1.0, 1.0)) * np.linspace(0.0, 1.0, count) if kind == "drift" else _walk(count, rng))
        return [(at, pose._replace(theta=pose.theta + turn)) for (at, pose), turn in zip(frames, turns, strict=True)]
    jumps = kind == "jump"  # the tracked position jumps and stays off; else the object stops while the tip goes on
    angle, length = (float(rng.uniform(0.0, 2 * math.pi)), float(rng.uniform(*LEAP))) if jumps else (0.0, 0.0)
    third, x, y = count // 3, length * math.cos(angle), length * math.sin(angle)
    start = int(rng.integers(third, max(2 * third, third + 1)))  # somewhere in the middle third
    off = [(at, Pose(one.x + x, one.y + y, one.theta) if jumps else frames[start][1]) for at, one in frames[start:]]
    return frames[:start] + off


def _walk(count: int, rng: np.random.Generator) -> Array:
    walk = np.cumsum(rng.normal(size=count))
    return walk / np.abs(walk).max()
