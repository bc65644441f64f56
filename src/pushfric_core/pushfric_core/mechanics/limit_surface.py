"""The limit surface of a support friction distribution.

The limit surface is the locus of the wrenches W = (fx, fy, m) that a pusher applies to the sliding object, opposite to the
support friction. The motion V = (vx, vy, omega) is parallel to its outward normal at W (section 6.3). W and V are about the
object-frame origin.

The surface bounds the sum of the discs {(u, p_j x u) : |u| <= w_j}. So its support function is the dissipation h(V) = sum_j w_j
|v_j|, and the motion under a wrench W is the V that minimises h on W . V = 1. If V rotates about a support point, the disc of
that support appears as a flat part of the surface, a facet: all its wrenches have the same motion.

Planners write it down as an ellipsoid, or as points of the exact one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.contact import tangent
from pushfric_core.geometry.planar import LEAST_DIVISOR, Array, Indices, Twist, Wrench, as_array, check_unit, cross, left_of
from pushfric_core.geometry.support import Support
from pushfric_core.mechanics.damped_newton import NewtonStep, minimized
from pushfric_core.records import comparable

SMOOTHING = 10.0 ** -np.arange(1, 10)
"""Speeds are rounded off at zero by these fractions of the mean speed, one after another, because Newton needs a smooth h."""

STEPS = 100
"""Cap on Newton's steps at each of them; about five are usual."""

RIM = 1e-9
"""A wrench counts as on a facet if it is this fraction of the radius inside its rim; on the rim other motions may fit, too."""

RIDGE = 1e-12
"""Part of the identity in Newton's matrix, which is singular if supports on one line all move across it."""

ACROSS_CONE = 65
"""Number of directions of the force across each friction cone."""


@comparable
class Facet(NamedTuple):
    """A flat part of the limit surface: the object rotates about a support point, whose force may be any up to w_j.

    Its wrenches are center + (u, p x u), |u| <= radius.
    """

    point: Array  # (2,) the support point p [m]
    twist: Twist  # the motion of all of its wrenches, of unit dissipation
    center: Wrench
    radius: float  # weight w_j of the support


@comparable
class Reachable(NamedTuple):
    """The part of the limit surface that pushes at k contacts reach: s wrenches each, from the cone's edge towards -t to +t."""

    wrenches: Array  # (k, s, 3)
    twists: Array  # (k, s, 3) of unit dissipation


