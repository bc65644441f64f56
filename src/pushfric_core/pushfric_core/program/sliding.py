"""How the tips of pushes slide along edges, compiled: `sliding.pxd` declares the types (see `solvers.pivoting`)."""

from math import nan

import numpy as np

from pushfric_core.geometry.planar import Array, Indices

SLIP_TOLERANCE = 0.05
"""A tip counts as sliding only if its velocity along the edge, relative to the object, exceeds this share of its speed ..."""

MISMATCHES = 2.0
"""... and this many times its median apparent velocity across the edge: the tip cannot move there, so that is an error."""

SURELY = 3.0
"""A push slips only if the tip slides this many times as far as tips usually seem to move across the edge within a push."""


def directions_of(slip: Array, mismatch: Array, ends: Indices, tolerance: float) -> Array:
    """The directions of sliding of m observations, as `contact_friction.Tip.directions`.

    Args:
        slip: (m,)
        mismatch: (m,)
        ends: (p,) where each push ends, and the next begins.
        tolerance: the slip beyond which a tip counts as sliding.
    """
    found, farthest = np.zeros(len(slip)), np.empty(len(ends))
    first = begin = 0
    for p in range(len(ends)):
        farthest[p] = reach(mismatch, first, ends[p])
        first = ends[p]
    usual = float(np.median(farthest))
    first = 0
    for p in range(len(ends)):
        slide(slip, first, ends[p], tolerance, SURELY * usual, found)
        for last in range(first + 1, ends[p] + 1):
            if last == ends[p] or found[last] != found[begin]:
                still = max(MISMATCHES * usual, SLIP_TOLERANCE * (last - begin))
                if found[begin] == 0 and reach(slip, begin, last) > still:
                    for k in range(begin, last):
                        found[k] = nan
                begin = last
        first = ends[p]
    return np.asarray(found)


def reach(values: Array, first: int, last: int) -> float:
    """The largest absolute sum of consecutive values from the first to before the last."""
    total = least = greatest = 0.0
    for k in range(first, last):
        total += values[k]
        least, greatest = min(least, total), max(greatest, total)
    return greatest - least


def slide(slip: Array, first: int, last: int, tolerance: float, surely: float, found: Array) -> None:
    """Find the consecutive observations of a push in which its tip slides."""
    best = 0.0
    for direction in (1.0, -1.0):
        total = least = highest = 0.0
        bottom = begin = end = first
        for k in range(first, last):
            total += direction * slip[k] - tolerance
            if total <= least:
                least, bottom = total, k + 1
            elif total - least > highest:
                highest, begin, end = total - least, bottom, k + 1
        travelled = 0.0
        for k in range(begin, end):
            travelled += direction * slip[k]
        if highest > best and travelled > surely:
            best = highest
            for k in range(first, last):
                found[k] = direction if begin <= k < end else 0.0
