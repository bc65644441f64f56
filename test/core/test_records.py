import numpy as np
from problems import PROBLEMS

from pushfric_core import (
    ConstraintRows,
    Estimator,
    HalfPlanes,
    Hypothesis,
    LimitSurface,
    NamedEllipsoid,
    Outline,
    Support,
    Twist,
)
from pushfric_core.geometry.support import support_forces
from pushfric_core.geometry.table_1 import TABLE_1
from pushfric_core.mechanics.simulation import PushedObject

SQUARE = np.array(((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)))


def records(size):
    """One of each kind of record that holds arrays, all of them different for another size."""
    problem = PROBLEMS[0]()
    points = size * SQUARE
    support = Support(points, np.full(4, 0.25))
    surface = LimitSurface(support)
    estimate = Estimator(0.01 * points).add(problem.observations[0])
    return [
        estimate,
        estimate.solution,
        estimate.contact_forces,
        support,
        support_forces(points, Twist(0.1, 0.2, 0.3)),
        Outline(points),
        Outline(points).first_touch((-3.0, 0.5 * size), (1.0, 0.0)),
        Hypothesis("square", points, points.mean(axis=0)),
        PushedObject(Outline(points), support, 0.5, problem.observations[0].pose),
        TABLE_1["wood_rect4"]._replace(outline=Outline(points)),
        HalfPlanes(Outline(points)).region(),
        surface.facets[0],
        surface.reachable(points[:1], [[-1.0, 0.0]], 0.3),
        NamedEllipsoid(1.0, size, points[0]),
        ConstraintRows(size * np.eye(2), np.ones(2), np.ones(2)),
    ]


def test_records_compare_by_what_they_hold():
    for one, same, other in zip(records(1.0), records(1.0), records(2.0), strict=True):
        assert one is not same
        assert (one == same) is True, type(one)
        assert (one != same) is False, type(one)
        assert (one == other) is False, type(one)
        assert (one != other) is True, type(one)
        assert one != "something else"
