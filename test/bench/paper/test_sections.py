"""Sections of limit surfaces: polygons where they must be, convex, and on the surface."""

import numpy as np
import pytest

from bench.paper.sections import cross_section
from pushfric_core import TABLE_1, LimitSurface, Support
from pushfric_core.geometry.planar import Wrench, cross

HALF = 0.05
"""Half the length of the rods of Figure 12 [m]."""

ROD_2 = Support(HALF * np.array(((-1, 0), (1, 0))), np.full(2, 1 / 2))
ROD_3 = Support(HALF * np.array(((-1, 0), (0, 0), (1, 0))), np.full(3, 1 / 3))

FY, M = Wrench(0.0, 1.0, 0.0), Wrench(0.0, 0.0, 1.0)


def has(section, *corners):
    return all(np.isclose(section, corner).all(axis=1).any() for corner in corners)


def test_the_cross_sections_of_figure_12():
    """fx = 0: the forces w_j are added to or subtracted from each other, so the curves are polygons."""
    diamond, hexagon = (cross_section(LimitSurface(rod), FY, M, count=40) for rod in (ROD_2, ROD_3))
    assert has(diamond, (1.0, 0.0), (0.0, HALF), (-1.0, 0.0), (0.0, -HALF))
    third, high = 1 / 3, 2 / 3 * HALF
    assert has(hexagon, (1, 0), (third, high), (-third, high), (-1, 0), (-third, -high), (third, -high))
    fy, m = diamond.T
    assert np.abs(fy) + np.abs(m) / HALF == pytest.approx(np.ones(len(fy)))
    fy, m = hexagon.T
    assert np.maximum(np.abs(fy) + np.abs(m) / HALF, np.abs(m) / (2 / 3 * HALF)) == pytest.approx(np.ones(len(fy)))


@pytest.mark.parametrize("name", TABLE_1)
def test_cross_sections_are_convex_and_lie_on_the_surface(name):
    support, rng = TABLE_1[name].support, np.random.default_rng(1)
    surface = LimitSurface(support)
    basis = rng.normal(size=(2, 3)) * (1, 1, 0.05)
    section = cross_section(surface, Wrench(*basis[0]), Wrench(*basis[1]), count=60)
    turns = np.roll(section, -1, axis=0) - section
    turns = turns[np.linalg.norm(turns, axis=1) > 1e-9]
    turns /= np.linalg.norm(turns, axis=1)[:, None]
    assert cross(turns, np.roll(turns, -1, axis=0)).min() > -1e-5
    for point in section[::5]:
        assert surface.load(Wrench(*(point @ basis))) == pytest.approx(1)
