import numpy as np
import pytest

from pushfric_core import FrictionModel, Support, predict
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
