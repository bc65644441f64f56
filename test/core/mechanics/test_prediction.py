import math
from dataclasses import replace

import numpy as np
import pytest

from pushfric_core import FrictionModel, Support, predict
from pushfric_core.mechanics.prediction import ELLIPSOID, of_misfit
from pushfric_core.mechanics.quasi_static import ContactMode

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
    known = replace(FrictionModel.of(ROD, 0.3), misfit=0.1, sliding_misfit=0.2)
    prediction = predict(known, ((0, 0), (0, 0)), ((0, -1), (0, -1)), ((0, 0.02), (0, -0.02)))
    assert prediction.spread == pytest.approx((math.atan(0.1), 0.0))  # nothing is unsure of a tip that leaves
    variance = (0.1 * 0.02) ** 2 / ELLIPSOID
    assert prediction.covariance[0] == pytest.approx(variance * np.diag((1, 1, 1 / known.length**2)))
    assert not prediction.covariance[1].any()
    across = predict(known, *BELOW, ((0.04, 0.02),))
    assert across.modes == (ContactMode.SLIDING,)
    size = np.linalg.norm(known.centered(across.twists[0]))
    assert across.spread == pytest.approx(math.atan(0.2 * math.hypot(0.04, 0.02) / size))


def test_errors_are_about_the_centre_of_friction_in_any_frame():
    eccentric = FrictionModel.of(Support(ROD.points, np.array((0.9, 0.1))), 0.3)
    x, y = eccentric.center_of_friction
    rng = np.random.default_rng(0)
    angle, errors = 0.7, rng.normal(size=(100_000, 3)) * 0.01 / math.sqrt(ELLIPSOID)
    turns = errors[:, 2] / eccentric.length
    c, s = math.cos(angle), math.sin(angle)
    arm = np.array((c * x - s * y, s * x + c * y))
    of_origin = np.column_stack((errors[:, :2] - turns[:, None] * (-arm[1], arm[0]), turns))
    (found,) = of_misfit(eccentric, np.array((0.01,)), np.array((angle,)))
    assert found == pytest.approx(np.cov(of_origin.T), rel=0.02, abs=1e-8)


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"w": (0.5, 0.5)}, r"w must have shape \(s, 2\)"),
        ({"w": ((0.5, 0.4),)}, "the sum of each sample 1"),
        ({"share": (0.5,)}, "share must have shape"),
        ({"misfit": -0.1}, "misfit must be finite"),
        ({"sliding_misfit": math.inf}, "sliding_misfit must be finite"),
    ],
)
def test_models_that_make_no_sense_are_refused(wrong, text):
    with pytest.raises(ValueError, match=text):
        FrictionModel(**{"support_points": ROD.points, "w": ((0.5, 0.5),), "mu_c": (0.3,), "share": (1.0,)} | wrong)
