"""Symptoms of single observations, without a model of friction: too fast, forces that are turned, tips off the outline."""

import cmath
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pushfric_core.belief.stretches import at_contacts
from pushfric_core.geometry.planar import Array, velocity_at
from pushfric_core.geometry.support import rms_arm
from pushfric_core.trajectories.following import Apart
from pushfric_core.trajectories.observation import Observation
from pushfric_core.wording import Reason, counted

MAJORITY = 0.5
"""A symptom in more than this share of the observations is not an outlier but a mistake in the input."""

MANY_RECEDE = 0.2
"""If more than this share of the contacts recede where their normals point towards the support's middle, these are wrong."""

TURNED = math.radians(50)
"""Friction keeps each force within the friction cone, so the mean force is turned by no more than this from the motion."""

FEWEST_FORCES = 4
"""With fewer measured forces, nothing is concluded from their directions."""

SCATTERED = 0.5
"""The mean unit vector of the forces, relative to the motion, is longer than this if their frame is right."""

INERTIA = 0.3
"""Pushes are too fast if the object's speed could give inertia this share of friction."""

GRAVITY = 9.81  # [m/s^2]
FRICTION = 0.3  # a usual coefficient of support friction

SMALLEST = 1e-3
"""A smaller depth [m] is not reported: outlines and lines are measured to about a millimetre."""

CHANCE = 1e-3
"""A depth is reported if chance makes one that large less often than this."""

EXACT = 1e-6
"""No depth is known better than this [m]; it keeps the test defined for data without noise."""

ALIKE = 1.01
"""Two explanations that leave errors this similar are equally good; then the simpler one is reported."""


class TipOff(NamedTuple):
    """That tips touch elsewhere than on the outline."""

    reason: Reason
    size: float  # [m]
    displaces: bool  # p_CF; if not, the errors of opposite sides cancel


def normals_inward(points: Array, observations: Sequence[Observation]) -> Reason | None:
    """Whether normals point into the object: towards the support's middle, and as the contact moves."""
    contacts, normals = (np.array([getattr(one, f"contact_{name}") for one in observations]) for name in ("point", "normal"))
    velocities = at_contacts(contacts, np.array([one.twist for one in observations]))
    behind = np.sum((contacts - points.mean(axis=0)) * normals, axis=1) < 0
    if np.mean(behind & (np.sum(velocities * normals, axis=1) > 0)) <= MANY_RECEDE:
        return None
    text = (
        f"the normals point inward in {behind.sum()} of {len(behind)} observations: contact_normal must point away "
        "from the object; negate normal_x and normal_y"
    )
    return Reason("normals_inward", text)


def too_fast(points: Array, observations: Sequence[Observation], only_timed: bool) -> Reason | None:
    """Whether inertia is not small next to friction in most observations.

    Args:
        points: (n, 2) support points [m].
        observations: m.
        only_timed: velocities without a duration may be in any unit of time.
    """
    fastest = math.sqrt(INERTIA * FRICTION * GRAVITY * rms_arm(points))
    speeds = np.hypot(*at_contacts(points.mean(axis=0), np.array([one.twist for one in observations])).T)
    fast = [one for one, speed in zip(observations, speeds.tolist(), strict=True) if speed > fastest]
    count = sum(one.duration is not None for one in fast) if only_timed else len(fast)
    if count <= MAJORITY * len(observations):
        return None
    text = (
        f"the object moves faster than {fastest:.2g} m/s in {len(fast)} of {len(observations)} observations, where "
        "inertia is not small next to friction: push more slowly, or give vx, vy in m/s"
    )
    return Reason("too_fast", text)


