"""The exact quasi-static model (section 2) of many pushes and many friction distributions at once.

Simulation, predictions and belief all move objects by it, one row for each pair of a push and a sample of (w, mu_c). If the tip
sticks, the object turns about the contact at the rate that dissipates least, which leaves no moment about the contact. If that
needs a force outside the friction cone, the tip slides: the force lies on the cone's edge, and of all motions in which it does
the same work, the object takes the one that dissipates least.
"""

from enum import Enum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.errors import SolverFailed, warn_unless_compiled
from pushfric_core.geometry.contact import tangent
from pushfric_core.geometry.planar import LEAST_DIVISOR, Array, Indices, as_array, check_unit, cross, left_of
from pushfric_core.geometry.support import check_points
from pushfric_core.mechanics import least_dissipation
from pushfric_core.mechanics.damped_newton import STILL
from pushfric_core.mechanics.least_dissipation import ENDLESS, WEDGED
from pushfric_core.mechanics.least_dissipation import FREE as FREE
from pushfric_core.mechanics.least_dissipation import SLIDING as SLIDING
from pushfric_core.mechanics.least_dissipation import STICKING as STICKING
from pushfric_core.records import comparable
from pushfric_core.trajectories.observation import SLOWEST

ITERATIONS = 200
"""Cap on Newton's steps; about ten are usual, some tens if the object rotates about a support."""


class ContactMode(Enum):
    """How the tip meets the object."""

    FREE = "free"
    STICKING = "sticking"
    SLIDING = "sliding"


MODES = (ContactMode.FREE, ContactMode.STICKING, ContactMode.SLIDING)
"""Meaning of the numbers in `Motions.modes`: FREE, STICKING and SLIDING."""

BLOCK = 65_536
"""Numbers in an array of a loop: few enough to stay in the cache, and many for the calls that they need."""

SUM = 1e-6
"""The sum of weights may differ from 1 by this much."""

warn_unless_compiled(least_dissipation, "predictions are")


@comparable
class Motions(NamedTuple):
    """How pushed objects move at an instant, for k pushes and s samples."""

    twists: Array  # (k, s, 3) of the object-frame origin, object frame, per the unit of time of the tip's velocity
    modes: npt.NDArray[np.int8]  # (k, s) indices of MODES
    forces: Array  # (k, s, 2) of the pusher ON the object; unit: the support friction of the translating object

    def of_samples(self, count: int) -> "Motions":
        """The same of k pushes and so many samples, from k * count rows."""
        shape = -1, count
        return Motions(self.twists.reshape(*shape, 3), self.modes.reshape(shape), self.forces.reshape(*shape, 2))


def motions(
    support_points: npt.ArrayLike,
    weights: npt.ArrayLike,
    mu_c: npt.ArrayLike,
    contact_points: npt.ArrayLike,
    contact_normals: npt.ArrayLike,
    tip_velocities: npt.ArrayLike,
) -> Motions:
    """The motions under k pushes of an object with each of s friction distributions.

    If the tip does not move into the object, the object stays at rest: FREE.

    Args:
        support_points: (n, 2) object frame [m].
        weights: (s, n) >= 0, each row with sum 1.
        mu_c: (s,) contact friction coefficients, >= 0.
        contact_points: (k, 2) or (k, s, 2) object frame [m].
        contact_normals: (k, 2) or (k, s, 2) unit, outward.
        tip_velocities: (k, 2) or (k, s, 2) of the tip, object frame [m per any unit of time].
    Raises:
        ValueError: shapes that do not fit, values that are not finite, weights or mu_c that make no sense, normals that are not
            unit.
        SolverFailed: a motion did not converge.
    """
    points, weights, mu_c = _samples(support_points, weights, mu_c)
    contacts, normals, velocities = _rows(len(mu_c), contact_points, contact_normals, tip_velocities)
    count = len(contacts) // len(mu_c)
    samples, mu_cs = np.tile(np.arange(len(mu_c)), count), np.tile(mu_c, count)
    return motions_of_rows(points, weights, mu_cs, samples, contacts, normals, velocities).of_samples(len(mu_c))


