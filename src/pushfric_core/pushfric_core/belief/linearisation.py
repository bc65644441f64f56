"""How far the predicted motion of each stretch is off, and how that depends on the pressure.

The prediction is the exact quasi-static model (`mechanics.quasi_static`) along the steps that were seen. Its slopes follow from
the conditions of least dissipation by the implicit function theorem. If the tip sticks, only the turn is free; if it slides,
all of the motion is, but the wrench keeps the direction of the cone's edge.
"""

import math
from typing import NamedTuple

import numpy as np

from pushfric_core.belief.constants import LEAST_RATIO, REACH, ROUNDED
from pushfric_core.belief.stretches import Stretches, at_contacts
from pushfric_core.geometry.planar import Array, cross, left_of
from pushfric_core.mechanics import quasi_static
from pushfric_core.mechanics.prediction import SHARE, STICKING
from pushfric_core.mechanics.quasi_static import Motions

TINY = 1e-12


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
    return _summed(data, _off(place, data, foretold.twists))


def errors_per_way(place: Place, data: Stretches, foretold: Motions) -> Array:
    """How far the motion that was foretold of each step (r,) is off, as a share of the tip's way."""
    off = np.linalg.norm(_off(place, data, foretold.twists), axis=1)
    return np.asarray(off / np.maximum(np.linalg.norm(data.ways, axis=1), TINY))


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
    """Covariances (k, 3, 3) of the errors (k, 3) [m^2], because contacts lie anywhere within their half-widths."""
    if not data.half_widths.any():
        return np.zeros((len(errors_seen), 3, 3))
    aside = data.contacts + data.half_widths[:, None] * left_of(data.normals)
    ways = np.where(data.sticks[:, None], at_contacts(aside, data.motions), data.ways)
    moved = data._replace(contacts=aside, ways=ways)
    off = errors(place, moved, predicted(place, moved, w, mu_c)) - errors_seen
    # where the tip is not known, only turns about the contact are foretold
    turns = _summed(data, _framed(place, data, np.zeros_like(data.ways), np.ones(len(data.ways))))
    stuck = np.add.reduceat(data.sticks, data.begins)[:, None] > 0
    off = np.where(stuck, off[:, 2:] * turns / turns[:, 2:], off)
    return off[:, :, None] * off[:, None, :] / 3


def motion_sizes(place: Place, data: Stretches) -> Array:
    """Sizes (k,) of the motions that were seen, as those of errors [m]."""
    velocities, turns = at_contacts(data.contacts, data.motions), data.motions[:, 2]
    return np.asarray(np.linalg.norm(_summed(data, _framed(place, data, velocities, turns)), axis=1))


def linearised(place: Place, data: Stretches, w: Array, foretold: Motions) -> Linearised:
    """The errors with their slopes.

    Args:
        place: of the object.
        data: k stretches.
        w: (n,) support friction distribution.
        foretold: the motions of the steps (`predicted`).
    """
    velocities, turns = at_contacts(data.contacts, foretold.twists), foretold.twists[:, 2]
    arms = place.points - data.contacts[:, None]
    ahead, across = -arms[..., 1], arms[..., 0]  # velocity of a support per turn about the contact
    speed_x, speed_y = velocities[:, :1] + turns[:, None] * ahead, velocities[:, 1:] + turns[:, None] * across
    speeds = np.hypot(speed_x, speed_y)
    rounded = np.sqrt(speeds**2 + (ROUNDED * place.arm * turns[:, None]) ** 2) + TINY
    x, y = speed_x / rounded, speed_y / rounded
    xx, xy, yy = (1 - x * x) / rounded, -x * y / rounded, (1 - y * y) / rounded
    xt, yt = xx * ahead + xy * across, xy * ahead + yy * across
    curvature = np.stack([part @ w for part in (xx, xy, xt, xy, yy, yt, xt, yt, ahead * xt + across * yt)], axis=1)
    response = _response(place, data, curvature.reshape(-1, 3, 3), velocities, foretold)
    wrenches = np.stack((x, y, ahead * x + across * y), axis=1)
    moved = -np.einsum("rab,rbn->ran", response, wrenches)
    by_w = _summed(data, _framed(place, data, moved[:, :2], moved[:, 2])) * w
    slopes = by_w - by_w.sum(axis=2, keepdims=True) * w
    free = w * np.maximum(1 - speeds / (REACH * place.arm * np.abs(turns[:, None]) + TINY), 0.0)
    nothing = np.zeros_like(free)
    of_x, of_y = np.stack((free, nothing, ahead * free), axis=1), np.stack((nothing, free, across * free), axis=1)
    pivots = np.zeros((len(data.lengths), 3, 3))
    for unknown in (of_x, of_y):
        shifted = np.einsum("rab,rbn->ran", response, unknown)
        shifted = _summed(data, _framed(place, data, shifted[:, :2], shifted[:, 2]))
        pivots += np.einsum("kan,kbn->kab", shifted, shifted) / 2
    return Linearised(errors(place, data, foretold), slopes, pivots)


