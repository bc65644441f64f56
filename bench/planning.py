"""How fast predictions come, and whether they agree with the exact model."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from bench.display import Verdict
from pushfric_core import TABLE_1, Support, Touch
from pushfric_core.geometry.planar import rotation
from pushfric_core.mechanics.prediction import FrictionModel, predict
from pushfric_core.mechanics.simulation import pushed_motion

SUPPORTS, SAMPLES, PREDICTIONS = 55, 8, 10_000
CHECKED = 200
ROUNDS = 5

Figures = dict[str, Any]


def verdicts(figures: Figures) -> Iterator[Verdict]:
    """The targets, next to what was measured."""
    yield Verdict.at_most(f"{figures['count']} predictions, s of CPU", 0.2, figures["cpu_s"])
    yield Verdict.at_most("difference from the exact model", 0.001, figures["largest_difference"])


def measure(progress: Callable[[str], None]) -> Figures:
    """PREDICTIONS motions on one thread, and how far they are from those of the simulation.

    Returns:
        {"count", "cpu_s", "largest_difference"}: that of a twist from the exact one, as a share of its size.
    """
    progress("predictions")
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
