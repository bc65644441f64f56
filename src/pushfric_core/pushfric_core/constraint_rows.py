"""The rows of the fit error: every constraint makes them from a data point, and every solver takes them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pushfric_core.planar import Array
from pushfric_core.records import comparable


@comparable
class ConstraintRows(NamedTuple):
    """Rows a of the fit error phi(a . w) = above * max(a . w, 0) + below * max(-a . w, 0); an infinite cost is a hard side.

    Rows have a column for each support point. Those of a measured force have one more, for the scale s: one over the total
    support friction of the translating object [1/N], which turns newtons into the unit of w.
    """

    a: Array  # (m, n), or (m, n + 1) with the column of the scale
    above: Array  # (m,) cost per unit of a . w > 0
    below: Array  # (m,) cost per unit of a . w < 0


def stack(parts: Sequence[ConstraintRows], n: int) -> ConstraintRows:
    """The rows of several constraints as one record with n columns; rows without the column of the scale get zeros there."""
    a = [np.pad(part.a, ((0, 0), (0, n - part.a.shape[1]))) if part.a.shape[1] < n else part.a for part in parts]
    return ConstraintRows(
        np.concatenate([np.zeros((0, n)), *a]),
        np.concatenate([np.zeros(0), *(part.above for part in parts)]),
        np.concatenate([np.zeros(0), *(part.below for part in parts)]),
    )