def predicted(place: Place, data: Stretches, w: Array, mu_c: float) -> Motions:
    """The motions that w (n,) and mu_c foretell for r steps: twists (r, 3), modes (r,) and forces (r, 2)."""
    mu_cs, samples = np.where(data.sticks, STICKING, mu_c), np.zeros(len(data.sticks), np.int64)
    rows = data.contacts, data.normals, data.ways
    return quasi_static.motions_of_rows(place.points, w[None], mu_cs, samples, *rows, lenient=True)


def _off(place: Place, data: Stretches, twists: Array) -> Array:
    velocities, seen = (at_contacts(data.contacts, each) for each in (twists, data.motions))
    return _framed(place, data, velocities - seen, twists[:, 2] - data.motions[:, 2])


def _framed(place: Place, data: Stretches, velocities: Array, turns: Array) -> Array:
    """Motions given by contact velocities (r, 2, ...) and turns (r, ...), as (v at the middle, arm * turn) (r, 3, ...).

    The axes are those of the object half-way through the stretch.
    """
    shape = (-1,) + (1,) * (turns.ndim - 1)
    dx, dy = ((place.middle - data.contacts)[:, k].reshape(shape) for k in (0, 1))
    c, s = np.cos(data.turns).reshape(shape), np.sin(data.turns).reshape(shape)
    x, y = velocities[:, 0] - turns * dy, velocities[:, 1] + turns * dx
    return np.stack((c * x - s * y, s * x + c * y, place.arm * turns), axis=1)


def _summed(data: Stretches, values: Array) -> Array:
    """Sums (k, ...) over the steps (r, ...) of each stretch."""
    return np.asarray(np.add.reduceat(values, data.begins, axis=0))


def _response(place: Place, data: Stretches, curvature: Array, velocities: Array, foretold: Motions) -> Array:
    """How the motion about the contact gives way to a wrench (r, 3, 3), as (v of the contact, turn)."""
    response, modes, forces = np.zeros(curvature.shape), foretold.modes, foretold.forces
    sticks = modes == quasi_static.STICKING
    pushes = np.linalg.norm(forces, axis=1) > TINY  # with all the weight at the contact, a turn about it costs nothing
    slides = np.flatnonzero((modes == quasi_static.SLIDING) & pushes)
    response[sticks, 2, 2] = 1 / np.maximum(curvature[sticks, 2, 2], TINY)
    if not len(slides):
        return response
    scale = np.array((1.0, 1.0, 1 / place.arm))
    edge = forces[slides] / np.linalg.norm(forces[slides], axis=1, keepdims=True)
    bordered = np.zeros((len(slides), 4, 4))
    bordered[:, :3, :3] = curvature[slides] * np.outer(scale, scale)
    bordered[:, :2, 3] = bordered[:, 3, :2] = edge
    bordered[:, range(3), range(3)] += TINY * np.trace(bordered, axis1=1, axis2=2)[:, None]
    free = np.linalg.inv(bordered)[:, :3, :3] * np.outer(scale, scale)
    # the tip prescribes the velocity along the normal: what a wrench changes there is made up for along the motion
    motion = np.column_stack((velocities, foretold.twists[:, 2]))[slides]
    normals = data.normals[slides]
    inward = np.minimum(np.sum(velocities[slides] * normals, axis=1), -TINY)
    along = np.einsum("rab,ra->rb", free[:, :2], normals) / inward[:, None]
    response[slides] = free - motion[:, :, None] * along[:, None]
    return response
