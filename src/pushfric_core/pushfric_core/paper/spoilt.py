"""Bad pushes and changed objects for the study: does outlier rejection find them, and does it leave the good pushes in?"""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from pushfric_core.estimation.estimator import EstimatorConfig
from pushfric_core.estimation.push_plan import even_pushes
from pushfric_core.geometry.planar import Array, Pose
from pushfric_core.geometry.support import Support
from pushfric_core.paper.experiments import Frames, filmed
from pushfric_core.paper.tables import markdown
from pushfric_core.paper.trials import NOISES, Studied, estimated, moved
from pushfric_core.trajectories.observation import Observation

BAD_TURN = math.radians(25)
"""The orientation of a bad push drifts or wanders by this much."""

LEAP = (0.006, 0.010)
"""... or its position jumps by between these distances [m]."""

BEFORE, AFTER = 10, 3
"""Pushes before a change of the object, and after it."""

SHIFTS = (0.008, 0.004)
"""Shift of p_CF by a load that is moved [m]."""

LEAST_WEIGHT = 0.02
"""Share of its weight that each support keeps when the load is moved."""

Numbers = dict[str, Any]


def verdicts(studied: Studied, rng: np.random.Generator) -> Iterable[tuple[str, Numbers]]:
    """What outlier rejection says of runs with a bad push of each kind and with none, and of loads that are moved; by noise.

    `found` says whether no observation that the fault changed is in the estimate, or whether the change was seen; `harmless`
    whether the fault changed none, because those that it would have changed were never made; `lost` how many of the `good`
    pushes were left out; and `changed` whether an object that stayed the same was said to be another one.
    """
    plan = even_pushes(studied.outline, studied.plans["all"])
    pushes = [plan[index] for index in rng.permutation(len(plan)).tolist()]
    before = moved(studied, pushes, rng)
    after = {}
    for shift in SHIFTS:
        other = studied._replace(support=with_moved_load(studied.support, shift, rng))
        after[shift] = moved(other, [pushes[index] for index in rng.permutation(len(pushes))[:AFTER].tolist()], rng)
    for noise, spread in NOISES.items():
        camera = int(rng.integers(2**32))  # the same noise with every fault
        clean = filmed(studied.outline, before, spread, np.random.default_rng(camera))
        left_out, changed = _screened(clean, studied.support_points)
        yield (
            f"none/{noise}",
            {"found": None, "harmless": None, "lost": len(left_out), "good": len(before), "changed": changed},
        )
        for kind, spoil in SPOILT.items():
            bad = int(rng.integers(len(before)))
            seen = [spoil(frames, rng) if index == bad else frames for index, frames in enumerate(before)]
            data = filmed(studied.outline, seen, spread, np.random.default_rng(camera))
            left_out, changed = _screened(data, studied.support_points)
            harmless = {one.twist for one in data} <= {one.twist for one in clean}
            yield (
                f"{kind}/{noise}",
                {
                    "found": harmless or bad in left_out,
                    "harmless": harmless,
                    "lost": len(left_out - {bad}),
                    "good": len(before) - 1,
                    "changed": changed,
                },
            )
        for shift, pushed in after.items():
            data = filmed(studied.outline, [*before[:BEFORE], *pushed], spread, rng)
            _, changed = _screened(data, studied.support_points)
            yield (
                f"shift of {1e3 * shift:g} mm/{noise}",
                {"found": changed, "harmless": None, "lost": 0, "good": 0, "changed": False},
            )


def summary(runs: Sequence[dict[str, Numbers]]) -> Numbers:
    """Counts for each kind of bad push or change and each noise, of all objects together."""
    cases: dict[str, list[Numbers]] = {}
    for run in runs:
        for name, numbers in run.items():
            cases.setdefault(name.split("/", 1)[1], []).append(numbers)
    return {
        case: {
            "runs": len(found),
            **{key: _count(one[key] for one in found) for key in ("found", "harmless", "good", "lost", "changed")},
        }
        for case, found in cases.items()
    }


def report(cells: Numbers) -> list[str]:
    """The summary as lines of Markdown."""
    heads = ("bad push, or change", "runs", "found", "without bad data points", "good pushes lost", "said to be another object")
    rows = []
    for name, cell in cells.items():
        found = ["-" if cell[key] is None else cell[key] for key in ("found", "harmless")]
        rows.append(
            (name, cell["runs"], *found, *((f"{cell['lost']} of {cell['good']}", cell["changed"]) if cell["good"] else "--"))
        )
    return markdown(heads, rows)


def _count(said: Iterable[bool | int | None]) -> int | None:
    """How many in all; None where it is not asked."""
    known = [one for one in said if one is not None]
    return sum(known) if known else None


def _screened(data: Iterable[Observation], points: Array) -> tuple[set[int], bool]:
    """The pushes that are left out at the end, and whether the object is said to be another one."""
    estimator, estimate = estimated(data, points, EstimatorConfig(confidence=False, screening=True))
    return {one.push_id for one in estimator.rejected}, estimator.verdict(estimate).change is not None


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


def _drift(frames: Frames, rng: np.random.Generator) -> Frames:
    """The tracked orientation drifts."""
    turns = float(rng.choice((-BAD_TURN, BAD_TURN))) * np.linspace(0.0, 1.0, len(frames))
    return [(position, pose._replace(theta=pose.theta + turn)) for (position, pose), turn in zip(frames, turns, strict=True)]


def _wander(frames: Frames, rng: np.random.Generator) -> Frames:
    """The tracked orientation walks at random."""
    walk = np.cumsum(rng.normal(size=len(frames)))
    turns = BAD_TURN * walk / np.abs(walk).max()
    return [(position, pose._replace(theta=pose.theta + turn)) for (position, pose), turn in zip(frames, turns, strict=True)]


def _jump(frames: Frames, rng: np.random.Generator) -> Frames:
    """Somewhere in the middle third, the tracked position jumps and stays off."""
    angle, length, start = float(rng.uniform(0.0, 2 * math.pi)), float(rng.uniform(*LEAP)), _middle(frames, rng)
    x, y = length * math.cos(angle), length * math.sin(angle)
    return frames[:start] + [(position, Pose(pose.x + x, pose.y + y, pose.theta)) for position, pose in frames[start:]]


def _lost_contact(frames: Frames, rng: np.random.Generator) -> Frames:
    """Somewhere in the middle third, the object stops while the tip goes on."""
    start = _middle(frames, rng)
    return frames[:start] + [(position, frames[start][1]) for position, _ in frames[start:]]


def _middle(frames: Frames, rng: np.random.Generator) -> int:
    third = len(frames) // 3
    return int(rng.integers(third, max(2 * third, third + 1)))


SPOILT: dict[str, Callable[[Frames, np.random.Generator], Frames]] = {
    "drift": _drift,
    "wander": _wander,
    "jump": _jump,
    "lost contact": _lost_contact,
}
"""Faults of a push, as the camera sees them."""
