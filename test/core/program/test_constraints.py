import numpy as np
import pytest
from problems import PROBLEMS, moment, rows_of

from pushfric_core import Observation, Twist, UninformativePush
from pushfric_core.geometry.support import FreeRadii
from pushfric_core.program.constraints import Cone, Frictionless, Moment, NormalForce, SensedDirection
from pushfric_core.solvers.program import fit_error

WITHIN_5_MM = FreeRadii(0.005, 0.005)
TWO = np.array(((-0.03, 0.0), (0.03, 0.0)))


@pytest.mark.parametrize("make", PROBLEMS)
def test_moment_rows_vanish_at_the_true_weights(make):
    problem = make()
    for observation in problem.observations:
        rows = rows_of(Moment(), observation, problem.truth.points)
        assert rows.a @ problem.truth.weights == pytest.approx(0, abs=1e-5)


def test_a_moment_row_is_equation_2(rng):
    problem = PROBLEMS[0]()
    weights = rng.dirichlet(np.ones(4))
    for observation in problem.observations[:5]:
        rows = rows_of(Moment(), observation, problem.truth.points)
        assert rows.a @ weights == pytest.approx(moment(weights, problem.truth.points, observation))
        assert rows.above == rows.below == 1


def test_the_error_of_an_interval_is_what_reaches_beyond_it():
    # pushed along y at x = 0.01, both supports slide along +y: the force acts at x = w . (-0.03, 0.03)
    push = Observation((0.01, -0.05), (0.0, -1.0), Twist(0.0, 0.02, 0.0), half_width=0.004)
    rows = rows_of(Moment(), push, TWO)
    for right, error in ((1 / 2 + 0.01 / 0.06, 0.0), (1.0, 0.03 - 0.014), (0.0, 0.03 + 0.006)):
        residuals = rows.a @ (1 - right, right)
        assert fit_error(rows, residuals) == pytest.approx(error)


@pytest.mark.parametrize("make", PROBLEMS)
def test_the_pusher_pushes(make):
    problem = make()
    for observation in problem.observations:
        rows = rows_of(NormalForce(), observation, problem.truth.points)
        assert (rows.a @ problem.truth.weights > 0).all()
        assert rows.below == np.inf
        assert rows.above == 0


def test_cone_rows_cost_nothing_within_the_true_cone():
    problem = PROBLEMS[0]()  # made with mu_c = 0.5
    for observation in problem.observations:
        rows = rows_of(Cone(0.5, weight=2.0), observation, problem.truth.points)
        assert fit_error(rows, rows.a @ problem.truth.weights) == pytest.approx(0, abs=1e-3)
        assert (rows.below == 2.0).all()


def test_frictionless_rows_measure_the_tangential_force():
    rows = rows_of(Frictionless(0.05), Observation((0.0, -0.05), (0.0, -1.0), Twist(0.01, 0.01, 0.0)), TWO)
    # f = -(1, 1) / sqrt(2), t = (1, 0)
    assert rows.a @ (0.5, 0.5) == pytest.approx(-np.sqrt(0.5))
    assert rows.above == rows.below == 0.05


def test_a_direction_is_known_to_less_than_a_right_angle():
    with pytest.raises(ValueError, match=r"half_angle must lie in \[0, pi/2\), got 1.6"):
        SensedDirection(1.6)


def test_a_free_support_lowers_the_cost_as_far_as_any_force_can(rng):
    """Against all forces of at most w_j, tried one by one."""
    points = np.array(((-0.03, 0.0), (0.03, 0.0), (0.0, 0.04)))
    turn = Observation((0.0, -0.05), (0.0, -1.0), Twist(0.001, -0.031, 1.0))  # about a point 1.4 mm from the second support
    angles, sizes = np.linspace(0, 2 * np.pi, 721), np.linspace(0, 1, 21)
    disc = np.array([(r * np.cos(t), r * np.sin(t)) for r in sizes for t in angles])
    velocities = np.array([(0.001 - y, -0.031 + x) for x, y in points])
    fixed = -velocities / np.linalg.norm(velocities, axis=1)[:, None]
    for _ in range(20):
        w = rng.dirichlet(np.ones(3))
        forces = w[0] * fixed[0] + w[2] * fixed[2]
        arms = points - turn.contact_point
        known = sum(w[j] * (arms[j][0] * fixed[j][1] - arms[j][1] * fixed[j][0]) for j in (0, 2))
        moments = known + w[1] * (arms[1][0] * disc[:, 1] - arms[1][1] * disc[:, 0])
        rows = rows_of(Moment(), turn, points, free=WITHIN_5_MM)
        assert fit_error(rows, rows.a @ w) == pytest.approx(np.abs(moments).min(), abs=1e-4)
        rows = rows_of(Frictionless(2.0), turn, points, free=WITHIN_5_MM)
        assert fit_error(rows, rows.a @ w) == pytest.approx(2 * np.abs(forces[0] + w[1] * disc[:, 0]).min(), abs=2e-3)
        rows = rows_of(NormalForce(), turn, points, free=WITHIN_5_MM)
        assert rows.a @ w == pytest.approx(-forces[1] + w[1], abs=1e-9)


def test_only_supports_within_the_radius_are_free():
    turn = Observation((0.0, -0.05), (0.0, -1.0), Twist(0.001, -0.031, 1.0))
    assert len(rows_of(Moment(), turn, TWO, free=FreeRadii(0.001, 0.001)).a) == 1
    assert len(rows_of(Moment(), turn, TWO, free=FreeRadii(0.002, 0.002)).a) == 2


def test_a_support_exactly_on_the_center_of_rotation_needs_a_radius():
    turn = Observation((0.0, -0.05), (0.0, -1.0), Twist(0.0, -0.03, 1.0))
    with pytest.raises(UninformativePush, match="rotated exactly about its support point"):
        rows_of(Moment(), turn, TWO)
    assert np.isfinite(rows_of(Moment(), turn, TWO, free=FreeRadii(0.001, 0.001)).a).all()
