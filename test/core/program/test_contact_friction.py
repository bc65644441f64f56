import math

import numpy as np
import pytest

from pushfric_core import Observation, Twist
from pushfric_core.geometry.support import FreeRadii, support_forces
from pushfric_core.program.contact_friction import contact_forces, lower_bounds, percentile

MIDDLE = np.array(((0.0, 0.0),))


@pytest.mark.parametrize(
    ("direction", "bound"), [((0.0, 1.0), 0.0), ((1.0, 2.0), 0.5), ((-3.0, 1.0), 3.0), ((1.0, -1.0), math.inf)]
)
def test_the_bound_is_the_slope_of_the_force_against_the_normal(direction, bound):
    push = Observation((0.0, -0.05), (0.0, -1.0), Twist(*direction, 0.0))
    forces = contact_forces(push, support_forces(MIDDLE, push.twist))
    assert lower_bounds(forces, np.ones(1)) == pytest.approx([bound])


@pytest.mark.parametrize("radius", [0.0, 0.005])
def test_a_free_support_turns_the_force_to_the_normal_as_far_as_it_can(radius):
    """Against all forces it may apply, tried one by one."""
    points = np.array(((-0.03, 0.0), (0.03, 0.0), (0.0, 0.04)))
    turn = Observation((0.0, -0.05), (0.0, -1.0), Twist(0.001, -0.031, 1.0))  # about a point 1.4 mm from the second support
    forces = contact_forces(turn, support_forces(points, turn.twist, FreeRadii(radius, radius)))
    angles, sizes = np.meshgrid(np.linspace(0, 2 * np.pi, 3601), np.linspace(0, 1, 101))
    for w in ((0.4, 0.1, 0.5), (0.1, 0.2, 0.7), (0.2, 0.6, 0.2), (0.98, 0.01, 0.01)):
        fixed = w @ np.array([(forces.normal[0, j], forces.along[0, j]) for j in range(3)])
        reach = w[1] if radius else 0.0
        normal, along = fixed[0] + reach * sizes * np.cos(angles), fixed[1] + reach * sizes * np.sin(angles)
        tried = np.where(normal > 1e-9, np.abs(along) / np.maximum(normal, 1e-9), np.inf).min()
        assert lower_bounds(forces, np.array(w))[0] == pytest.approx(tried, rel=1e-3, abs=1e-3)


def test_percentiles_are_order_statistics():
    bounds = np.array((0.3, 0.1, math.inf, 0.2, 0.5, 0.4, 0.6, 0.7, 0.9, 0.8))
    assert percentile(bounds, 0.9) == 0.9
    assert percentile(bounds, 1.0) == math.inf
    assert percentile(bounds, 0.05) == 0.1
    assert percentile(bounds[:3], 0.9) == math.inf
