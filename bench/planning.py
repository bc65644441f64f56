"""What a planner gets: where whole strokes end, how fast predictions come, and whether they agree with the exact model."""

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from bench.display import Verdict
from bench.paper import pushes
from pushfric_core import (
    TABLE_1,
    Estimate,
    EstimatorConfig,
    PushfricError,
    PushingLine,
    Support,
    Touch,
    friction_model,
    predict_strokes,
)
from pushfric_core.estimation.push_plan import PlannedPush, placement
from pushfric_core.geometry.planar import Array, Pose, rotation, wrap
from pushfric_core.mechanics.prediction import FrictionModel, predict
from pushfric_core.mechanics.simulation import PushedObject, pushed_motion

SEEDS, STROKES = 3, 12
"""For each object: how often its friction is estimated, and the number of strokes that are predicted from each estimate."""

OBJECTS = tuple(TABLE_1)

PUSHES = 14
"""Number of pushes from which an estimate is made."""

STROKE = 0.05  # [m]
APPROACH = 0.01  # [m]
STEEPEST = np.radians(25)
"""Strokes are at most this far from the contact normal [rad]."""

SUPPORTS, SAMPLES, PREDICTIONS = 55, 8, 10_000
CHECKED = 200
ROUNDS = 5

Figures = dict[str, Any]


def measure(progress: Callable[[str], None]) -> Figures:
    """Strokes of all objects of Table 1, whose truth is known, and the speed of predictions.

    Args:
        progress: called with what comes next.
    Returns:
        {"strokes": [{"object", "strokes", "mu_c" (kinds of the estimates), "median_mm", "p90_mm", "median_deg", "p90_deg"}],
        "predictions": {"count", "cpu_s", "largest_difference"}}: that of a twist from the exact one, as a share of its size.
    """
    strokes = []
    for name in OBJECTS:
        progress(f"strokes of {name}")
        strokes.append(_strokes(name))
    progress("predictions")
    return {"strokes": strokes, "predictions": _predictions()}


def verdicts(figures: Figures) -> Iterator[Verdict]:
    """The targets, next to what was measured."""
    for row in figures["strokes"]:
        for unit, asked in (("mm", 1.0), ("deg", 0.5)):
            measured = row[f"median_{unit}"]
            yield Verdict.at_most(f"stroke of 50 mm, {row['object']}, {unit}", asked, measured)
    speed = figures["predictions"]
    yield Verdict.at_most(f"{speed['count']} predictions, s of CPU", 0.2, speed["cpu_s"])
    difference = speed["largest_difference"]
    yield Verdict.at_most("difference from the exact model", 0.001, difference)


def _strokes(name: str) -> Figures:
    """Where random strokes end: the prediction from PUSHES pushes against the truth."""
    offsets, angles, kinds = [], [], set()
    for seed in range(SEEDS):
        rng = np.random.default_rng((seed, list(TABLE_1).index(name)))
        plan = pushes.plan(name)
        chosen = [plan[index] for index in sorted(rng.permutation(len(plan))[:PUSHES].tolist())]
        model, kind = learned(name, chosen, seed)
        kinds.add(kind)
        for truth, found in _ends(name, model, rng):
            offsets.append(1e3 * np.hypot(*(found[:2] - truth[:2])))
            angles.append(np.degrees(abs(wrap(float(found[2]) - truth.theta))))
    return {"object": name, "strokes": len(offsets), "mu_c": sorted(kinds), **spread(mm=offsets, deg=angles)}


def spread(**errors: Sequence[float]) -> Figures:
    """Median and 90th percentile, by unit."""
    return {
        f"{name}_{unit}": float(np.percentile(values, share))
        for unit, values in errors.items()
        for name, share in (("median", 50), ("p90", 90))
    }


def learned(name: str, plan: list[PlannedPush], seed: int) -> tuple[FrictionModel, str]:
    """The model that the estimator makes from some pushes, and what its mu_c rests on."""
    estimate = estimated(name, plan, seed)
    kind = "none" if estimate.mu_c is None else estimate.mu_c.kind.value
    return friction_model(estimate), kind


def estimated(name: str, plan: list[PlannedPush], seed: int) -> Estimate:
    """The estimate from some pushes."""
    data = pushes.watch(name, pushes.motions(name, plan, seed), seed)
    return pushes.estimated(data, TABLE_1[name].support_points, EstimatorConfig())[1]


def _ends(name: str, model: FrictionModel, rng: np.random.Generator) -> Iterator[tuple[Pose, Array]]:
    """True poses, and predicted ones (3,), after strokes from a known pose; a stroke in which the tip wedges is left out."""
    known = TABLE_1[name]
    outline = known.outline
    line = PushingLine((0.0, 0.0), (0.0, 1.0), 0.003)
    starts, truths = [], []
    while len(starts) < STROKES:
        edge = int(rng.choice(len(outline.edges), p=outline.lengths / outline.perimeter))
        offset = float(rng.uniform(-0.35, 0.35) * outline.lengths[edge])
        start = placement(outline, PlannedPush(edge, offset, float(rng.uniform(-STEEPEST, STEEPEST))), line, APPROACH)
        pushed = PushedObject(outline, known.support, known.mu_c, start)
        try:
            pushed.push(line, APPROACH + STROKE)
        except PushfricError:
            continue
        starts.append(start)
        truths.append(pushed.pose)
    ends = predict_strokes(model, outline, starts, [line] * STROKES, [APPROACH + STROKE] * STROKES).means
    yield from zip(truths, ends, strict=True)


def _predictions() -> Figures:
    """CPU time of PREDICTIONS motions on one thread, and how far they are from those of the simulation."""
    rng = np.random.default_rng(0)
    known = TABLE_1["delrin_rect_center"]
    points = known.outline.grid(11, 5, known.inset)
    assert len(points) == SUPPORTS
    w, mu_c = rng.dirichlet(np.full(SUPPORTS, 0.3), SAMPLES), rng.uniform(0.2, 0.6, SAMPLES)
    model = FrictionModel(points, w, mu_c, np.full(SAMPLES, 1 / SAMPLES))
    count = PREDICTIONS // SAMPLES
    edges = rng.integers(len(known.outline.edges), size=count)
    contacts = known.outline.vertices[edges] + rng.uniform(0.1, 0.9, (count, 1)) * known.outline.edges[edges]
    normals = known.outline.normals[edges]
    velocities = np.array([rotation(turn) @ -normal for turn, normal in zip(rng.uniform(-1, 1, count), normals, strict=True)])
    seconds = []
    for _ in range(ROUNDS):
        begin = time.process_time()
        found = predict(model, contacts, normals, velocities)
        seconds.append(time.process_time() - begin)
    differences = []
    for push, sample in zip(rng.integers(count, size=CHECKED), rng.integers(SAMPLES, size=CHECKED), strict=True):
        support = Support(points, w[sample] / w[sample].sum())
        touch = Touch(0.0, contacts[push], normals[push], int(edges[push]))
        exact = np.asarray(pushed_motion(support, touch, velocities[push], float(mu_c[sample])).twist)
        size = np.linalg.norm(exact * (1, 1, model.length))
        differences.append(np.linalg.norm((found.samples.twists[push, sample] - exact) * (1, 1, model.length)) / size)
    return {"count": PREDICTIONS, "cpu_s": float(np.median(seconds)), "largest_difference": float(max(differences))}
