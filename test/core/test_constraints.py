import dataclasses

import numpy as np
import pytest
from problems import PROBLEMS, moment

from pushfric_core.constraints import cone_rows, frictionless_rows, moment_rows, normal_force_rows, stack
from pushfric_core.linear_program import fit_error
from pushfric_core.observation import Observation
from pushfric_core.planar import Twist

PULLED = Observation((0.0, -0.05), (0.0, -1.0), Twist(0.0, -0.02, 0.0))  # moves towards the pusher
TWO = np.array(((-0.03, 0.0), (0.03, 0.0)))


@pytest.mark.parametrize("make", PROBLEMS)
def test_moment_rows_vanish_at_the_true_weights(make):
    problem = make()
    for observation in problem.observations:
        rows = moment_rows(observation, problem.truth.points)
        assert rows.a @ problem.truth.weights == pytest.approx(0, abs=1e-5)


def test_a_moment_row_is_equation_2(rng):
    problem = PROBLEMS[0]()
    weights = rng.dirichlet(np.ones(4))
    for observation in problem.observations[:5]:
        rows = moment_rows(observation, problem.truth.points)
        assert rows.a @ weights == pytest.approx(moment(weights, problem.truth.points, observation))
        assert rows.above == rows.below == 1


def test_the_error_of_an_interval_is_what_reaches_beyond_it():
    # pushed along y at x = 0.01, both supports slide along +y: the force acts at x = w . (-0.03, 0.03)
    push = Observation((0.01, -0.05), (0.0, -1.0), Twist(0.0, 0.02, 0.0), half_width=0.004)
    rows = moment_rows(push, TWO)
    for right, error in ((1 / 2 + 0.01 / 0.06, 0.0), (1.0, 0.03 - 0.014), (0.0, 0.03 + 0.006)):
        residuals = rows.a @ (1 - right, right)
        assert fit_error(rows, residuals) == pytest.approx(error)


def test_an_interval_without_width_costs_as_the_point_does(rng):
    problem = PROBLEMS[0]()
    weights = rng.dirichlet(np.ones(4))
    observation = problem.observations[0]
    narrow = moment_rows(dataclasses.replace(observation, half_width=1e-12), problem.truth.points)
    point = moment_rows(observation, problem.truth.points)
    assert fit_error(narrow, narrow.a @ weights) == pytest.approx(fit_error(point, point.a @ weights))


@pytest.mark.parametrize("make", PROBLEMS)
def test_the_pusher_pushes(make):
    problem = make()
    for observation in problem.observations:
        rows = normal_force_rows(observation, problem.truth.points)
        assert (rows.a @ problem.truth.weights > 0).all()
        assert rows.below == np.inf
        assert rows.above == 0


def test_a_pulled_object_violates_the_normal_force():
    assert (normal_force_rows(PULLED, TWO).a @ (0.5, 0.5) < 0).all()


def test_cone_rows_cost_nothing_within_the_true_cone():
    problem = PROBLEMS[0]()  # made with mu_c = 0.5
    for observation in problem.observations:
        rows = cone_rows(observation, problem.truth.points, mu_bound=0.5, weight=2.0)
        assert fit_error(rows, rows.a @ problem.truth.weights) == pytest.approx(0, abs=1e-3)
        assert (rows.below == 2.0).all()


def test_frictionless_rows_measure_the_tangential_force():
    rows = frictionless_rows(Observation((0.0, -0.05), (0.0, -1.0), Twist(0.01, 0.01, 0.0)), TWO, weight=0.05)
    # f = -(1, 1) / sqrt(2), t = (1, 0)
    assert rows.a @ (0.5, 0.5) == pytest.approx(-np.sqrt(0.5))
    assert rows.above == rows.below == 0.05


def test_no_constraints_stack_to_no_rows():
    assert stack([], 3).a.shape == (0, 3)
