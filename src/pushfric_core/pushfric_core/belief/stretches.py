"""The pushes of a run as the belief takes them: stretches of contact, each of short steps.

A stretch is the motion between two poses that were seen. Its steps say where the tip was and how it moved, in the frame of the
object. What the steps of a stretch predict is summed, so that errors of the poses on the way cancel.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.belief.constants import LATEST, LEAST_RATIO, LONGEST_STRETCH, SURELY_SLID, USUAL_WAY
from pushfric_core.geometry.planar import Array, Indices, left_of
from pushfric_core.trajectories.observation import Observation

TINY = 1e-12
"""Keeps divisions by what may vanish from being by zero."""


class Steps(NamedTuple):
    """r steps as they were observed, object frame; in the order of pushes and stamps, whatever that of the observations."""

    contacts: Array  # (r, 2) [m]
    normals: Array  # (r, 2) unit, outward
    ways: Array  # (r, 2) of the tip, or of the contact where the tip is not known [m]
    motions: Array  # (r, 3) of the object-frame origin [m, m, rad]
    sticks: npt.NDArray[np.bool_]  # (r,) the tip is not known: the contact moves as it was seen to
    half_widths: Array  # (r,) within which the contact lies along the edge [m]
    forces: Array  # (r, 2) that were measured; NaN: none
    push: Indices  # (r,) push_id
    part: Indices  # (r,) of the stretch that a step belongs to, from 0 on
    timed: bool  # the unit of time is known

    def moved(self, motions: Array, contacts: Array | None = None) -> "Steps":
        """The same with other motions (r, 3), and contacts (r, 2)."""
        contacts = self.contacts if contacts is None else contacts
        ways = np.where(self.sticks[:, None], at_contacts(contacts, motions), self.ways)
        return self._replace(contacts=contacts, ways=ways, motions=motions)


class Stretches(NamedTuple):
    """k stretches, of r steps."""

    contacts: Array  # (r, 2) object frame [m]
    normals: Array  # (r, 2) unit, outward
    ways: Array  # (r, 2) of the tip, or of the contact where the tip is not known, object frame [m]
    motions: Array  # (r, 3) of the object-frame origin, object frame, as they were seen [m, m, rad]
    turns: Array  # (r,) of the object since the middle of its stretch [rad]
    sticks: npt.NDArray[np.bool_]  # (r,) the tip is not known: the contact moves as it was seen to
    half_widths: Array  # (r,) within which the contact lies along the edge [m]
    stretch: Indices  # (r,) of each step
    begins: Indices  # (k,) the first step of each
    push: Indices  # (k,) push_id
    lengths: Array  # (k,) of the way [m]
    ratios: Array  # (k,) |F . t| / |F . n| of the measured force; NaN: none was measured
    slid: npt.NDArray[np.bool_]  # (k,) ... while the tip slid, so that it is mu_c; else it is at most mu_c
    unit: float  # by which the lengths of the steps were multiplied; 1 if the unit of time is known

    @property
    def stuck(self) -> npt.NDArray[np.bool_]:
        """Whether the tip is known in no step of each stretch (k,): then only the turn about the contact is foretold."""
        return np.logical_and.reduceat(self.sticks, self.begins)


def at_contacts(contacts: Array, motions: Array) -> Array:
    """Velocities (r, 2) of contacts (r, 2) in motions (r, 3) of the object-frame origin."""
    return np.asarray(motions[:, :2] + motions[:, 2:] * left_of(contacts))


def size_of(points: Array) -> float:
    """The size of a support (n, 2), which lengths are compared with [m]."""
    return max(float(np.ptp(points, axis=0).max()), 1e-9)


def steps_of(observations: Sequence[Observation], size: float) -> Steps:
    """The steps of observations, whose order does not matter.

    Without durations, the unit of time is open, and each observation is a stretch.

    Args:
        observations: m.
        size: of the support [m].
    """
    ordered = sorted((one for one in observations if one.duration != 0), key=_place)
    sticks = np.array([one.tip_velocity is None for one in ordered], dtype=bool)
    times = np.array([1.0 if one.duration is None else one.duration for one in ordered])[:, None]
    contacts, normals, tips, forces = (
        np.array(rows, dtype=float).reshape(-1, 2)
        for rows in (
            [one.contact_point for one in ordered],
            [one.contact_normal for one in ordered],
            [one.tip_velocity or (0.0, 0.0) for one in ordered],
            [one.force or (math.nan, math.nan) for one in ordered],
        )
    )
    twists = np.array([one.twist for one in ordered]).reshape(-1, 3)
    ways = np.where(sticks[:, None], at_contacts(contacts, twists), tips) * times
    part, number, way, last = [], -1, 0.0, None
    for one, length in zip(ordered, np.hypot(*ways.T).tolist(), strict=True):
        if one.push_id != last or one.duration is None or way >= LONGEST_STRETCH * size:
            number, way, last = number + 1, 0.0, one.push_id
        part.append(number)
        way += length
    return Steps(
        contacts,
        normals,
        ways,
        twists * times,
        sticks,
        np.array([one.half_width for one in ordered]),
        forces,
        np.array([one.push_id for one in ordered], dtype=int),
        np.array(part, dtype=int),
        any(one.duration is not None for one in ordered),
    )


def _place(one: Observation) -> tuple[Any, ...]:
    """By what observations are ordered."""
    known = one.tip_velocity or (), one.force or (), one.duration or 0.0
    return one.push_id, one.stamp, one.contact_point, one.twist, one.contact_normal, one.half_width, *known


def thinned(steps: Steps, most: int) -> Steps:
    """The steps of so many stretches at most: of the last pushes, in which the object may have changed, and evenly before."""
    last = int(steps.part.max(initial=-1))
    if last < most:
        return steps
    late = max(int(steps.part[steps.push >= np.unique(steps.push)[-LATEST:][0]][0]), last + 1 - most // 10)
    chosen = np.append(np.linspace(0, late - 1, most + late - last - 1).round(), np.arange(late, last + 1)).astype(int)
    kept = np.isin(steps.part, chosen)
    return _rows(steps, kept)._replace(part=np.searchsorted(chosen, steps.part[kept]))


def into_object(steps: Steps) -> npt.NDArray[np.bool_]:
    """Whether a tip or contact moves into the object (r,)."""
    return np.asarray(np.sum(steps.ways * steps.normals, axis=1) < 0)


def stretches(steps: Steps, size: float) -> Stretches | None:
    """The stretches of those steps in which a tip or contact moves into the object; None if it does in none.

    Args:
        steps: r.
        size: of the support [m].
    """
    steps = _rows(steps, into_object(steps))
    if not len(steps.part):
        return None
    _, begins, stretch = np.unique(steps.part, return_index=True, return_inverse=True)
    unit = 1.0 if steps.timed else USUAL_WAY * size / float(np.median(np.hypot(*steps.ways.T)))
    ways, motions = steps.ways * unit, steps.motions * unit
    turned = np.cumsum(motions[:, 2]) - motions[:, 2] / 2
    first = turned[begins] - motions[begins, 2] / 2
    whole = np.add.reduceat(motions[:, 2], begins)
    ratios, slid = _ratios(steps, stretch, len(begins))
    return Stretches(
        steps.contacts,
        steps.normals,
        ways,
        motions,
        turned - (first + whole / 2)[stretch],
        steps.sticks,
        steps.half_widths,
        stretch,
        begins,
        steps.push[begins],
        np.add.reduceat(np.hypot(*ways.T), begins),
        ratios,
        slid,
        unit,
    )


def _rows(steps: Steps, kept: npt.NDArray[np.bool_]) -> Steps:
    """Some of the steps."""
    return steps._replace(**{name: getattr(steps, name)[kept] for name in steps._fields if name != "timed"})


def _ratios(steps: Steps, stretch: Indices, count: int) -> tuple[Array, npt.NDArray[np.bool_]]:
    """The mean ratio of the forces of each stretch, and whether it is that of a sliding tip: of those steps alone, if any."""
    along = left_of(steps.normals)
    shear, pressure = np.sum(steps.forces * along, axis=1), -np.sum(steps.forces * steps.normals, axis=1)
    told = pressure > 0  # not where no force was measured
    slip = np.where(steps.sticks, 0.0, np.sum((steps.ways - at_contacts(steps.contacts, steps.motions)) * along, axis=1))
    slides = told & (np.abs(slip) > SURELY_SLID * np.hypot(*steps.ways.T)) & (shear * slip > 0)
    ratios, slid = np.full(count, math.nan), np.zeros(count, dtype=bool)
    slid[stretch[slides]] = True
    for one in np.unique(stretch[told]).tolist():
        used = (stretch == one) & (slides if slid[one] else told)
        ratios[one] = np.mean(np.maximum(np.abs(shear[used]) / pressure[used], LEAST_RATIO))
    return ratios, slid
