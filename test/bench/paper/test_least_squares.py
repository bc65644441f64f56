import numpy as np
import pytest
from problems import PROBLEMS, moment

from bench.paper.experiments import least_squares_fit
from pushfric_core.errors import UninformativePush
from pushfric_core.geometry.planar import Twist
from pushfric_core.trajectories.observation import Observation

ENDS = np.array(((-0.03, 0.0), (0.03, 0.0)))


def translation(x):
    """A push at (x, -0.05) upwards, under which the object does not turn."""
    return Observation((x, -0.05), (0.0, -1.0), Twist(0.0, 0.02, 0.0))


@pytest.mark.parametrize("make", PROBLEMS)
def test_noiseless_data_give_back_the_truth(make):
    problem = make()
    fit = least_squares_fit(problem.observations, problem.truth.points)
    assert fit == pytest.approx(problem.truth.weights, abs=0.01)


def test_two_translations_meet_in_the_middle():
    """A translation puts p_CF on its line: two such lines 20 mm apart leave 10 mm to either."""
    assert least_squares_fit([translation(0.0), translation(0.02)], ENDS) == pytest.approx((1 / 3, 2 / 3))


def test_weights_may_be_negative_and_p_cf_outside_of_the_supports():
    assert least_squares_fit([translation(0.06)], ENDS) == pytest.approx((-0.5, 1.5))


def test_what_the_data_leave_open_stays_near_uniform():
    points = np.array(((-0.03, 0.0), (0.03, 0.0), (0.0, 0.04), (0.0, -0.04)))
    assert least_squares_fit([translation(0.0)], points) == pytest.approx(np.full(4, 0.25))


def test_no_other_sum_of_one_has_smaller_moments(rng):
    problem = PROBLEMS[0]()
    wrong = problem.truth.points + rng.normal(0, 0.005, (4, 2))
    fit = least_squares_fit(problem.observations, wrong)
    assert fit.sum() == pytest.approx(1)
    least = np.linalg.norm([moment(fit, wrong, one) for one in problem.observations])
    for _ in range(50):
        shift = rng.normal(0, 0.01, 4)
        other = fit + shift - shift.mean()
        assert np.linalg.norm([moment(other, wrong, one) for one in problem.observations]) > least


def test_it_is_the_limit_of_a_heavily_weighted_sum():
    """The paper's way: one more equation, sum w = 1, times a large number."""
    problem = PROBLEMS[0]()
    wrong = 1.1 * problem.truth.points
    fit = least_squares_fit(problem.observations, wrong)
    rows = np.array([[moment(one, wrong, observation) for one in np.eye(4)] for observation in problem.observations])
    heavy = np.linalg.lstsq(np.vstack((rows, np.full(4, 1e4))), np.append(np.zeros(len(rows)), 1e4))[0]
    assert fit == pytest.approx(heavy, abs=1e-6)


def test_a_contact_interval_counts_by_its_middle():
    wide = Observation((0.06, -0.05), (0.0, -1.0), Twist(0.0, 0.02, 0.0), half_width=0.01)
    assert least_squares_fit([wide], ENDS) == pytest.approx((-0.5, 1.5))


def test_a_motion_about_a_support_is_refused():
    with pytest.raises(UninformativePush, match="exactly about its support point"):
        least_squares_fit([Observation((0.0, -0.05), (0.0, -1.0), Twist(0.0, 0.03, 1.0))], ENDS)
