"""A damped Newton method on many small convex functions at once, one for each row.

`simulation` has a method of its own for a single function, for two reasons: it is called some thousand times a second, and
simulated data must stay the same to the last bit.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pushfric_core.errors import SolverFailed
from pushfric_core.geometry.planar import Array, Indices

STILL = 1e-4
"""A support slower than this fraction of the tip's speed begins to stick; this rounds Coulomb's law for Newton's method."""

CONVERGED = 1e-14
"""A row is done when one more step would lower its function by less than this fraction."""

GAIN = 0.1
"""A step must lower the function by at least this share of what is expected of it."""


class NewtonStep(NamedTuple):
    """Newton's step of some rows."""

    value: Array  # (s,) of the functions
    step: Array  # (s, k)
    decrease: Array  # (s,) by how much the functions should fall


def minimized(
    x: Array, newton: Callable[[Indices, Array], NewtonStep], value: Callable[[Indices, Array], Array], steps: int
) -> Array:
    """The minima (s, k), found from x (s, k).

    Args:
        x: (s, k) where to begin.
        newton: gives the step of some rows at their x.
        value: gives the functions (t,) of some rows (t,) at x (t, k).
        steps: largest number of steps of a row.
    Raises:
        SolverFailed: a row has not converged after that many steps.
    """
    x = x.copy()
    moving = np.arange(len(x))
    for _ in range(steps):
        if not len(moving):
            return x
        now, step, decrease = newton(moving, x[moving])
        going = decrease > CONVERGED * now
        moving, now, step, decrease = moving[going], now[going], step[going], decrease[going]
        # shorten each step until it gains what was expected, or until the expected gain is lost in rounding
        length = np.ones(len(moving))
        searching = np.arange(len(moving))
        while len(searching):
            rows = moving[searching]
            gain = now[searching] - value(rows, x[rows] + length[searching, None] * step[searching])
            searching = searching[gain < GAIN * length[searching] * decrease[searching]]
            length[searching] /= 2
            length[length * decrease <= CONVERGED * now] = 0.0
            searching = searching[length[searching] > 0]
        x[moving] += length[:, None] * step
        moving = moving[length > 0]
    if len(moving):
        raise SolverFailed(f"the motion did not converge; most steps allowed: {steps}")
    return x
