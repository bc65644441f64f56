"""The exact quasi-static model (section 2) of many pushes and many friction distributions at once.

The mechanics are those of `simulation.pushed_motion`, one row for each pair of a push and a sample of (w, mu_c). If the tip
sticks, the object turns about the contact at the rate that dissipates least, which leaves no moment about the contact. If that
needs a force outside the friction cone, the tip slides: the force lies on the cone's edge, and of all motions in which it does
the same work, the object takes the one that dissipates least.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.errors import SolverFailed
from pushfric_core.geometry.contact import tangent
from pushfric_core.geometry.planar import LEAST_DIVISOR, Array, Indices, as_array, cross, left_of
from pushfric_core.geometry.support import check_points
from pushfric_core.mechanics.damped_newton import Step, minimized
from pushfric_core.mechanics.simulation import ITERATIONS, STILL, ContactMode
from pushfric_core.records import comparable

MODES = (ContactMode.FREE, ContactMode.STICKING, ContactMode.SLIDING)
"""What the numbers in `Motions.modes` stand for."""

FREE, STICKING, SLIDING = range(len(MODES))

BLOCK = 65_536
"""Numbers in an array of the innermost loops: few enough to stay in the cache, and many for the calls that some rows need."""

BISECTIONS = 100
"""Bound on the steps of a search on a line; about ten are usual."""

NARROW = 1e-12
"""The search on a line ends when its bracket has shrunk to this fraction of the first one."""

SUM = 1e-6
"""The sum of weights may differ from 1 by this much."""


@comparable
class Motions(NamedTuple):
    """How pushed objects move at an instant, for k pushes and s samples."""

    twists: Array  # (k, s, 3) of the object-frame origin, object frame, per the unit of time of the tip's velocity
    modes: npt.NDArray[np.int8]  # (k, s) indices of MODES
    forces: Array  # (k, s, 2) of the pusher ON the object; unit: the support friction of the translating object


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
        ValueError: shapes that do not fit, values that are not finite, weights or mu_c that make no sense.
        SolverFailed: a motion did not converge.
    """
    points, weights, mu_c = _samples(support_points, weights, mu_c)
    contacts, normals, velocities = _rows(len(mu_c), contact_points, contact_normals, tip_velocities)
    count = len(contacts) // len(mu_c)
    samples = np.tile(np.arange(len(mu_c)), count)
    moved = motions_of_rows(points, weights[samples], mu_c[samples], contacts, normals, velocities)
    shape = (count, len(mu_c))
    return Motions(moved.twists.reshape(*shape, 3), moved.modes.reshape(shape), moved.forces.reshape(*shape, 2))