def motions_of_rows(
    points: Array,
    weights: Array,
    mu_c: Array,
    samples: Indices,
    contacts: Array,
    normals: Array,
    velocities: Array,
    lenient: bool = False,
) -> Motions:
    """As `motions`, for r pushes with a sample and a mu_c each; the arguments are not checked.

    Args:
        points: (n, 2).
        weights: (s, n).
        mu_c: (r,).
        samples: (r,) rows of weights.
        contacts: (r, 2).
        normals: (r, 2).
        velocities: (r, 2).
        lenient: an object whose motion is not found stays at rest, as if it were FREE.
    Returns:
        Twists (r, 3), modes (r,) and forces (r, 2).
    Raises:
        SolverFailed: a motion did not converge.
    """
    twists, modes, forces = np.zeros((len(samples), 3)), np.zeros(len(samples), np.int8), np.zeros((len(samples), 2))
    contact, rows = least_dissipation.Contact(points, weights), (contacts, normals, velocities)
    outcome = least_dissipation.push_each(contact, mu_c, samples, *rows, ITERATIONS, twists, modes, forces)
    if not lenient:
        _check(outcome)
    return Motions(twists, modes, forces)


def motion_cones(
    support_points: npt.ArrayLike,
    weights: npt.ArrayLike,
    mu_c: npt.ArrayLike,
    contact_points: npt.ArrayLike,
    contact_normals: npt.ArrayLike,
) -> Array:
    """The two motions (k, s, 2, 3) at the edges of the friction cone of each contact: towards -t first, then towards +t.

    The contact moves at unit speed. A tip whose velocity lies between the contact's velocities at the two edges sticks; any
    other slides towards the side on which it lies outside (Mason 1986).

    Args and raises: as `motions`.
    """
    points, weights, mu_c = _samples(support_points, weights, mu_c)
    contacts, normals = _rows(len(mu_c), contact_points, contact_normals)
    count = len(contacts) // len(mu_c)
    samples, mu_cs = np.tile(np.arange(len(mu_c)), count), np.tile(mu_c, count)
    cones = np.empty((len(contacts), 2, 3))
    contact = least_dissipation.Contact(points, weights)
    _check(least_dissipation.cone_each(contact, mu_cs, samples, contacts, normals, ITERATIONS, cones))
    return cones.reshape(count, len(mu_c), 2, 3)


