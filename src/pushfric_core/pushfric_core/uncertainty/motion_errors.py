"""How far the motions in observations are off: the camera's noise, fitted to what the tip shows, and what the tip corrects.

The contact of a rigid object moves with the tip across the edge. So the difference of the two velocities is an error of the
motion that was seen, and its size over the pushes gives the noise of the poses. A motion that is conditioned on the tip's has
no such error. Consecutive motions of a push are differences of poses that they share, so their errors are correlated.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pushfric_core.geometry.planar import Array, Indices
from pushfric_core.trajectories.observation import Observation

STEP = 0.005
"""A motion of unknown duration counts as one by this length [m]; only its direction matters."""

WANDER = 1.0
"""The motions that a finite one is the mean of differ from it by this share of its length per radian of its turn. A share of
1 / sqrt(12) would do for steady motions; chosen on simulated and real pushes together."""

UNSEEN = 0.02
"""Error of a motion, as a share of its length, that is assumed if no tip shows it."""

LEVERS = np.geomspace(0.15, 6.0, 25)
"""Ratios tried of the noise of the angle, times the radius of the support, to that of the place ..."""

LEVER_DEVIATION = 0.4
"""... whose logarithm has this prior standard deviation about 0: a camera sees edges and corners about as well."""

TAIL = 4.0
"""Degrees of freedom of the errors: few may be large."""

SHARED = 0.5
"""Correlation of the errors of two motions that begin and end at the same pose, with opposite signs ..."""

PAIRS = 10.0
"""... which counts as much as this number of pairs that were seen."""

ADJACENT = 1.5
"""Motions of a push are consecutive if they are no farther apart in time than this multiple of the usual."""

FEWEST = 4
"""From this many motions on, the tip shows the noise."""


class Motions(NamedTuple):
    """The motions of m observations, ordered by push and stamp, about the middle of the support."""

    displacements: Array  # (m, 3) [m, m, rad]
    errors: Array  # (m, 3, 3) columns: independent errors of the turn about the contact, of its sliding, and across the edge
    contacts: Array  # (m, 2) [m]
    normals: Array  # (m, 2) outward
    pushes: Indices  # (pushes + 1,) where each push begins
    links: Array  # (m,) correlation of an observation's errors with those of the one before; 0 at the begin of a push
    noise: tuple[float, float]  # standard deviations of a displacement along an axis [m] and of its angle [rad] ...
    seen: bool  # ... and whether the tip showed them
    order: Indices  # (m,) index of each in the observations given


def motions(observations: Sequence[Observation], middle: Array, radius: float) -> Motions:
    """The motions in observations, at least one, as the tip corrects them.

    Args:
        observations: in any order.
        middle: (2,) of the support, object frame [m].
        radius: rms distance of the support points from it [m].
    """
    order = np.array(sorted(range(len(observations)), key=lambda i: (observations[i].push_id, observations[i].stamp)))
    data = [observations[i] for i in order]
    twists = np.array([one.twist for one in data], dtype=float)
    contacts, normals = np.array([one.contact_point for one in data]), np.array([one.contact_normal for one in data])
    tips = np.array([one.tip_velocity or (math.nan, math.nan) for one in data])
    durations = np.array([one.duration or math.nan for one in data])
    stamps = np.array([one.stamp for one in data]) * 1e-9
    _, number = np.unique([one.push_id for one in data], return_inverse=True)

    velocities = twists[:, :2] + twists[:, 2:] * np.column_stack((-contacts[:, 1], contacts[:, 0]))
    lengths = np.hypot(*velocities.T) + np.abs(twists[:, 2]) * radius
    steps = np.where(np.isfinite(durations), durations, STEP / np.maximum(lengths, 1e-300))
    displacements = twists * steps[:, None]
    # the middle moves, not the origin of the object frame, whose noise is taken to be that of the middle
    displacements[:, :2] += displacements[:, 2:] * (-middle[1], middle[0])
    arms = contacts - middle
    gap = np.einsum("ij,ij->i", tips - velocities, normals) * steps
    across = np.column_stack((normals, arms[:, 0] * normals[:, 1] - arms[:, 1] * normals[:, 0]))
    seen = np.isfinite(gap)
    known = int(seen.sum()) >= FEWEST and bool(np.any(gap[seen] != 0))
    position, angle = _noise(across[seen, 2], gap[seen], radius) if known else (UNSEEN * STEP, UNSEEN * STEP / radius)
    scales = np.array((position, position, angle))
    whole = across * scales  # in units of the noise
    whole /= np.sqrt(np.sum(whole**2, axis=1))[:, None]
    turn = np.column_stack((arms[:, 1], -arms[:, 0], np.ones(len(data)))) / scales
    turn /= np.sqrt(np.sum(turn**2, axis=1))[:, None]
    errors = np.stack((turn, np.cross(turn, whole), whole), axis=2) * scales[:, None]
    # a finite motion is a mean of others, which differ the more from it, the more the object turns
    wander = WANDER * np.abs(displacements[:, 2]) * np.hypot(*velocities.T) * steps
    errors *= np.sqrt(1 + (wander / position) ** 2)[:, None, None]
    if known:
        gains = (across * scales**2) / np.sum((across * scales) ** 2, axis=1)[:, None]
        displacements[seen] += gains[seen] * gap[seen, None]
        errors[seen, :, 2] = 0.0
    adjacent = np.zeros(len(data), dtype=bool)
    since = np.diff(stamps)
    adjacent[1:] = (np.diff(number) == 0) & np.isfinite(durations[1:]) & (since > 0)
    if adjacent.any():
        adjacent[1:] &= since <= ADJACENT * np.median(since[adjacent[1:]])
    links = np.where(adjacent, -_shared(np.where(seen, gap, 0.0), adjacent), 0.0)
    begins = np.concatenate(([0], np.flatnonzero(np.diff(number)) + 1, [len(data)])).astype(np.int64)
    return Motions(displacements, errors, arms, normals, begins, links, (position, angle), known, order)


def _noise(arms: Array, gaps: Array, radius: float) -> tuple[float, float]:
    """Standard deviations of a displacement along an axis [m], and of its angle [rad], by maximum likelihood."""
    squares, best, found = gaps**2, -math.inf, (0.0, 0.0)
    for lever in LEVERS / radius:
        shape = 1 + (lever * arms) ** 2
        scale = max(float(np.median(squares / shape)) / 0.455, 1e-24)
        for _ in range(20):
            weights = (TAIL + 1) / (TAIL + squares / (shape * scale))
            scale = max(float(np.mean(weights * squares / shape)), 1e-24)
        fit = -0.5 * np.sum(np.log(shape * scale)) - (TAIL + 1) / 2 * np.sum(np.log1p(squares / (shape * scale * TAIL)))
        fit -= 0.5 * (math.log(lever * radius) / LEVER_DEVIATION) ** 2
        if fit > best:
            best, found = float(fit), (math.sqrt(scale), math.sqrt(scale) * lever)
    return found


def _shared(gaps: Array, adjacent: Array) -> float:
    """How much of the error of a motion the next one has with the opposite sign, at most a half."""
    one, other = gaps[1:][adjacent[1:]], gaps[:-1][adjacent[1:]]
    both = (one**2 + other**2) / 2
    if not both.any():
        return SHARED
    usual = both <= 16 * np.median(both)
    mean = float(np.mean(both[usual]))
    return float(np.clip((SHARED * PAIRS * mean - np.sum((one * other)[usual])) / ((PAIRS + usual.sum()) * mean), 0.0, SHARED))
