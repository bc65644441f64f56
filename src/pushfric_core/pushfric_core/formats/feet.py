"""The fewest feet that slide like a support: the point contacts of an object in a simulator."""

from typing import NamedTuple

import numpy as np

from pushfric_core.geometry.planar import Array, cross, left_of
from pushfric_core.geometry.support import Support
from pushfric_core.mechanics.surface_models import SurfaceError, support_error, surface_samples
from pushfric_core.records import comparable

TOLERANCE = SurfaceError(load=0.01, twist=np.radians(0.7))
"""Feet may err by this much. After 50 mm, they end about 0.2 mm (median) from where the support would."""

FIRM = 1e3
"""The total force and the centre of friction count this much more than the wrench of one motion."""

NOTHING = 1e-3
"""Share of the load below which a foot is left out."""


@comparable
class Feet(NamedTuple):
    """Feet, and how far their limit surface is from that of the support for which they stand."""

    support: Support
    error: SurfaceError


def few_feet(support: Support) -> Feet:
    """Some of the support points, reweighted, with the same total force and centre of friction and nearly the same surface.

    One point after another is added: the one that lowers the residual of the wrenches most steeply. After each, the weights are
    the nonnegative least squares of the wrenches over motions of all directions (orthogonal matching pursuit). If nearly all
    rests on one point, the feet are the support points themselves.

    Args:
        support: of the object.
    """
    from scipy.optimize import nnls  # takes longer to load than the rest of this package

    bearing = support.weights > 0
    points, weights = support.points[bearing], support.weights[bearing]
    if not np.ptp(points, axis=0).any():  # its limit surface encloses no volume
        return Feet(Support(points[:1], np.ones(1)), SurfaceError(0.0, 0.0))
    wrenches = _wrenches(points, support)
    goal = wrenches @ weights
    steepness = np.linalg.norm(wrenches, axis=0)
    chosen: list[int] = []
    residual = goal
    while True:
        gain = wrenches.T @ residual / steepness
        gain[chosen] = -np.inf
        chosen.append(int(np.argmax(gain)))
        found, _ = nnls(wrenches[:, chosen], goal)
        residual = goal - wrenches[:, chosen] @ found
        bears = found > NOTHING * found.sum()
        every = len(chosen) == len(points)
        if np.count_nonzero(bears) < 2:
            if every:
                return Feet(Support(points, weights / weights.sum()), SurfaceError(0.0, 0.0))
            continue
        feet = Support(points[chosen][bears], found[bears] / found[bears].sum())
        error = support_error(feet, support)
        if every or (error.load <= TOLERANCE.load and error.twist <= TOLERANCE.twist):
            return Feet(feet, error)


def _wrenches(points: Array, support: Support) -> Array:
    """The share of a unit of weight at each point in the wrenches of s motions, the force and the first moments (3s + 3, n).

    Moments are about p_CF, in units that make the limit surface about round.
    """
    _, twists = surface_samples(support)
    velocities = left_of(points) * twists[:, None, 2:] + twists[:, None, :2]
    speeds = np.linalg.norm(velocities, axis=2, keepdims=True)
    directions = velocities / np.where(speeds > 0, speeds, 1.0)
    center = support.center_of_friction
    arms = (points - center) / (support.weights @ np.linalg.norm(support.points - center, axis=1))
    firm = FIRM * np.vstack((np.ones(len(points)), arms.T))
    return np.concatenate((directions[..., 0], directions[..., 1], cross(arms, directions), firm))
