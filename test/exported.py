"""Objects to export."""

import numpy as np

from pushfric_core import TABLE_1, FrictionModel, Outline, Support


def even(outline, mu_c):
    """A model with uniform pressure."""
    points = outline.grid(9, 9, inset=0.004)
    return outline, FrictionModel.of(Support(points, np.full(len(points), 1 / len(points))), mu_c)


OBJECTS = {name: (known.outline, FrictionModel.of(known.support, known.mu_c)) for name, known in TABLE_1.items()}
OBJECTS["triangle"] = even(Outline([(0.0, 0.0), (0.12, 0.0), (0.0, 0.09)]), 0.25)
OBJECTS["ell"] = even(Outline([(0, 0), (0.12, 0), (0.12, 0.04), (0.05, 0.04), (0.05, 0.1), (0, 0.1)]), 0.25)
