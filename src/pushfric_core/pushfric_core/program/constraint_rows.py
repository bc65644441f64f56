"""The rows of the fit error: every constraint makes them from an observation, and every solver takes them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pushfric_core.geometry.planar import Array
from pushfric_core.records import comparable


@comparable
class ConstraintRows(NamedTuple):
    """Rows a of the fit error phi(a . w) = above * max(a . w, 0) + below * max(-a . w, 0); an infinite cost is a hard side.

    Rows have a column for each support point. Those of a measured force have one more, for the scale s: one over the total
    support friction of the translating object [1/N], which turns newtons into the unit of w.

    Example:
        >>> import numpy as np
        >>> from pushfric_core import ConstraintRows
        >>> rows = ConstraintRows(a=np.array([[0.01, -0.02]]), above=np.array([1.0]), below=np.array([1.0]))
        >>> (rows.a @ (0.5, 0.5)).tolist()
        [-0.005]
    """

    a: Array  # (m, n), or (m, n + 1) with the column of the scale
    above: Array  # (m,) cost per unit of a . w > 0
    below: Array  # (m,) cost per unit of a . w < 0


def stack(parts: Sequence[ConstraintRows], n: int) -> ConstraintRows:
    """The rows of several constraints as one record with n columns; rows without the column of the scale get zeros there."""
    if parts and all(part.a.shape[1] == n for part in parts):
        return ConstraintRows(*map(np.concatenate, zip(*parts, strict=True)))
    m = sum(len(part.above) for part in parts)
    a, costs = np.zeros((m, n)), np.empty((2, m))
    first = 0
    for part in parts:
        last = first + len(part.above)
        a[first:last, : part.a.shape[1]] = part.a
        costs[0, first:last], costs[1, first:last] = part.above, part.below
        first = last
    return ConstraintRows(a, costs[0], costs[1])