class LimitSurface:
    """The exact limit surface of a support.

    Args:
        support: with weight at two places or more, because the surface of a single point encloses no volume.
    Attributes:
        scaling: S (3, 3): S W is the wrench about p_CF, its moment in units that make the surface about round; V = S' (twist in
            those units).
    Raises:
        ValueError: a single point bears all the weight.

    Example:
        >>> from pushfric_core import TABLE_1, LimitSurface, Wrench
        >>> surface = LimitSurface(TABLE_1["wood_rect4"].support)
        >>> round(surface.load(Wrench(0.5, 0.0, 0.0)), 3), len(surface.facets)
        (0.5, 4)
    """

    def __init__(self, support: Support) -> None:
        bearing = support.weights > 0
        # supports at the same place share one facet
        points, place = np.unique(support.points[bearing], axis=0, return_inverse=True)
        weights = np.zeros(len(points))
        np.add.at(weights, place.ravel(), support.weights[bearing])
        if len(points) < 2:
            raise ValueError(f"a limit surface needs weight at two places or more, got all of it at {points[0].tolist()}")
        self._support = Support(points, weights)
        x, y = self._support.center_of_friction
        arms = points - (x, y)
        length = float(weights @ np.linalg.norm(arms, axis=1))  # the moment of a turn about p_CF
        self.scaling = np.array(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (y / length, -x / length, 1 / length)))
        self._arms = arms / length

    def wrench(self, twist: Twist) -> Wrench:
        """The wrench that keeps the object moving along `twist`: minus the friction of eqs 1 and 2.

        Raises:
            UninformativePush: there is no motion, or it is one about a support point, where any wrench of a facet is possible.
        """
        fx, fy, m = self._support.friction_wrench(twist)
        return Wrench(-fx, -fy, -m)

    def twist(self, wrench: Wrench) -> Twist:
        """The motion under a wrench scaled to the surface: the outward normal there, of unit dissipation.

        A translation of unit dissipation has unit speed. The motion is unique unless the support points lie on one line; then
        a force across that line may have several, and this is one of them.

        Raises:
            ValueError: the wrench is zero or not finite.
            SolverFailed: the motion was not found.
        """
        return Twist(*self.twists(_checked("wrench", wrench)[None])[0].tolist())

    def twists(self, wrenches: Array) -> Array:
        """The `twist` (s, 3) of wrenches (s, 3), none of them zero. Raises SolverFailed as `twist`."""
        wrenches = as_array(wrenches)
        turns = np.array([facet.twist for facet in self.facets])
        centers = np.array([facet.center[:2] for facet in self.facets])
        radii = np.array([facet.radius for facet in self.facets])
        work = wrenches @ turns.T
        # the wrench where its ray meets the plane of a facet, or of the opposite one
        with np.errstate(divide="ignore", invalid="ignore"):
            open_forces = wrenches[:, None, :2] / work[:, :, None] - centers
            beyond = np.hypot(open_forces[..., 0], open_forces[..., 1]) / radii
        beyond[work == 0] = np.inf
        facet = np.argmin(beyond, axis=1)
        each = np.arange(len(wrenches))
        twists = turns[facet] * np.sign(work[each, facet])[:, None]
        curved = beyond[each, facet] >= 1 - RIM
        twists[curved] = self._least_dissipation(wrenches[curved] @ self.scaling.T) @ self.scaling
        return np.asarray(twists)

    def load(self, wrench: Wrench) -> float:
        """The wrench as a multiple of the wrench on the surface in its direction: the object slides at 1, and rests below.

        Raises as `twist`.
        """
        return float(self._loads(_checked("wrench", wrench)[None])[0])

    @cached_property
    def facets(self) -> list[Facet]:
        """The flat parts for counter-clockwise turns, one for each place that bears weight.

        Those for clockwise turns lie opposite: twist and centre change their signs.
        """
        points, weights = self._support.points, self._support.weights
        facets = []
        for point, weight in zip(points, weights, strict=True):
            arms = points - point
            distances = np.linalg.norm(arms, axis=1)
            omega = 1 / float(weights @ distances)
            vx, vy = (-omega * left_of(point)).tolist()
            # the facet leaves open this support's own force, which has no arm
            forces = left_of(arms) * (weights / np.maximum(distances, LEAST_DIVISOR))[:, None]
            fx, fy = forces.sum(axis=0).tolist()
            facets.append(Facet(point, Twist(vx, vy, omega), Wrench(fx, fy, float(cross(points, forces).sum())), float(weight)))
        return facets

    def reachable(self, contact_points: npt.ArrayLike, contact_normals: npt.ArrayLike, mu_c: float) -> Reachable:
        """The wrenches that pushes with one point contact can reach, with forces in the friction cones of the contacts.

        Args:
            contact_points: (k, 2) [m].
            contact_normals: (k, 2) unit, outward.
            mu_c: contact friction coefficient.
        Raises:
            ValueError: shapes that do not fit, normals that are not unit, or mu_c is negative or not finite.
            SolverFailed: a motion was not found.
        """
        points, normals = as_array(contact_points), as_array(contact_normals)
        if points.ndim != 2 or points.shape[1] != 2 or points.shape != normals.shape:
            raise ValueError(f"contact_points and contact_normals must both be (k, 2), got {points.shape} and {normals.shape}")
        check_unit("contact_normals", normals)
        if not 0 <= mu_c < math.inf:
            raise ValueError(f"mu_c must be at least 0 and finite, got {mu_c}")
        cone = math.atan(mu_c)
        angles = np.linspace(-cone, cone, ACROSS_CONE if mu_c > 0 else 1)[:, None]
        forces = -np.cos(angles) * normals[:, None] + np.sin(angles) * tangent(normals)[:, None]
        wrenches = np.concatenate((forces, cross(points[:, None], forces)[..., None]), axis=2)
        twists = self.twists(wrenches.reshape(-1, 3)).reshape(wrenches.shape)
        return Reachable(wrenches / np.sum(wrenches * twists, axis=2, keepdims=True), twists)

    def _loads(self, wrenches: Array) -> Array:
        """The `load` (s,) of wrenches (s, 3): on the surface, W . V is the dissipation."""
        return np.asarray(np.sum(wrenches * self.twists(wrenches), axis=1))

    def _least_dissipation(self, wrenches: Array) -> Array:
        """The twists (s, 3), of unit dissipation, that minimise h on W . V = 1, in scaled units; no support stands still.

        A damped Newton method in the two directions that W . V = 1 leaves, for all wrenches at once.
        """
        wrenches = wrenches / np.linalg.norm(wrenches, axis=1)[:, None]
        # two directions at right angles to each wrench
        least = np.eye(3)[np.argmin(np.abs(wrenches), axis=1)]
        one = np.cross(wrenches, least)
        one /= np.linalg.norm(one, axis=1)[:, None]
        directions = np.stack((one, np.cross(wrenches, one)), axis=1)  # (s, 2, 3)
        twists = wrenches
        mean_speed = self._dissipation(np.zeros(len(twists)), slice(None), twists)
        for share in SMOOTHING:
            floor = (share * mean_speed) ** 2
            twists = minimized(twists, partial(self._newton_step, directions, floor), partial(self._dissipation, floor), STEPS)
        return np.asarray(twists / self._dissipation(np.zeros(len(twists)), slice(None), twists)[:, None])

    def _dissipation(self, floor: Array, rows: Indices | slice, twists: Array) -> Array:
        """h (s,) of the scaled twists (s, 3) of some rows, with `floor` added to the squared speeds."""
        vx, vy = self._velocities(twists)
        return np.asarray(np.sqrt(vx**2 + vy**2 + floor[rows, None]) @ self._support.weights)

    def _velocities(self, twists: Array) -> tuple[Array, Array]:
        """Components (s, n) of the support points' velocities."""
        x, y = self._arms.T
        return twists[:, :1] - twists[:, 2:] * y, twists[:, 1:2] + twists[:, 2:] * x

    def _newton_step(self, directions: Array, floor: Array, rows: Indices, twists: Array) -> NewtonStep:
        """Newton's step (s, 3) on that h from the twists (s, 3) of some rows, within their directions (., 2, 3)."""
        directions, floor = directions[rows], floor[rows]
        x, y = self._arms.T
        vx, vy = self._velocities(twists)
        speeds = np.sqrt(vx**2 + vy**2 + floor[:, None])
        share = self._support.weights / speeds
        # how fast the square of a speed grows with V, halved
        growth = np.stack((vx, vy, x * vy - y * vx), axis=1)  # (s, 3, n)
        gradient = np.sum(growth * share[:, None], axis=2)
        ones, products = np.ones_like(x), np.zeros((3, 3, len(x)))
        products[0, 0] = products[1, 1] = ones
        products[0, 2] = products[2, 0] = -y
        products[1, 2] = products[2, 1] = x
        products[2, 2] = x**2 + y**2
        curvature = np.tensordot(share, products, axes=(1, 2))
        curvature -= (growth * (share / speeds**2)[:, None]) @ growth.transpose(0, 2, 1)
        slope = np.sum(directions * gradient[:, None], axis=2)
        hessian = directions @ curvature @ directions.transpose(0, 2, 1)
        # a trace of curvature keeps the step finite if the dissipation is linear
        hessian += np.eye(2) * (RIDGE * share.sum(axis=1))[:, None, None]
        shift = -np.linalg.solve(hessian, slope[..., None])[..., 0]
        step = np.sum(shift[..., None] * directions, axis=1)
        return NewtonStep(speeds @ self._support.weights, step, -np.sum(slope * shift, axis=1))


