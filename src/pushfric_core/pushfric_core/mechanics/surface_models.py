"""The limit surface as planners write it down: the ellipsoid that most assume, and points of the exact one, with its error."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pushfric_core.geometry.planar import Array, Twist, left_of
from pushfric_core.geometry.support import Support
from pushfric_core.mechanics.limit_surface import LimitSurface
from pushfric_core.records import comparable

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
    ellipsoid = named_ellipsoid(support)
    x, y = ellipsoid.center
    scaling = np.array(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (y / ellipsoid.m_max, -x / ellipsoid.m_max, 1 / ellipsoid.m_max)))
    twists = _sphere(SAMPLES) @ scaling
    velocities = left_of(support.points) * twists[:, None, 2:] + twists[:, None, :2]
    dissipation = np.linalg.norm(velocities, axis=2) @ support.weights
    twists /= dissipation[:, None]
    wrenches = np.array([surface.wrench(Twist(*twist.tolist())) for twist in twists])
    return wrenches, twists, scaling


def _sphere(count: int) -> Array:
    """Directions (count, 3) spread evenly, along a spiral."""
    height = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (3 - math.sqrt(5)) * np.arange(count)
    width = np.sqrt(1 - height**2)
    return np.column_stack((width * np.cos(turn), width * np.sin(turn), height))
