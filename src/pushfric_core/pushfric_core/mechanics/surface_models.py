"""Limit surfaces as planners write them down: the ellipsoid that most assume, and a convex quartic; each with its error."""

import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pushfric_core.geometry.planar import Array, Twist, Wrench, as_array, frozen, left_of
from pushfric_core.geometry.support import Support
from pushfric_core.mechanics.limit_surface import Ellipsoid, LimitSurface
from pushfric_core.records import comparable

DIRECTIONS = 100
"""Fourth powers along this many directions make up the quartic; a quartic form of three variables needs at most 15 of them."""

SAMPLES = 200
"""Motions whose wrenches the quartic is fitted to and the errors are computed from."""

EXPONENTS = tuple(powers for powers in itertools.product(range(4, -1, -1), repeat=3) if sum(powers) == 4)
"""Exponents of (fx, fy, m) in the 15 monomials of a quartic: (4, 0, 0), (3, 1, 0), (3, 0, 1), (2, 2, 0), ... (0, 0, 4)."""


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
        >>> ellipsoid.form().form.shape
        (3, 3)
    """

    f_max: float
    m_max: float
    center: Array

    def form(self) -> Ellipsoid:
        """The same surface as W' A W = 1, with moments about the object-frame origin."""
        x, y = self.center
        scaling = np.array(
            (
                (1 / self.f_max, 0.0, 0.0),
                (0.0, 1 / self.f_max, 0.0),
                (y / self.m_max, -x / self.m_max, 1 / self.m_max),
            )
        )
        return Ellipsoid(scaling.T @ scaling)


def named_ellipsoid(support: Support) -> NamedEllipsoid:
    """The ellipsoid through the force of a translation and the moment of a turn about p_CF; unit: the support friction.

    Example:
        >>> from pushfric_core import TABLE_1, named_ellipsoid
        >>> round(named_ellipsoid(TABLE_1["wood_rect4"].support).m_max, 4)
        0.0578
    """
    center = support.center_of_friction
    return NamedEllipsoid(1.0, float(support.weights @ np.linalg.norm(support.points - center, axis=1)), center)


@comparable
@dataclass(frozen=True)
class Quartic:
    """A convex form H(W) = 1 of degree 4: the motion under a wrench W on it is along the gradient (Zhou et al. 2016).

    H is a sum of fourth powers of linear forms with weights >= 0, so it is always convex.

    Attributes:
        coefficients: (15,) of the monomials EXPONENTS of (fx, fy, m about the object-frame origin); [m^-k] with m^k.
    Raises:
        ValueError: there are not 15 finite coefficients.

    Example:
        >>> from pushfric_core import TABLE_1, Wrench, convex_quartic
        >>> quartic = convex_quartic(TABLE_1["wood_rect4"].support)
        >>> round(quartic.load(Wrench(2.0, 0.0, 0.0)) / quartic.load(Wrench(1.0, 0.0, 0.0)), 6)
        2.0
    """

    coefficients: Array

    def __post_init__(self) -> None:
        coefficients = frozen(self.coefficients)
        if coefficients.shape != (len(EXPONENTS),) or not np.isfinite(coefficients).all():
            raise ValueError(f"coefficients must be {len(EXPONENTS)} finite numbers, got {coefficients.tolist()}")
        object.__setattr__(self, "coefficients", coefficients)

    def load(self, wrench: Wrench) -> float:
        """The wrench as a multiple of the one on the surface along it: H(W)^(1/4)."""
        return float(np.maximum(_monomials(as_array(wrench)[None]) @ self.coefficients, 0.0)[0] ** 0.25)

    def twist(self, wrench: Wrench) -> Twist:
        """The motion, of unit dissipation, under the wrench scaled onto the surface: grad H / 4.

        Raises:
            ValueError: the wrench is zero.
        """
        load = self.load(wrench)
        if not load > 0:
            raise ValueError(f"a wrench must not be zero, got {tuple(wrench)}")
        return Twist(*(_gradients(as_array(wrench)[None] / load) @ self.coefficients / 4)[0].tolist())


def convex_quartic(support: Support) -> Quartic:
    """The convex quartic whose values and gradients come nearest to those of the limit surface, over motions of all directions.

    Raises:
        ValueError: a single point bears all the weight.

    Example:
        >>> from pushfric_core import TABLE_1, convex_quartic
        >>> convex_quartic(TABLE_1["wood_rect4"].support).coefficients.shape
        (15,)
    """
    from scipy.optimize import nnls  # takes longer to load than the rest of this package

    wrenches, twists, scaling = _samples(support)
    # about p_CF and in round units, S W and S^-T V
    rounded = np.linalg.solve(scaling.T, twists.T).T
    directions = _sphere(DIRECTIONS)
    along = wrenches @ scaling.T @ directions.T
    values, slopes = along**4, 4 * along[:, None, :] ** 3 * directions.T
    a = np.concatenate((4 * values, slopes.reshape(-1, len(directions))))
    b = np.concatenate((np.full(len(wrenches), 4.0), 4 * rounded.ravel()))
    shares, _ = nnls(a, b)
    # back to wrenches about the origin: d . S W
    return Quartic(_powers(directions @ scaling) @ shares)


def ellipsoid_error(ellipsoid: Ellipsoid, support: Support) -> SurfaceError:
    """Error of an ellipsoid compared with the exact surface."""
    wrenches, twists, scaling = _samples(support)
    loads = np.sqrt(np.einsum("si,ij,sj->s", wrenches, ellipsoid.form, wrenches))
    return _error(loads, wrenches @ ellipsoid.form, twists, scaling)


def quartic_error(quartic: Quartic, support: Support) -> SurfaceError:
    """Error of a quartic compared with the exact surface."""
    wrenches, twists, scaling = _samples(support)
    loads = np.maximum(_monomials(wrenches) @ quartic.coefficients, 0.0) ** 0.25
    return _error(loads, _gradients(wrenches) @ quartic.coefficients, twists, scaling)


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


def _monomials(wrenches: Array) -> Array:
    """Values (s, 15) of the monomials."""
    return np.stack([np.prod(wrenches**powers, axis=1) for powers in np.array(EXPONENTS)], axis=1)


def _gradients(wrenches: Array) -> Array:
    """Gradients (s, 3, 15) of the monomials."""
    columns = []
    for powers in np.array(EXPONENTS):
        lowered = np.maximum(powers - np.eye(3, dtype=int), 0)
        columns.append(np.stack([k * np.prod(wrenches**low, axis=1) for k, low in zip(powers, lowered, strict=True)], axis=1))
    return np.stack(columns, axis=2)


def _powers(forms: Array) -> Array:
    """Coefficients (15, d) of the fourth powers of linear forms (d, 3)."""
    multinomial = [math.factorial(4) // math.prod(map(math.factorial, powers)) for powers in EXPONENTS]
    return (_monomials(forms) * multinomial).T
