"""Which of many estimates of one object differ from the others."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

FEWEST = 5
"""With fewer estimates of an object, none is called an outlier."""

TOO_FAR = 3.5
"""An estimate differs if its modified z-score is larger (Iglewicz and Hoaglin, How to Detect and Handle Outliers, 1993)."""

TOO_FAR_IN_THE_PLANE = 3.92
"""A normally distributed point in the plane is farther than this many standard deviations from its mean as rarely as a number
is farther than TOO_FAR."""

RESOLUTION = 1e-4
"""Differences of p_CF below this do not matter [m]."""

NORMAL, RAYLEIGH = 0.6745, 1.1774
"""Median absolute deviation of the standard normal distribution, and median distance of such a point in the plane."""


def modified_z(values: npt.ArrayLike, resolution: float) -> npt.NDArray[np.float64]:
    """How far each value lies from their median, in robust standard deviations.

    Args:
        values: (M,) numbers, at least one; NaN for one that is not known.
        resolution: differences smaller than this mean nothing, in the unit of the values.
    Returns:
        (M,) numbers >= 0; 0 for a value that is not known.
    """
    values = np.asarray(values, dtype=float)
    if np.isnan(values).all():
        return np.zeros_like(values)
    distances = np.abs(values - np.nanmedian(values))
    return np.asarray(np.nan_to_num(NORMAL * distances / max(np.nanmedian(distances), resolution)))


def differing(points: npt.ArrayLike, errors: Sequence[float], mu_c: Sequence[float | None]) -> list[list[str]]:
    """Why each of M estimates of one object differs from the others; an empty list for one that does not.

    Args:
        points: (M, 2) centres of friction [m].
        errors: fit error for each observation.
        mu_c: contact friction coefficients; None for one that is only bounded.
    Returns:
        For each estimate a list of reasons in words; all are empty if there are too few estimates.
    """
    points = np.asarray(points, dtype=float)
    reasons: list[list[str]] = [[] for _ in errors]
    if len(reasons) < FEWEST:
        return reasons
    far = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    half = float(np.median(far))
    known = np.array([math.nan if value is None else value for value in mu_c])
    # logarithms, because fit errors scatter by factors
    logs = np.log10(np.maximum(errors, 1e-12))
    for reason, z_error, z_mu, distance, error, mu in zip(
        reasons, modified_z(logs, 0.1), modified_z(known, 0.01), far, errors, known, strict=True
    ):
        if distance > TOO_FAR_IN_THE_PLANE * max(half / RAYLEIGH, RESOLUTION):
            reason.append(
                f"p_CF lies {distance * 1e3:.1f} mm from the middle of all; half of them lie within {half * 1e3:.1f} mm"
            )
        if z_error > TOO_FAR and error > np.median(errors):
            times = error / max(float(np.median(errors)), 1e-12)
            reason.append(f"the fit error of an observation is {times:.1f} times that of the others")
        if z_mu > TOO_FAR:
            reason.append(f"mu_c is {mu:.3f}; the median is {np.nanmedian(known):.3f}")
    return reasons
