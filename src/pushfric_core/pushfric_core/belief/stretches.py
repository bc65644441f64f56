"""The pushes of a run as the belief takes them: stretches of contact, each of short steps.

A stretch is the motion between two poses that were seen. Its steps say where the tip was and how it moved, in the frame of the
object. What the steps of a stretch predict is summed, so that errors of the poses on the way cancel.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.belief.constants import LEAST_RATIO, LONGEST_STRETCH, MOST_STRETCHES, SURELY_SLID, USUAL_WAY
from pushfric_core.geometry.contact import tangent
from pushfric_core.geometry.planar import Array, Indices, Twist, velocity_at
from pushfric_core.trajectories.observation import Observation


class Stretches(NamedTuple):
    """k stretches, of r steps."""

    contacts: Array  # (r, 2) object frame [m]
    normals: Array  # (r, 2) unit, outward
    ways: Array  # (r, 2) of the tip, or of the contact where the tip is not known, object frame [m]
    motions: Array  # (r, 3) of the object-frame origin, object frame, as they were seen [m, m, rad]
    turns: Array  # (r,) of the object since the middle of its stretch [rad]
    sticks: npt.NDArray[np.bool_]  # (r,) the tip is not known: the contact moves as it was seen to
    stretch: Indices  # (r,) of each step
    begins: Indices  # (k,) the first step of each
    push: Indices  # (k,) push_id
    lengths: Array  # (k,) of the way [m]
    ratios: Array  # (k,) |F . t| / |F . n| of the measured force; NaN: none was measured
    slid: npt.NDArray[np.bool_]  # (k,) ... while the tip slid, so that it is mu_c; else it is at most mu_c


def stretches(observations: Sequence[Observation], size: float) -> Stretches | None:
    """The stretches of observations; None if no tip or contact moves into the object.

    Without durations, the unit of time is open, and each observation is a stretch. The order of the observations does not
    matter. Of more than MOST_STRETCHES, as many are taken, evenly.

    Args:
        observations: m.
        size: of the support [m].
    """
    parts = list(_parts(observations, LONGEST_STRETCH * size))
    if len(parts) > MOST_STRETCHES:
        parts = [parts[k] for k in np.linspace(0, len(parts) - 1, MOST_STRETCHES).round().astype(int).tolist()]
    if not parts:
        return None
    steps = list(itertools.chain.from_iterable(parts))
    sizes = np.array([len(part) for part in parts])
    begins = np.concatenate(([0], np.cumsum(sizes)[:-1]))
    stretch = np.repeat(np.arange(len(parts)), sizes)
    contacts, normals, ways, motions = (np.array([step[k] for step in steps]) for k in range(4))
    if all(one.duration is None for one in observations):
        unit = USUAL_WAY * size / float(np.median(np.hypot(*ways.T)))
        ways, motions = ways * unit, motions * unit
    turned = np.cumsum(motions[:, 2]) - motions[:, 2] / 2
    first = turned[begins] - motions[begins, 2] / 2
    whole = np.add.reduceat(motions[:, 2], begins)
    ratios = np.array([_ratio(part) for part in parts])
    return Stretches(
        contacts,
        normals,
        ways,
        motions,
        turned - (first + whole / 2)[stretch],
        np.array([step.sticks for step in steps]),
        stretch,
        begins,
        np.array([part[0].push for part in parts]),
        np.add.reduceat(np.hypot(*ways.T), begins),
        ratios[:, 0],
        ratios[:, 1] > 0,
    )


class _Step(NamedTuple):
    contact: Array
    normal: Array
    way: Array
    motion: Array
    sticks: bool
    push: int
    force: Array | None


def _parts(observations: Sequence[Observation], longest: float) -> Iterator[list[_Step]]:
    ordered = sorted(observations, key=lambda one: (one.push_id, one.stamp, one.contact_point, one.twist))
    for _, push in itertools.groupby(ordered, key=lambda one: one.push_id):
        part: list[_Step] = []
        way = 0.0
        for one in push:
            step = _step(one)
            if step is None:
                continue
            if part and (one.duration is None or way >= longest):
                yield part
                part, way = [], 0.0
            part.append(step)
            way += math.hypot(*step.way)
        if part:
            yield part


def _step(one: Observation) -> _Step | None:
    """None if nothing moves into the object."""
    time = 1.0 if one.duration is None else one.duration
    contact, normal = np.array(one.contact_point), np.array(one.contact_normal)
    force = None if one.force is None else np.array(one.force)
    sticks = one.tip_velocity is None
    velocity = velocity_at(one.twist, contact) if one.tip_velocity is None else np.array(one.tip_velocity)
    if time > 0 and float(velocity @ normal) < 0:
        return _Step(contact, normal, velocity * time, np.array(one.twist) * time, sticks, one.push_id, force)
    return None


def _ratio(part: Sequence[_Step]) -> tuple[float, float]:
    """The mean ratio of the forces, and 1 if it is that of a sliding tip: of those steps alone, if there are any."""
    found: dict[bool, list[float]] = {True: [], False: []}
    for step in part:
        if step.force is None:
            continue
        along = tangent(step.normal)
        shear, pressure = float(step.force @ along), -float(step.force @ step.normal)
        if not pressure > 0:
            continue
        slip = 0.0 if step.sticks else float((step.way - velocity_at(Twist(*step.motion.tolist()), step.contact)) @ along)
        slid = abs(slip) > SURELY_SLID * math.hypot(*step.way) and shear * slip > 0
        found[slid].append(max(abs(shear) / pressure, LEAST_RATIO))
    ratios = found[True] or found[False]
    return (float(np.mean(ratios)), float(bool(found[True]))) if ratios else (math.nan, 0.0)
