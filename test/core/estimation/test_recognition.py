from dataclasses import replace

import numpy as np
import pytest
from problems import PROBLEMS, observations_of

from pushfric_core import Estimator, EstimatorConfig, Outline, Support, Twist
from pushfric_core.estimation.recognition import Hypothesis, Ranked, Recognizer

L_SHAPE = Outline(np.array(((0, 0), (0.1, 0), (0.1, 0.04), (0.04, 0.04), (0.04, 0.1), (0, 0.1))))
TRIANGLE = Outline(np.array(((0, 0), (0.15, 0), (0, 0.15))))
BAR = Outline.rectangle(0.12, 0.06)

SHAPES = {
    "L on unequal feet": (L_SHAPE, Support([(0.01, 0.01), (0.09, 0.02), (0.02, 0.09), (0.03, 0.03)], [0.4, 0.2, 0.25, 0.15])),
    "triangle on three feet": (TRIANGLE, Support([(0.03, 0.03), (0.09, 0.03), (0.03, 0.09)], np.full(3, 1 / 3))),
    "bar on unequal feet": (BAR, Support([(-0.05, -0.02), (0.05, -0.02), (0.05, 0.02), (-0.05, 0.02)], [0.1, 0.2, 0.3, 0.4])),
}
FEET_NOISE = np.array((1e-4, 1e-4, np.deg2rad(0.12)))  # of a pose: x, y, theta


def last_ranking(recognizer, observations):
    for observation in observations:
        ranking = recognizer.add(observation)
    return ranking


def centers(points, true):
    """The true centre of friction, after others that are 7 mm off."""
    offsets = {"left": (-0.007, 0.0), "above": (0.0, 0.007), "true": (0.0, 0.0), "right": (0.007, 0.0)}
    return [Hypothesis(name, points, true + offset) for name, offset in offsets.items()]


def seen(observation, rng):
    """The observation as a camera gives it: smoothed over five frames at 14 Hz, then differenced over two."""
    noise = rng.normal(size=3) * FEET_NOISE * 0.4 * 14 / 2
    return replace(observation, twist=Twist(*(np.array(observation.twist) + noise)))


@pytest.mark.parametrize("shape", SHAPES)
def test_the_true_center_of_friction_fits_best(shape):
    outline, truth = SHAPES[shape]
    hypotheses = centers(outline.grid(7, 7), truth.center_of_friction)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        data = [seen(observation, rng) for observation in observations_of(outline, truth, 0.3, 40, rng)]
        ranking = last_ranking(Recognizer(hypotheses), data)
        assert ranking.best == "true", seed
        assert ranking.hypotheses[0].ratio == 1
        assert all(ranked.feasible for ranked in ranking.hypotheses)


def test_fit_errors_are_those_of_an_estimator_for_each_hypothesis(rng):
    problem = PROBLEMS[0]()
    data = [seen(observation, rng) for observation in problem.observations]
    config = EstimatorConfig(half_width=0.001, cor_radius=0.002)
    grid, true = problem.outline.grid(5, 5), problem.truth.center_of_friction
    hypotheses = [*centers(grid, true), Hypothesis("feet", problem.truth.points)]
    ranking = last_ranking(Recognizer(hypotheses, config), data)
    expected = {}
    for hypothesis in hypotheses:
        estimator = Estimator(hypothesis.support_points, config, hypothesis.center_of_friction)
        for observation in data:
            expected[hypothesis.name] = estimator.add(observation).solution.objective
    assert {ranked.name: ranked.fit_error for ranked in ranking.hypotheses} == expected
    errors = [ranked.fit_error for ranked in ranking.hypotheses]
    assert errors == sorted(expected.values())
    assert [ranked.ratio for ranked in ranking.hypotheses] == pytest.approx(np.array(errors) / errors[0])
    assert ranking.data_points == len(data)


def test_an_infeasible_hypothesis_ranks_last_and_says_why():
    problem = PROBLEMS[0]()
    outside = Hypothesis("outside", problem.truth.points, np.array((0.2, 0.0)))
    ranking = Recognizer([outside, Hypothesis("feet", problem.truth.points)]).add(problem.observations[0])
    assert ranking.best == "feet"
    reason = "no w over the support points has the centre of friction that is asked for"
    assert ranking.hypotheses[1] == Ranked("outside", np.inf, np.inf, reason)
    assert not ranking.hypotheses[1].feasible
    alone = Recognizer([outside]).add(problem.observations[0])
    assert alone.best is None
    assert not alone.hypotheses[0].feasible


@pytest.mark.parametrize(
    ("hypotheses", "text"),
    [
        ([], "must hold at least one, got none"),
        ([Hypothesis("a", np.zeros((1, 2))), Hypothesis("a", np.ones((1, 2)))], "must differ in name, got a, a"),
        ([Hypothesis("a", np.zeros(2))], r"support_points must have shape \(n, 2\)"),
        ([Hypothesis("a", np.zeros((1, 2)), np.zeros(3))], "center_of_friction must be two finite numbers"),
    ],
)
def test_bad_hypotheses_are_refused(hypotheses, text):
    with pytest.raises(ValueError, match=text):
        Recognizer(hypotheses)
