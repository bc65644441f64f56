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


def corners(section):
    return {tuple(np.round(end, 9) + 0.0) for chord in section.facets for end in chord}


def test_the_cross_sections_of_figure_12():
    """fx = 0: the forces w_j are added to or subtracted from each other, so the curves are polygons."""
    diamond, hexagon = (cross_section(LimitSurface(rod), FY, M, count=40) for rod in (ROD_2, ROD_3))
    assert corners(diamond) == {(1.0, 0.0), (0.0, HALF), (-1.0, 0.0), (0.0, -HALF)}
    third, high = round(1 / 3, 9), round(2 / 3 * HALF, 9)
    assert corners(hexagon) == {(1, 0), (third, high), (-third, high), (-1, 0), (-third, -high), (third, -high)}
    fy, m = diamond.points.T
    assert np.abs(fy) + np.abs(m) / HALF == pytest.approx(np.ones(len(fy)))
    fy, m = hexagon.points.T
    assert np.maximum(np.abs(fy) + np.abs(m) / HALF, np.abs(m) / (2 / 3 * HALF)) == pytest.approx(np.ones(len(fy)))


@pytest.mark.parametrize("name", TABLE_1)
def test_cross_sections_are_convex_and_lie_on_the_surface(name):
    support, rng = TABLE_1[name].support, np.random.default_rng(1)
    surface = LimitSurface(support)
    basis = rng.normal(size=(2, 3)) * (1, 1, 0.05)
    section = cross_section(surface, Wrench(*basis[0]), Wrench(*basis[1]), count=60)
    turns = np.roll(section.points, -1, axis=0) - section.points
    turns = turns[np.linalg.norm(turns, axis=1) > 1e-9]
    turns /= np.linalg.norm(turns, axis=1)[:, None]
    assert cross(turns, np.roll(turns, -1, axis=0)).min() > -1e-5
    on_chords = [chord[0] + share * (chord[1] - chord[0]) for chord in section.facets for share in (0.0, 0.4, 1.0)]
    for point in [*section.points[::10], *on_chords]:
        assert surface.load(Wrench(*(point @ basis))) == pytest.approx(1)
