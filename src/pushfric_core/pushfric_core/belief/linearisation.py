"""How far the predicted motion of each stretch is off, and how that depends on the pressure.

The prediction is the exact quasi-static model (`mechanics.quasi_static`) along the steps that were seen. Its slopes follow from
the conditions of least dissipation by the implicit function theorem (`inner_loops`).
"""

import math
from typing import NamedTuple

import numpy as np

from pushfric_core.belief import inner_loops
from pushfric_core.belief.constants import LEAST_RATIO, REACH, ROUNDED
from pushfric_core.belief.stretches import TINY, Stretches, at_contacts
from pushfric_core.errors import warn_unless_compiled
from pushfric_core.geometry.planar import Array, cross, left_of
from pushfric_core.mechanics import quasi_static
from pushfric_core.mechanics.prediction import SHARE, STICKING
from pushfric_core.mechanics.quasi_static import Motions

warn_unless_compiled(inner_loops, "beliefs are")


class Place(NamedTuple):
    """Where the object's points are, and how motions are compared."""

    points: Array  # (n, 2) the supports, object frame [m]
    middle: Array  # (2,) of the supports
    arm: float  # rms distance of the supports from their middle, at which a turn counts [m]; 1 if all are in one place


class Linearised(NamedTuple):
    """The errors of k stretches about one (w, mu_c)."""

    errors: Array  # (k, 3) predicted less seen motion, with the turn times the arm [m]
    slopes: Array  # (k, 3, n) by log pressure
    pivots: Array  # (k, 3, 3) covariance from supports near the centre of rotation, which push in no known direction [m^2]


def errors(place: Place, data: Stretches, foretold: Motions) -> Array:
    """The errors of the motions that were foretold, as `Linearised.errors`."""
    return _moved(place, data, foretold.twists - data.motions)


def errors_per_way(place: Place, data: Stretches, foretold: Motions) -> Array:
    """How far the motion that was foretold of each step (r,) is off, as a share of the tip's way."""
    off = foretold.twists - data.motions
    sizes = np.linalg.norm(np.column_stack((at_contacts(place.middle, off), place.arm * off[:, 2])), axis=1)
    return np.asarray(sizes / np.maximum(np.linalg.norm(data.ways, axis=1), TINY))


def with_bounds(place: Place, data: Stretches, w: Array) -> Stretches:
    """The same, but where neither tip nor force is known, w gives the force's ratio, which is at most mu_c (eq. 12).

    Ratios near mu_c would count once each if all were kept: 90 of 100 are at most as large as the one that is.
    """
    forces = predicted(place, data, w, STICKING).forces
    normals = data.normals
    pressure = -np.sum(forces * normals, axis=1)
    shear = np.abs(cross(normals, forces))
    told = data.sticks & (pressure > LEAST_RATIO * shear)
    ratios = np.where(told, np.maximum(shear / np.maximum(pressure, TINY), LEAST_RATIO), 0.0)
    count = _summed(data, told.astype(float))
    bounds = np.where(count > 0, _summed(data, ratios) / np.maximum(count, 1.0), np.nan)
    open_ = np.flatnonzero(np.isfinite(bounds) & ~np.isfinite(data.ratios))
    ratios = data.ratios.copy()
    if len(open_):
        kept = open_[np.argsort(bounds[open_])[math.ceil(SHARE * len(open_) - 1e-9) - 1]]
        ratios[kept] = bounds[kept]
    return data._replace(ratios=ratios)


def anywhere(place: Place, data: Stretches, w: Array, mu_c: float, errors_seen: Array) -> Array:
    """Covariances (k, 3, 3) of the errors (k, 3) [m^2], because contacts lie anywhere within their half-widths.

    Their mean over an interval is taken by Gauss's rule of three points, at the middle of which nothing is off.
    """
    covariances = np.zeros((len(errors_seen), 3, 3))
    for side in (-1, 1) if data.half_widths.any() else ():
        aside = data.contacts + side * math.sqrt(3 / 5) * data.half_widths[:, None] * left_of(data.normals)
        ways = np.where(data.sticks[:, None], at_contacts(aside, data.motions), data.ways)
        moved = data._replace(contacts=aside, ways=ways)
        off = errors(place, moved, predicted(place, moved, w, mu_c)) - errors_seen
        # where the tip is not known, only turns about the contact are foretold
        turns = _moved(place, data, np.column_stack((-left_of(data.contacts), np.ones(len(data.contacts)))))
        off = np.where(data.stuck[:, None], off[:, 2:] * turns / turns[:, 2:], off)
        covariances += 5 / 18 * off[:, :, None] * off[:, None, :]
    return covariances


def motion_sizes(place: Place, data: Stretches) -> Array:
    """Sizes (k,) of the motions that were seen, as those of errors [m]."""
    return np.asarray(np.linalg.norm(_moved(place, data, data.motions), axis=1))


def linearised(place: Place, data: Stretches, w: Array, foretold: Motions) -> Linearised:
    """The errors with their slopes.

    Args:
        place: of the object.
        data: k stretches.
        w: (n,) support friction distribution.
        foretold: the motions of the steps (`predicted`).
    """
    (k, n), (points, middle, arm) = (len(data.lengths), len(w)), place
    by_push, unknown = np.zeros((k, 3, n)), np.zeros((k, 3, 2 * n))
    steps = data.contacts, data.normals, data.turns, data.stretch
    inner_loops.slopes_each(points, w, middle, arm, ROUNDED * arm, REACH * arm, *steps, *foretold, by_push, unknown)
    by_w = by_push * w
    by_log = by_w - by_w.sum(axis=2, keepdims=True) * w
    return Linearised(errors(place, data, foretold), by_log, unknown @ unknown.transpose(0, 2, 1) / 2)


def predicted(place: Place, data: Stretches, w: Array, mu_c: float) -> Motions:
    """The motions that w (n,) and mu_c foretell for r steps: twists (r, 3), modes (r,) and forces (r, 2)."""
    mu_cs, samples = np.where(data.sticks, STICKING, mu_c), np.zeros(len(data.sticks), np.int64)
    rows = data.contacts, data.normals, data.ways
    return quasi_static.motions_of_rows(place.points, w[None], mu_cs, samples, *rows, lenient=True)


def _moved(place: Place, data: Stretches, motions: Array) -> Array:
    """How motions (r, 3) of the object-frame origin in each step move the object in each stretch (k, 3).

    The axes are those of the object half-way through the stretch.
    """
    moved = np.zeros((len(data.begins), 3))
    inner_loops.sum_each(place.middle, place.arm, data.turns, data.stretch, motions, moved)
    return moved


def _summed(data: Stretches, values: Array) -> Array:
    """Sums (k, ...) over the steps (r, ...) of each stretch."""
    return np.asarray(np.add.reduceat(values, data.begins, axis=0))
