"""Which pushes show how far p_CF may be off."""

from dataclasses import replace

import numpy as np
import pytest
from problems import four_feet

from pushfric_core import Estimator
from pushfric_core.estimation.excitation import FEWEST_PUSHES

FEET = four_feet()


def test_few_pushes_say_nothing_of_it():
    estimator = Estimator(FEET.truth.points)
    assert estimator.add(FEET.observations[:16]).confidence > 0
    for push in range(FEWEST_PUSHES - 1, 16):
        estimate = estimator.exclude(push)
    assert (estimate.pushes, estimate.confidence, estimate.belief.covariance) == (FEWEST_PUSHES - 1, None, None)
    assert estimate.mu_c == estimate.belief.known_mu_c is not None
    assert estimate.lack.code == "few_pushes"
    assert estimate.lack.text.startswith("p_CF rests on 3 pushes, and fewer than 4 cannot tell how far it is off")


@pytest.mark.parametrize(
    ("places", "code", "text"),
    [
        ([(0.01, 0)] * 5, "few_places", "all pushes are at one place"),
        ([(0.01, 0), (0.03, 0), (0.012, 0), (0.03, 0)], "few_places", "all pushes are at 2 places"),
        ([(-0.03, 0), (-0.01, 0), (0.01, 0), (0.03, 0)], "one_side", "all pushes are against one side"),
        ([(-0.03, 0), (-0.01, 0), (0.01, 1), (0.03, 2)], None, ""),
    ],
)
def test_pushes_that_are_alike_say_nothing_of_it(places, code, text):
    data = []
    for push, (along, edge) in enumerate(places):
        normal = FEET.outline.normals[edge]
        contact = 0.05 * normal + along * normal[::-1]
        data.append(replace(FEET.observations[0], contact_point=contact, contact_normal=normal, push_id=push))
    lack = Estimator(FEET.truth.points).add(data).lack
    assert (lack and lack.code) == code
    assert str((lack and lack.text) or "").startswith(text)


def test_a_center_that_is_given_is_not_asked_for():
    estimate = Estimator(FEET.truth.points, center_of_friction=FEET.truth.center_of_friction).add(FEET.observations[:6])
    assert (estimate.belief, estimate.confidence, estimate.mu_c) == (None, None, None)
    assert np.array_equal(estimate.believed_center, estimate.center_of_friction)
