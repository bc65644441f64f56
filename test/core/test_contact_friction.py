import math

import numpy as np
import pytest

from pushfric_core.contact_friction import lower_bounds, percentile
from pushfric_core.observation import Observation
from pushfric_core.planar import Twist

MIDDLE = np.array(((0.0, 0.0),))


@pytest.mark.parametrize(
    ("direction", "bound"), [((0.0, 1.0), 0.0), ((1.0, 2.0), 0.5), ((-3.0, 1.0), 3.0), ((1.0, -1.0), math.inf)]
)
def test_the_bound_is_the_slope_of_the_force_against_the_normal(direction, bound):
    push = Observation((0.0, -0.05), (0.0, -1.0), Twist(*direction, 0.0))
    assert lower_bounds([push], MIDDLE, np.ones(1)) == pytest.approx([bound])


def test_percentiles_are_order_statistics():
    bounds = np.array((0.3, 0.1, math.inf, 0.2, 0.5, 0.4, 0.6, 0.7, 0.9, 0.8))
    assert percentile(bounds, 0.9) == 0.9
    assert percentile(bounds, 1.0) == math.inf
    assert percentile(bounds, 0.05) == 0.1
    assert percentile(bounds[:3], 0.9) == math.inf


def test_a_percentile_needs_data_and_a_share():
    with pytest.raises(ValueError, match="at least one"):
        percentile(np.array(()), 0.9)
    with pytest.raises(ValueError, match=r"share must lie in \(0, 1\]"):
        percentile(np.ones(3), 0.0)
