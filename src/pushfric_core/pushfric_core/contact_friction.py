"""The contact friction coefficient mu_c: a lower bound from every data point, and what they say together (section 5.1.3)."""

import math
from collections.abc import Sequence

import numpy as np

from pushfric_core.contact import tangent
from pushfric_core.observation import Observation
from pushfric_core.planar import Array
from pushfric_core.support import friction_directions


def lower_bounds(observations: Sequence[Observation], support_points: Array, weights: Array) -> Array:
    """tan(eta) = |f . t| / (f . n) of each data point (m,), infinite where f . n <= 0 (eq. 12).

    Args:
        observations: m data points.
        support_points: (n, 2) [m].
        weights: (n,) estimate of w.
    """
    bounds = np.empty(len(observations))
    for k, observation in enumerate(observations):
        force = weights @ friction_directions(support_points, observation.twist)
        normal = float(force @ observation.contact_normal)
        bounds[k] = abs(float(force @ tangent(observation.contact_normal))) / normal if normal > 0 else math.inf
    return bounds


def percentile(bounds: Array, share: float) -> float:
    """The value at or below which `share` of the lower bounds (m,) lie: order statistic ceil(share * m).

    Raises:
        ValueError: no bounds, or a share outside (0, 1].
    """
    if not len(bounds):
        raise ValueError("a percentile needs at least one lower bound")
    if not 0 < share <= 1:
        raise ValueError(f"share must lie in (0, 1], got {share}")
    # the subtraction forgives 0.9 * 10 being a little above 9
    rank = math.ceil(share * len(bounds) - 1e-9)
    return float(np.sort(bounds)[rank - 1])
