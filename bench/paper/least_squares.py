"""The fit that the paper warns of: least squares by singular value decomposition; w may be negative (section 7, Figure 13).

It minimises sum_i m_c,i^2 over all w of sum 1. Compared with the estimate, it shows what the nonnegativity of w is worth.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.planar import Array
from pushfric_core.geometry.support import center_of_friction, check_points, support_forces
from pushfric_core.program.constraints import Moment
from pushfric_core.records import comparable
from pushfric_core.trajectories.observation import Observation


@comparable
class LeastSquaresFit(NamedTuple):
    """The w with the least squared moments, with any signs."""

    w: Array  # (n,), sum 1; a negative w_j would gain energy from friction
    center_of_friction: Array  # p_CF (2,) [m], eq. 3; may lie outside the support points
    residuals: Array  # (m,) moments about the contacts [m, unit force]
    singular_values: Array  # (min(m, n - 1),) descending [m]; near 0: a change of w that no observation sees

    @property
    def residual(self) -> float:
        """Root of the sum of the squared moments [m, unit force]."""
        return float(np.linalg.norm(self.residuals))


def least_squares_fit(observations: Sequence[Observation], support_points: npt.ArrayLike) -> LeastSquaresFit:
    """Solve the moment constraints (eq. 4) and sum w = 1 (eq. 11) in the least-squares sense, without w >= 0.

    The paper weights eq. 11 heavily; here it holds exactly, which is the limit of that. Let A be the moments, and let the
    columns of Z be an orthonormal basis of sum w = 0. Then w = 1/n + Z z, where z is the shortest vector that minimises
    |A Z z + A 1/n|, from the singular value decomposition of A Z. If the observations do not determine w, this is the w nearest
    to uniform.

    Args:
        observations: m observations; the width of a contact interval is not used.
        support_points: (n, 2) in the object frame [m].
    Raises:
        ValueError: no observations, or support_points is not (n, 2).
        UninformativePush: an observation rotates exactly about a support point.
    """
    points = check_points(support_points)
    if not observations:
        raise ValueError("a least-squares fit needs at least one observation")
    pointlike = [replace(observation, half_width=0.0) for observation in observations]
    moments = np.concatenate([Moment().rows(one, support_forces(points, one.twist)).a for one in pointlike])
    uniform = np.full(len(points), 1 / len(points))
    # a QR decomposition that starts with the vector of ones has the basis in its other columns
    within = np.linalg.qr(np.column_stack((uniform, np.eye(len(points))[:, 1:])))[0][:, 1:]
    left, singular_values, right = np.linalg.svd(moments @ within, full_matrices=False)
    seen = singular_values > np.finfo(float).eps * max(moments.shape) * np.linalg.norm(moments)
    shift = right[seen].T @ (left[:, seen].T @ (moments @ uniform) / singular_values[seen])
    w = uniform - within @ shift
    return LeastSquaresFit(w, center_of_friction(points, w), moments @ w, singular_values)