def _checked(name: str, values: Wrench | Twist) -> Array:
    array = as_array(values)
    if array.shape != (3,) or not np.isfinite(array).all() or not array.any():
        raise ValueError(f"{name} must be three finite numbers, not all zero, got {values}")
    return array


SAMPLES = 200
"""Motions from whose wrenches errors are computed."""


@comparable
class SurfaceError(NamedTuple):
    """How far a model is from the exact surface, over motions of all directions."""

    load: float  # rms of the relative difference in the load that makes the object slide
    twist: float  # median angle between the motions, as (v at p_CF, length * omega) [rad]


@comparable
@dataclass(frozen=True)
class NamedEllipsoid:
    """The ellipsoid of most planners: (f / f_max)^2 + (m / m_max)^2 = 1, for a force f and its moment m about `center`.

    Attributes:
        f_max: force that translates the object; 1, the unit of force, or [N].
        m_max: moment that turns it about the centre [m times the unit of force].
        center: p_CF (2,) [m], object frame.

    Example:
        >>> from pushfric_core import NamedEllipsoid
        >>> ellipsoid = NamedEllipsoid(f_max=1.0, m_max=0.05, center=(0.01, 0.0))
        >>> ellipsoid.form.shape
        (3, 3)
    """

    f_max: float
    m_max: float
    center: Array

    @property
    def form(self) -> Array:
        """A (3, 3) of the same surface as W' A W = 1, with moments about the object-frame origin; A W is along the motion."""
        x, y = self.center
        f, m = self.f_max, self.m_max
        scaling = np.array(((1 / f, 0.0, 0.0), (0.0, 1 / f, 0.0), (y / m, -x / m, 1 / m)))
        return np.asarray(scaling.T @ scaling)