def holding_margins(
    support_points: npt.ArrayLike,
    weights: npt.ArrayLike,
    mu_c: npt.ArrayLike,
    contact_points: npt.ArrayLike,
    contact_normals: npt.ArrayLike,
    half_widths: npt.ArrayLike,
    twists: npt.ArrayLike,
    length: float,
) -> Array:
    """How far each of k stable pushes, with an edge or two fingers, is from slipping in each of s samples.

    The pusher touches the object at both ends of an interval of half-width h along an edge, and moves like a rigid body. The
    object moves with it if the forces of the contacts can balance the support friction of that motion: |f . t| <= mu_c
    (-f . n), and |m| <= h (-f . n) for the moment m of the pusher about the middle of the interval. The margin is the distance
    from that wrench to the nearest of these four faces, negative outside: the least wrench that would make the object slip.

    Args:
        support_points: (n, 2) object frame [m].
        weights: (s, n) >= 0, each row with sum 1.
        mu_c: (s,) contact friction coefficients, >= 0.
        contact_points: (k, 2) middles of the intervals, object frame [m].
        contact_normals: (k, 2) unit, outward.
        half_widths: (k,) [m]; 0: a single point, which cannot exert a moment about itself.
        twists: (k, 3) of the object-frame origin, object frame; any size but zero.
        length: a moment counts as its force at this arm [m].
    Returns:
        Margins (k, s); unit: the support friction of the translating object.
    Raises:
        ValueError: shapes that do not fit, values that are not finite, a twist of zero, or as `motions`.
    """
    points, weights, mu_c = _samples(support_points, weights, mu_c)
    contacts, normals = map(as_array, (contact_points, contact_normals))
    half, twist = as_array(half_widths), as_array(twists)
    k = len(contacts)
    if contacts.shape != (k, 2) or normals.shape != (k, 2) or half.shape != (k,) or twist.shape != (k, 3):
        got = f"{contacts.shape}, {normals.shape}, {half.shape}, {twist.shape}"
        raise ValueError(f"contacts, normals, half-widths and twists must be (k, 2), (k, 2), (k,) and (k, 3), got {got}")
    check_unit("contact_normals", normals)
    if not all(np.isfinite(array).all() for array in (contacts, half, twist)) or not (half >= 0).all():
        raise ValueError("contacts, half-widths and twists must be finite, and half-widths at least 0")
    if not twist.any(axis=1).all():
        raise ValueError("a stable push needs a motion, got a twist of zero")
    margins = np.empty((k, len(mu_c)))
    step = max(1, BLOCK // len(points))
    for start in range(0, k, step):
        rows = slice(start, start + step)
        velocities = left_of(points) * twist[rows, None, 2:] + twist[rows, None, :2]
        speeds = np.linalg.norm(velocities, axis=2)
        # Coulomb's corner is rounded, as in all motions: a support that stands still pushes neither way
        speeds = np.sqrt(speeds**2 + (STILL * speeds.max(axis=1, keepdims=True)) ** 2)
        directions = velocities / np.maximum(speeds, LEAST_DIVISOR)[..., None]
        force = np.einsum("sn,knd->ksd", weights, directions)
        moment = np.einsum("kn,sn->ks", cross(points - contacts[rows, None], directions), weights)
        pressure = -np.sum(force * normals[rows, None], axis=2)
        shear = np.abs(np.sum(force * tangent(normals[rows])[:, None], axis=2))
        friction = (mu_c * pressure - shear) / np.hypot(1.0, mu_c)
        lever = (half[rows, None] * pressure - np.abs(moment)) / np.hypot(length, half[rows, None])
        margins[rows] = np.minimum(friction, lever)
    return margins


def _samples(support_points: npt.ArrayLike, weights: npt.ArrayLike, mu_c: npt.ArrayLike) -> tuple[Array, Array, Array]:
    """Support points that bear weight in any sample (n, 2), weights (s, n), mu_c (s,)."""
    points, weights, mu_c = check_points(support_points), as_array(weights), as_array(mu_c)
    check_samples(points, weights, mu_c)
    bearing = (weights > 0).any(axis=0)
    return points[bearing], as_array(weights[:, bearing]), mu_c


def check_samples(points: Array, w: Array, mu_c: Array) -> None:
    """Refuse samples of w and mu_c that make no sense over points (n, 2).

    Raises:
        ValueError: shapes other than (s, n) and (s,), w that are negative or whose sum is not 1, or mu_c that are negative or
            not finite.
    """
    if w.ndim != 2 or w.shape[1] != len(points) or not len(w) or mu_c.shape != (len(w),):
        raise ValueError(f"w must have shape (s, {len(points)}) and mu_c (s,), s >= 1, got {w.shape} and {mu_c.shape}")
    if not (w >= 0).all() or not (np.abs(w.sum(axis=1) - 1) < SUM).all():
        raise ValueError("w must be nonnegative, and the sum of each sample 1")
    if not ((mu_c >= 0) & np.isfinite(mu_c)).all():
        raise ValueError(f"mu_c must be at least 0 and finite, got {mu_c.min():g} to {mu_c.max():g}")


def _rows(samples: int, *arrays: npt.ArrayLike) -> list[Array]:
    """Contacts, normals and perhaps velocities, (k, 2) or (k, s, 2), as (k s, 2) each."""
    given = [as_array(array) for array in arrays]
    for array in given:
        if array.ndim not in (2, 3) or array.shape[-1] != 2 or (array.ndim == 3 and array.shape[1] != samples):
            raise ValueError(f"contacts and velocities must have shape (k, 2) or (k, {samples}, 2), got {array.shape}")
    check_unit("contact_normals", given[1])
    if not all((np.abs(array) < 1 / SLOWEST).all() for array in given):
        raise ValueError("contacts and velocities must be finite, and small enough to be squared")
    if len({len(array) for array in given}) > 1:
        lengths = ", ".join(str(len(array)) for array in given)
        raise ValueError(f"contacts, normals and velocities must have the same length, got {lengths}")
    wide = [array if array.ndim == 3 else np.repeat(array[:, None], samples, axis=1) for array in given]
    return [array.reshape(-1, 2) for array in wide]


def _check(outcome: int) -> None:
    if outcome == ENDLESS:
        raise SolverFailed(f"the motion did not converge; most steps allowed: {ITERATIONS}")
    if outcome == WEDGED:
        raise SolverFailed("no sliding motion keeps the tip in contact")