def motions_of_rows(points: Array, weights: Array, mu_c: Array, contacts: Array, normals: Array, velocities: Array) -> Motions:
    """As `motions`, for r pushes with a friction distribution each; the arguments are not checked.

    Args:
        points: (n, 2).
        weights: (r, n).
        mu_c: (r,).
        contacts: (r, 2).
        normals: (r, 2).
        velocities: (r, 2).
    Returns:
        Twists (r, 3), modes (r,) and forces (r, 2).
    Raises:
        SolverFailed: a motion did not converge.
    """
    twists, forces = np.zeros((len(contacts), 3)), np.zeros((len(contacts), 2))
    modes = np.full(len(contacts), FREE, dtype=np.int8)
    pushing = np.flatnonzero(np.sum(velocities * normals, axis=1) < 0)
    step = max(1, BLOCK // len(points))
    for start in range(0, len(pushing), step):
        rows = pushing[start : start + step]
        twists[rows], modes[rows], forces[rows] = _pushed(
            points, weights[rows], mu_c[rows], contacts[rows], normals[rows], velocities[rows]
        )
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
    samples = np.tile(np.arange(len(mu_c)), count)
    cones = np.empty((len(contacts), 2, 3))
    step = max(1, BLOCK // len(points))
    for start in range(0, len(contacts), step):
        rows = slice(start, start + step)
        arms = points - contacts[rows, None]
        for side, sign in enumerate((-1.0, 1.0)):
            edges = -normals[rows] + (sign * mu_c[samples[rows]])[:, None] * tangent(normals[rows])
            edges /= np.linalg.norm(edges, axis=1)[:, None]
            slip, omega, _ = _sliding(weights[samples[rows]], arms, edges)
            moved = edges + slip[:, None] * left_of(edges)
            origin = moved - omega[:, None] * left_of(contacts[rows])
            cones[rows, side] = np.column_stack((origin, omega)) / np.linalg.norm(moved, axis=1)[:, None]
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
    if not all(np.isfinite(array).all() for array in (contacts, normals, half, twist)) or not (half >= 0).all():
        raise ValueError("contacts, normals, half-widths and twists must be finite, and half-widths at least 0")
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
        directions = velocities / speeds[..., None]
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
    if weights.ndim != 2 or weights.shape[1] != len(points) or mu_c.shape != weights.shape[:1] or not len(mu_c):
        raise ValueError(
            f"weights must have shape (s, {len(points)}) and mu_c (s,), s >= 1, got {weights.shape} and {mu_c.shape}"
        )
    if not (weights >= 0).all() or not (np.abs(weights.sum(axis=1) - 1) < SUM).all():
        raise ValueError("weights must be nonnegative, and the sum of each row 1")
    if not ((mu_c >= 0) & np.isfinite(mu_c)).all():
        raise ValueError(f"mu_c must be at least 0 and finite, got {mu_c.min():g} to {mu_c.max():g}")
    bearing = (weights > 0).any(axis=0)
    return points[bearing], weights[:, bearing], mu_c


def _rows(samples: int, *arrays: npt.ArrayLike) -> list[Array]:
    """Arrays (k, 2) or (k, s, 2) as (k s, 2) each."""
    given = [as_array(array) for array in arrays]
    for array in given:
        if array.ndim not in (2, 3) or array.shape[-1] != 2 or (array.ndim == 3 and array.shape[1] != samples):
            raise ValueError(f"contacts and velocities must have shape (k, 2) or (k, {samples}, 2), got {array.shape}")
        if not np.isfinite(array).all():
            raise ValueError("contacts and velocities must be finite")
    if len({len(array) for array in given}) > 1:
        lengths = ", ".join(str(len(array)) for array in given)
        raise ValueError(f"contacts, normals and velocities must have the same length, got {lengths}")
    wide = [array if array.ndim == 3 else np.repeat(array[:, None], samples, axis=1) for array in given]
    return [array.reshape(-1, 2) for array in wide]


def _pushed(
    points: Array, weights: Array, mu_c: Array, contacts: Array, normals: Array, velocities: Array
) -> tuple[Array, npt.NDArray[np.int8], Array]:
    """Twists (r, 3), modes (r,) and forces (r, 2) of tips that move into the object."""
    arms = points - contacts[:, None]  # (r, n, 2)
    speeds = np.linalg.norm(velocities, axis=1)
    directions = velocities / speeds[:, None]
    omegas, forces = _sticking(weights, arms, directions)
    at_contact = np.column_stack((velocities, omegas * speeds))
    modes = np.full(len(contacts), STICKING, dtype=np.int8)

    along = tangent(normals)
    shear, pressure = np.sum(forces * along, axis=1), -np.sum(forces * normals, axis=1)
    slips = np.flatnonzero(np.abs(shear) > mu_c * pressure)
    if len(slips):
        # sticking would need a force outside the friction cone: this is the cone's edge on that side
        edges = -normals[slips] + (np.sign(shear[slips]) * mu_c[slips])[:, None] * along[slips]
        edges /= np.linalg.norm(edges, axis=1)[:, None]
        slip, omega, forces[slips] = _sliding(weights[slips], arms[slips], edges)
        moved = edges + slip[:, None] * left_of(edges)
        inward = -np.sum(moved * normals[slips], axis=1)
        if not (inward > 0).all():
            raise SolverFailed("no sliding motion keeps the tip in contact")
        scale = -np.sum(velocities[slips] * normals[slips], axis=1) / inward
        at_contact[slips] = np.column_stack((moved, omega)) * scale[:, None]
        modes[slips] = SLIDING
    origin = at_contact[:, :2] - at_contact[:, 2:] * left_of(contacts)
    return np.column_stack((origin, at_contact[:, 2])), modes, forces


def _sticking(weights: Array, arms: Array, velocities: Array) -> tuple[Array, Array]:
    """The rotations (r,) about the contacts that dissipate least, and the forces (r, 2), of contacts with unit velocities.

    Newton's method on the moment about the contact, which grows with the rotation. If a step leaves the bracket, or is more
    than half as long as the last one, the bracket is halved instead.

    Args:
        weights: (r, n).
        arms: (r, n, 2) from the contacts to the support points [m].
        velocities: (r, 2) unit vectors.
    """
    squares = np.sum(arms**2, axis=2)
    works = np.asarray(cross(arms, velocities[:, None]))  # v . (-y, x) of each arm
    # at these rotations, each support by itself moves slowest
    own = np.where((squares > 0) & (weights > 0), -works / np.maximum(squares, LEAST_DIVISOR), np.nan)
    with np.errstate(all="ignore"):
        low = np.fmin.reduce(own, axis=1, initial=np.nan)
        high = np.fmax.reduce(own, axis=1, initial=np.nan)
    low, high = np.nan_to_num(low), np.nan_to_num(high)  # all the weight at the contact: it does not rotate
    omegas = (low + high) / 2
    narrow = NARROW * (high - low)
    last = high - low
    going = np.flatnonzero(high > low)
    w, work, square = weights[going], works[going], squares[going]
    low, high, omega, last, narrow = (array[going] for array in (low, high, omegas, last, narrow))
    for _ in range(BISECTIONS):
        if not len(going):
            break
        slope = work + omega[:, None] * square
        speed = np.sqrt(1 + STILL**2 + omega[:, None] * (work + slope))
        share = w / speed
        moment = np.sum(share * slope, axis=1)
        stiffness = np.sum(share * (square - (slope / speed) ** 2), axis=1)
        above = moment > 0
        high, low = np.where(above, omega, high), np.where(above, low, omega)
        newton = omega - moment / np.maximum(stiffness, LEAST_DIVISOR)
        usable = (newton > low) & (newton < high)
        # near a support that almost stands still, Newton's steps are short and hardly shrink
        usable &= np.abs(newton - omega) <= last / 2
        following = np.where(usable, newton, (low + high) / 2)
        last, omega = np.abs(following - omega), following
        goes_on = (last > narrow) & (high - low > narrow)
        if not goes_on.all():
            omegas[going] = omega
            going, w, work, square = going[goes_on], w[goes_on], work[goes_on], square[goes_on]
            low, high, omega, last, narrow = (array[goes_on] for array in (low, high, omega, last, narrow))
    omegas[going] = omega
    turn = omegas[:, None]
    speed = np.sqrt(1 + STILL**2 + turn * (2 * works + turn * squares))
    share = weights / speed
    turning = np.einsum("rn,rnd->rd", share, left_of(arms))
    return omegas, share.sum(axis=1)[:, None] * velocities + turn * turning


def _sliding(weights: Array, arms: Array, edges: Array) -> tuple[Array, Array, Array]:
    """For contacts pushed along unit forces: velocity across the force per velocity along it (r,), rotation (r,), force (r, 2).

    A damped Newton method on the dissipation, a convex function of the first two.

    Args:
        weights: (r, n).
        arms: (r, n, 2) from the contacts to the support points [m].
        edges: (r, 2) unit forces.
    """
    lever = np.asarray(cross(arms, edges[:, None]))  # what a unit of rotation adds along the force
    reach = np.sum(arms * edges[:, None], axis=2)  # and across it
    squares = lever**2 + reach**2
    trace = 1e-9 * np.array((np.full(len(edges), arms.shape[1]), squares.sum(axis=1))).T

    def speeds_at(rows: Indices, u: Array) -> tuple[Array, Array, Array]:
        ahead, across = 1 + u[:, 1:] * lever[rows], u[:, :1] + u[:, 1:] * reach[rows]
        return ahead, across, np.sqrt(ahead**2 + across**2 + STILL**2)

    def newton(rows: Indices, u: Array) -> Step:
        w = weights[rows]
        ahead, across, speed = speeds_at(rows, u)
        share = w / speed
        growth = ahead * lever[rows] + across * reach[rows]
        bend = share / speed**2
        gradient = np.column_stack((np.sum(share * across, axis=1), np.sum(share * growth, axis=1)))
        a = np.sum(share - bend * across**2, axis=1) + trace[rows, 0]
        b = np.sum(share * reach[rows] - bend * across * growth, axis=1)
        c = np.sum(share * squares[rows] - bend * growth**2, axis=1) + trace[rows, 1]
        determinant = a * c - b * b
        step = np.column_stack((b * gradient[:, 1] - c * gradient[:, 0], b * gradient[:, 0] - a * gradient[:, 1]))
        step /= determinant[:, None]
        return Step(np.sum(w * speed, axis=1), step, -np.sum(gradient * step, axis=1))

    def dissipation(rows: Indices, u: Array) -> Array:
        return np.asarray(np.sum(weights[rows] * speeds_at(rows, u)[2], axis=1))

    u = minimized(np.zeros((len(edges), 2)), newton, dissipation, ITERATIONS)
    ahead, across, speed = speeds_at(np.arange(len(edges)), u)
    share = weights / speed
    force = np.sum(share * ahead, axis=1)[:, None] * edges + np.sum(share * across, axis=1)[:, None] * left_of(edges)
    return u[:, 0], u[:, 1], force
