"""The choice of the next push for the study: how many pushes it takes until p_CF is known, compared with random pushes."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy import stats

from bench.paper.pushes import NOISES, Studied, filmed, moved
from pushfric_core import Estimator, EstimatorConfig, HalfPlanes, PushfricError, next_pushes
from pushfric_core.estimation.push_plan import PlannedPush
from pushfric_core.estimation.region import RegionConfig, line_of_motion

PUSHES = 15
"""Pushes of each run."""

NEAR = 0.02
"""p_CF is known once its error stays below this share of the object's longer side."""

STEEPEST = math.radians(30)
"""Random pushes come at up to this angle from the normal."""

WIDEST = 0.45
"""... and meet an edge up to this share of its length from its middle."""

Numbers = dict[str, Any]

Choose = Callable[[HalfPlanes, np.random.Generator], PlannedPush]


def pushes_needed(studied: Studied, rng: np.random.Generator) -> Numbers:
    """Numbers of pushes after which p_CF stays near the truth: `chosen`, each from the outcomes so far, and `random`."""
    return {"chosen": _pushes_until_near(studied, _best, rng), "random": _pushes_until_near(studied, _at_random, rng)}


def summary(runs: Sequence[Numbers]) -> Numbers:
    """Medians, how many runs need fewer or more pushes than random ones, and the probability of that by chance."""
    chosen, at_random = (np.array([one[key] for one in runs]) for key in ("chosen", "random"))
    fewer, more = int(np.sum(chosen < at_random)), int(np.sum(chosen > at_random))
    chance = float(stats.binomtest(fewer, fewer + more).pvalue) if fewer + more else 1.0
    medians = {"chosen": float(np.median(chosen)), "random": float(np.median(at_random))}
    return {"runs": len(runs), **medians, "fewer": fewer, "more": more, "sign_test": chance}


def _pushes_until_near(studied: Studied, choose: Choose, rng: np.random.Generator) -> int:
    """The number of the first push from which on p_CF is near; PUSHES + 1 if it is not near after the last."""
    estimator = Estimator(studied.support_points, EstimatorConfig(confidence=False, screening=False))
    half_planes = HalfPlanes(studied.outline, RegionConfig().region_margin)
    truth, near = studied.support.center_of_friction, NEAR * float(studied.outline.size.max())
    known = 1
    for push_id in range(PUSHES):
        pushed = moved(studied, [choose(half_planes, rng)], rng)
        for observation in filmed(studied.outline, pushed, NOISES["FEET"], rng, push_id):
            try:
                estimator.add(observation)
                half_planes.add(line_of_motion(observation))
            except PushfricError:
                continue  # an observation that a live estimator refuses, too
        if not estimator.observations or math.dist(estimator.estimate().center_of_friction, truth) > near:
            known = push_id + 2
    return known


def _best(half_planes: HalfPlanes, rng: np.random.Generator) -> PlannedPush:
    """The first of `next_pushes`, or once it has none, a random push."""
    ranked = next_pushes(half_planes)
    return ranked[0].push if ranked else _at_random(half_planes, rng)


def _at_random(half_planes: HalfPlanes, rng: np.random.Generator) -> PlannedPush:
    edge = int(rng.integers(len(half_planes.outline.vertices)))
    offset = float(rng.uniform(-WIDEST, WIDEST) * half_planes.outline.lengths[edge])
    return PlannedPush(edge, offset, float(rng.uniform(-STEEPEST, STEEPEST)))