def named_ellipsoid(support: Support) -> NamedEllipsoid:
    """The ellipsoid through the force of a translation and the moment of a turn about p_CF; unit: the support friction.

    Example:
        >>> from pushfric_core import TABLE_1, named_ellipsoid
        >>> round(named_ellipsoid(TABLE_1["wood_rect4"].support).m_max, 4)
        0.0578
    """
    center = support.center_of_friction
    return NamedEllipsoid(1.0, float(support.weights @ np.linalg.norm(support.points - center, axis=1)), center)


def ellipsoid_error(ellipsoid: NamedEllipsoid, support: Support) -> SurfaceError:
    """Error of an ellipsoid compared with the exact surface."""
    wrenches, twists, scaling = _samples(support)
    loads = np.sqrt(np.einsum("si,ij,sj->s", wrenches, ellipsoid.form, wrenches))
    return _error(loads, wrenches @ ellipsoid.form, twists, scaling)


def support_error(other: Support, support: Support) -> SurfaceError:
    """Error of the limit surface of another support compared with that of this one.

    Raises:
        ValueError: a single point bears all the weight of one of them.
    """
    wrenches, twists, scaling = _samples(support)
    found = LimitSurface(other).twists(wrenches)
    return _error(np.sum(wrenches * found, axis=1), found, twists, scaling)


def surface_samples(support: Support) -> tuple[Array, Array]:
    """Wrenches (s, 3) on the exact surface, about the object-frame origin, and the motions (s, 3) there, of unit dissipation.

    The motions are spread evenly over all directions.

    Raises:
        ValueError: a single point bears all the weight.
    """
    wrenches, twists, _ = _samples(support)
    return wrenches, twists


def _error(loads: Array, gradients: Array, twists: Array, scaling: Array) -> SurfaceError:
    a, b = (np.linalg.solve(scaling.T, each.T).T for each in (gradients, twists))
    cosines = np.sum(a * b, axis=1) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1))
    angle = float(np.median(np.arccos(np.clip(cosines, -1.0, 1.0))))
    return SurfaceError(float(np.sqrt(np.mean((loads - 1) ** 2))), angle)


def _samples(support: Support) -> tuple[Array, Array, Array]:
    """Wrenches (s, 3) on the surface, the motions (s, 3) there, of unit dissipation, and the scaling (3, 3) to round units."""
    surface = LimitSurface(support)
    twists = _sphere(SAMPLES) @ surface.scaling
    velocities = left_of(support.points) * twists[:, None, 2:] + twists[:, None, :2]
    dissipation = np.linalg.norm(velocities, axis=2) @ support.weights
    twists /= dissipation[:, None]
    wrenches = np.array([surface.wrench(Twist(*twist.tolist())) for twist in twists])
    return wrenches, twists, surface.scaling


def _sphere(count: int) -> Array:
    """Directions (count, 3) spread evenly, along a spiral."""
    height = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (3 - math.sqrt(5)) * np.arange(count)
    width = np.sqrt(1 - height**2)
    return np.column_stack((width * np.cos(turn), width * np.sin(turn), height))
