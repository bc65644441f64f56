"""The peers that predictions are compared with are what their names say, and real pushes give the figures."""

import numpy as np
import pytest
from problems import observations_of, square

from bench import prediction
from pushfric_core.geometry.planar import left_of
from pushfric_core.geometry.support import Support
from pushfric_core.mechanics.limit_surface import LimitSurface
from pushfric_core.mechanics.prediction import FrictionModel, predict
from pushfric_core.mechanics.surface_models import named_ellipsoid

RING = np.array([(0.04 * np.cos(t), 0.04 * np.sin(t)) for t in np.arange(0, 2 * np.pi, 0.1)])


def pushes_of(support, mu_c, count, rng):
    observations = observations_of(square(), support, mu_c, count, rng)
    points, normals, twists = (
        np.array([getattr(o, name) for o in observations]) for name in ("contact_point", "contact_normal", "twist")
    )
    velocities = twists[:, :2] + twists[:, 2:] * left_of(points)
    return prediction.Pushes(observations, points, normals, velocities, twists)


def test_the_closed_form_balances_forces(rng):
    pushes = pushes_of(Support(RING, np.full(len(RING), 1 / len(RING))), 0.3, 30, rng)
    form = named_ellipsoid(Support(RING, np.full(len(RING), 1 / len(RING)))).form()
    twists = prediction.ellipsoid_motions(form, 0.3, pushes)
    for twist, point, normal in zip(twists, pushes.points, pushes.normals, strict=True):
        fx, fy, m = np.linalg.solve(form.form, twist)
        assert m == pytest.approx(point[0] * fy - point[1] * fx, abs=1e-9)  # the force passes through the contact
        pressure, shear = -np.dot((fx, fy), normal), np.dot((fx, fy), left_of(normal))
        assert abs(shear) <= 0.3 * pressure + 1e-9


def test_a_fitted_ellipsoid_predicts_better_than_one_in_the_wrong_place(rng):
    shifted = Support(RING / 4 + (0.02, -0.01), np.full(len(RING), 1 / len(RING)))
    pushes = pushes_of(shifted, 5.0, 20, rng)
    fitted = prediction.fitted_ellipsoid(5.0, pushes)
    own = prediction.angles(prediction.ellipsoid_motions(fitted, 5.0, pushes), pushes.twists)
    wrong = prediction.ellipsoid_motions(named_ellipsoid(prediction.UNIFORM).form(), 5.0, pushes)
    exact = predict(FrictionModel.of(shifted, 5.0), pushes.points, pushes.normals, pushes.velocities)
    assert np.median(own) < 0.3 * np.median(prediction.angles(wrong, pushes.twists))
    assert np.median(prediction.angles(exact.twists, pushes.twists)) < np.median(own)
    assert LimitSurface(shifted).ellipsoid().form == pytest.approx(named_ellipsoid(shifted).form().form)


def test_balanced_accuracy_counts_both_kinds_alike():
    truth = np.array((True, False, False, False))
    assert prediction.balanced_accuracy(truth, truth) == 1
    assert prediction.balanced_accuracy(np.zeros(4, bool), truth) == 0.5
    assert prediction.balanced_accuracy(np.array((True, True, False, False)), truth) == pytest.approx((1 + 2 / 3) / 2)


def test_real_pushes_are_predicted_better_than_by_the_peers(real_pushes, monkeypatch):
    for name in ("HALVINGS", "SUBSETS"):
        monkeypatch.setattr(prediction, name, 1)
    told = []
    figures = prediction.measure(real_pushes / "push_points.csv", told.append)
    assert len(told) == prediction.STEPS
    half = [row["median_deg"] for row in figures["twists"] if (row["support"], row["fitted"]) == ("grid_55", "half")]
    assert len(half) == 6
    medians = {contender: np.median([row[contender] for row in half]) for contender in prediction.CONTENDERS}
    assert medians["pushfric"] < 8
    assert min(medians[peer] for peer in prediction.CONTENDERS[1:]) > 8
    assert {row["object"] for row in figures["stability"]} == {"patch", "30_90_30_30_30_90"}
    assert min(row["balanced_accuracy"]["pushfric"] for row in figures["stability"]) > 0.75
    motions, stable = prediction.tables(figures)
    assert motions.row_count == (len(prediction.CONTENDERS) + 1) * 6
    assert stable.row_count == len(figures["stability"])
