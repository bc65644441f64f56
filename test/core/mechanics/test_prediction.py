from dataclasses import replace

import numpy as np
import pytest
from problems import four_feet, observations_of, square, three_feet

from pushfric_core import Estimator, FrictionModel, Observation, Support, Twist, friction_model, predict
from pushfric_core.geometry.planar import left_of
from pushfric_core.mechanics.prediction import misfit
from pushfric_core.mechanics.simulation import ContactMode

ROD = Support(np.array(((-0.5, 0.0), (0.5, 0.0))), np.array((0.5, 0.5)))
BELOW = (((0.0, 0.0),), ((0.0, -1.0),))
"""The contact: the middle of the rod's lower side."""


def test_a_push_through_the_center_translates_without_a_doubt():
    prediction = predict(FrictionModel.of(ROD, 0.3), *BELOW, ((0.0, 0.02),))
    assert prediction.twists[0] == pytest.approx((0, 0.02, 0), abs=1e-9)
    assert prediction.modes == (ContactMode.STICKING,)
    assert prediction.forces[0] == pytest.approx((0, 1))
    assert prediction.spread == pytest.approx(0)


def test_what_the_model_cannot_explain_widens_the_spread():
    known = FrictionModel.of(ROD, 0.3, misfit=0.1)
    prediction = predict(known, ((0, 0), (0, 0)), ((0, -1), (0, -1)), ((0, 0.02), (0, -0.02)))
    assert prediction.spread == pytest.approx((0.1, 0.0))  # nothing is unsure of a tip that leaves


def test_the_misfit_of_exact_data_is_nothing():
    problem = three_feet()
    model = FrictionModel.of(problem.truth, 0.4)
    assert misfit(model, problem.observations, 2) == pytest.approx(0, abs=0.01)
    assert misfit(model, (), 2) == 0


def test_the_misfit_bounds_new_motions_as_often_as_it_says():
    truth, outline, held = four_feet().truth, square(), []
    for seed in range(8):
        rng = np.random.default_rng(seed)

        def blurred(observation, rng=rng):
            noise = 0.1 * np.linalg.norm(observation.twist[:2]) * rng.normal(size=3) * (1, 1, 20)
            return Observation(observation.contact_point, observation.contact_normal, Twist(*(observation.twist + noise)))

        data = [blurred(observation) for observation in observations_of(outline, truth, 0.5, 50, rng)]
        estimator = Estimator(truth.points)
        estimate = estimator.add(data[:20])
        model = FrictionModel.of(Support(estimate.support_points, estimate.w), 0.5)
        bound = misfit(model, data[:20], 3)
        held += [misfit(model, [observation], 0) <= bound for observation in data[20:]]
    assert 0.85 <= np.mean(held) <= 0.97


def test_samples_count_by_the_motions_that_they_predict(rng):
    problem = four_feet()
    for tips in (False, True):
        data = observations_of(problem.outline, problem.truth, 0.4, 24, rng)
        estimator = Estimator(problem.truth.points)
        for number, one in enumerate(data):
            noise = Twist(*(np.array(one.twist) * (1 + 0.1 * rng.normal(size=3))))
            moved = np.array(one.twist[:2]) + one.twist.omega * left_of(np.array(one.contact_point))
            seen = replace(one, twist=noise, push_id=number, tip_velocity=tuple(moved.tolist()) if tips else None)
            estimate = estimator.add(seen)
        model = friction_model(estimate)
        assert estimate.spread is not None
        given = np.vstack((estimate.w, estimate.spread.middle, estimate.spread.extremes, np.full(4, 0.25)))
        for w in model.w:
            assert np.isclose(given, w, atol=1e-9).all(axis=1).any()
        assert model.share.sum() == pytest.approx(1)
        assert np.ptp(model.share) > 0.01
        # equal weights explain feet of very different loads badly
        assert not np.isclose(model.w, 0.25).all(axis=1).any()


def test_a_contact_seen_to_leave_the_pusher_counts_as_unexplained():
    leaving = Observation((0.0, 0.0), (0.0, -1.0), Twist(0.0, -0.02, 0.0))
    assert misfit(FrictionModel.of(ROD, 0.3), [leaving], 1) == pytest.approx(np.pi / 2)


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"w": (0.5, 0.5)}, r"w must have shape \(s, 2\)"),
        ({"w": ((0.5, 0.4),)}, "the sum of each sample 1"),
        ({"share": (0.5,)}, "share must have shape"),
        ({"misfit": -0.1}, "misfit must lie in"),
    ],
)
def test_models_that_make_no_sense_are_refused(wrong, text):
    with pytest.raises(ValueError, match=text):
        FrictionModel(**{"support_points": ROD.points, "w": ((0.5, 0.5),), "mu_c": (0.3,), "share": (1.0,)} | wrong)