def forces_off(points: Array, observations: Sequence[Observation]) -> Reason | None:
    """Whether measured forces have other directions than the motion allows."""
    middle, turns = points.mean(axis=0), []
    for one in observations:
        if one.force is not None and any(one.force) and (motion := complex(*velocity_at(one.twist, middle))) != 0:
            turned = complex(*one.force) / motion
            turns.append(turned / abs(turned))
    if len(turns) < FEWEST_FORCES:
        return None
    mean = sum(turns) / len(turns)
    turn = math.degrees(cmath.phase(mean))
    if abs(mean) < SCATTERED:
        text = "the measured forces do not turn with the object: give force_x, force_y in the object frame"
        return Reason("forces_scattered", text)
    if abs(turn) > 180 - math.degrees(TURNED):
        text = "the measured forces oppose the motion: force_x, force_y are of the pusher ON the object; negate them"
        return Reason("forces_opposed", text)
    if abs(turn) > math.degrees(TURNED):
        text = f"the measured forces are turned by {turn:.0f} degrees against the motion: check the sensor's frame"
        return Reason("forces_turned", text)
    return None


def tip_off(observations: Sequence[Observation]) -> TipOff | None:
    """Whether tips are inside the outline or away from it, on all sides or on one.

    A push is as deep as all its observations: single ones seem deeper where reports of the pusher have late stamps.
    """
    depths: dict[int, tuple[tuple[float, float], list[float]]] = {}
    for one in observations:
        if one.depth is not None:
            depths.setdefault(one.push_id, (one.contact_normal, []))[1].append(one.depth)
    if not depths:
        return None
    normals = np.array([normal for normal, _ in depths.values()])
    least = np.array([max(min(of_push), 0.0) + min(max(of_push), 0.0) for _, of_push in depths.values()])
    all_around, shifted = _fit(np.ones((len(least), 1)), least), _fit(normals, least)
    if all_around.detected and not (shifted.detected and ALIKE * shifted.left < all_around.left):
        (depth,) = all_around.lengths.tolist()
        where, size, ahead, late = (
            ("inside", "large", "less far ahead", "late") if depth > 0 else ("away from", "small", "further ahead", "early")
        )
        text = (
            f"the tip seems to be {1e3 * abs(depth):.1f} mm {where} the outline while it pushes: "
            f"the outline or tip_radius is too {size}, the tip is {ahead} than line_origin says, or images have {late} "
            "stamps; measure these again"
        )
        return TipOff(Reason("tip_off_across", text), abs(depth), False)
    if shifted.detected:
        x, y = (1e3 * shifted.lengths).tolist()
        text = (
            f"the outline seems to be shifted by ({x:z.1f}, {y:z.1f}) mm in the object frame, because the tip is inside "
            "it on one side and away from it on the other: measure where the outline lies in the frame that is tracked"
        )
        return TipOff(Reason("outline_shifted", text), math.hypot(x, y) / 1e3, True)
    return None


class _Fit(NamedTuple):
    lengths: Array  # (p,) [m]
    left: float  # sum of the squares that are left
    detected: bool  # the lengths differ from zero by more than SMALLEST, and beyond chance


def _fit(slopes: Array, values: Array) -> _Fit:
    """The lengths that explain values (m,) with slopes (m, p) best."""
    lengths = np.asarray(np.linalg.lstsq(slopes, values, rcond=1e-6)[0], dtype=float)
    left, (m, p) = float(np.sum((values - slopes @ lengths) ** 2)), slopes.shape
    if m < p + 2 or float(np.linalg.norm(lengths)) <= SMALLEST:
        return _Fit(lengths, left, False)
    from scipy.special import fdtrc  # takes as long to load as the rest of the estimator, and most runs get by without it

    explained = float(np.sum((slopes @ lengths) ** 2)) / p
    return _Fit(lengths, left, bool(fdtrc(p, m - p, explained / (left / (m - p) + EXACT**2)) < CHANCE))


def tip_stays_away(apart: Apart) -> str:
    """That the tip often seems not to touch the object that it pushes, with the likely cause and what to do."""
    return (
        f"the object moves in {apart.pushes} of {counted(apart.of, 'push', 'pushes')} though the tip is "
        f"{1e3 * apart.distance:.1f} mm away from its outline: the outline is too small or shifted, tip_radius is too small, "
        "the line is off, or images have early stamps; measure these again"
    )
