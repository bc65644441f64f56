import numpy as np
import pytest
from problems import PROBLEMS

from pushfric_core.errors import UninformativePush
from pushfric_core.estimator import Estimator, EstimatorConfig
from pushfric_core.linear_program import Status
from pushfric_core.observation import Observation
from pushfric_core.planar import Twist


def last_estimate(estimator, observations):
    for observation in observations:
        estimate = estimator.add(observation)
    return estimate


@pytest.mark.parametrize("make", PROBLEMS)
def test_noiseless_data_give_back_the_truth(make):
    problem = make()
    estimate = last_estimate(Estimator(problem.truth.points), problem.observations)
    assert estimate.status is Status.OPTIMAL
    assert np.allclose(estimate.center_of_friction, problem.truth.center_of_friction, atol=1e-4)
    assert np.allclose(estimate.w, problem.truth.weights, atol=0.02)


def test_every_estimate_is_certified_and_stays_as_it_is():
    problem = PROBLEMS[0]()
    estimator = Estimator(problem.outline.grid(5, 5))
    estimates = [estimator.add(observation) for observation in problem.observations[:10]]
    assert [len(estimate.observations) for estimate in estimates] == list(range(1, 11))
    for estimate in estimates:
        assert estimate.status is Status.OPTIMAL
        assert estimate.w.sum() == pytest.approx(1)
        assert (estimate.w >= 0).all()


def test_contact_friction_reaches_the_true_coefficient():
    problem = PROBLEMS[0]()  # made with mu_c = 0.5, slipping pushes among them
    estimate = last_estimate(Estimator(problem.truth.points), problem.observations)
    assert estimate.mu_c_max == pytest.approx(0.5, abs=0.01)
    assert estimate.mu_c_p90 <= estimate.mu_c_max


def test_pushes_are_counted():
    problem = PROBLEMS[1]()
    assert last_estimate(Estimator(problem.truth.points), problem.observations[:7]).pushes == 7


def test_data_that_contradict_the_nonnegative_force_are_infeasible():
    estimator = Estimator(np.array(((-0.03, 0.0), (0.03, 0.0))))
    pulled = Observation((0.0, -0.05), (0.0, -1.0), Twist(0.0, -0.02, 0.0))
    pushed = Observation((0.0, -0.05), (0.0, -1.0), Twist(0.0, 0.02, 0.0), push_id=1)
    assert estimator.add(pushed).conflicts == ()
    estimate = estimator.add(pulled)
    assert estimate.status is Status.INFEASIBLE
    assert estimate.conflicts == (pulled,)
    assert estimate.contradiction == "no w lets the pusher push (f.n >= 0) in all of the pushes 0"
    assert estimator.add(pushed).status is Status.INFEASIBLE


def test_without_the_nonnegative_force_they_are_not():
    config = EstimatorConfig(nonnegative_force=False)
    estimator = Estimator(np.array(((-0.03, 0.0), (0.03, 0.0))), config)
    assert estimator.add(Observation((0.0, -0.05), (0.0, -1.0), Twist(0.0, -0.02, 0.0))).status is Status.OPTIMAL


def test_a_motion_about_a_support_is_refused_and_leaves_no_trace():
    problem = PROBLEMS[1]()
    estimator = Estimator(problem.truth.points)
    before = last_estimate(estimator, problem.observations[:5])
    x, y = problem.truth.points[1]
    with pytest.raises(UninformativePush):
        estimator.add(Observation((0.05, 0.0), (0.0, -1.0), Twist(y, -x, 1.0)))
    assert estimator.estimate().observations == before.observations


def test_a_half_width_loosens_the_fit():
    problem = PROBLEMS[0]()
    wrong = problem.truth.points + (0.01, 0.0)
    errors = [
        last_estimate(Estimator(wrong, EstimatorConfig(half_width=h)), problem.observations).solution.objective
        for h in (0.0, 0.002, 0.005)
    ]
    assert errors[0] > errors[1] > errors[2]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"terms": ("moments",)}, "moment, frictionless, cone, got moments"),
        ({"terms": ()}, "got none"),
        ({"mu_bound": -1.0}, r"mu_bound must lie in \[0.0, 100.0\], got -1.0"),
        ({"half_width": float("nan")}, "half_width must lie"),
    ],
)
def test_bad_configurations_are_refused(change, text):
    with pytest.raises(ValueError, match=text):
        EstimatorConfig(**change)
