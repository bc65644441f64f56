"""The slopes of the predicted motions against finite differences, and what steps of a push add up to."""

from dataclasses import replace

import numpy as np
import pytest
from problems import contacts_of, four_feet

from pushfric_core import FrictionModel, predict
from pushfric_core.belief import linearisation
from pushfric_core.belief.fit import problem_of, softmax
from pushfric_core.belief.linearisation import errors, linearised, motion_sizes, predicted
from pushfric_core.belief.stretches import steps_of, stretches
from pushfric_core.geometry.planar import rotation

FEET = four_feet()
POINTS = FEET.outline.grid(4, 3)
U = np.random.default_rng(3).normal(0, 0.5, len(POINTS))
STICKS, SLIDES = 3.0, 0.05
"""Contact friction coefficients with which the tip sticks in all pushes, and slides in all."""


def pushes(turn, seen=True):
    """Pushes of two steps, the tip turned from the normal to either side by this angle; about no support the object turns."""
    for push, one in enumerate(FEET.observations[13:21]):
        tip = 0.02 * rotation(turn * (-1) ** push) @ -np.array(one.contact_normal)
        for number, share in enumerate((0.4, 0.6)):
            yield replace(one, push_id=push, stamp=number, duration=share, tip_velocity=tuple(tip.tolist()) if seen else None)


def at(data, u, mu_c):
    return errors(*data, predicted(*data, softmax(u), mu_c))


@pytest.mark.parametrize(
    ("mu_c", "turn", "seen"), [(STICKS, 0.4, True), (SLIDES, 0.9, True), (SLIDES, 0.0, False)], ids=["stick", "slide", "unseen"]
)
def test_the_slopes_are_those_of_finite_differences(monkeypatch, mu_c, turn, seen):
    monkeypatch.setattr(linearisation, "ROUNDED", 0.0)
    found = stretches(steps_of(list(pushes(turn, seen)), 0.2), 0.2)
    assert len(found.lengths) == 8  # each of two steps
    problem = problem_of(POINTS, found, 1.0).place, found
    about = linearised(*problem, softmax(U), predicted(*problem, softmax(U), mu_c))
    assert np.array_equal(about.errors, at(problem, U, mu_c))
    step = 1e-4
    for point, slopes in enumerate(np.moveaxis(about.slopes, 2, 0)):
        change = step * (np.arange(len(U)) == point)
        differences = (at(problem, U + change, mu_c) - at(problem, U - change, mu_c)) / (2 * step)
        assert slopes == pytest.approx(differences, rel=5e-3, abs=2e-3 * np.abs(about.slopes).max())
    assert np.linalg.eigvalsh(about.pivots).min() > -1e-12


def test_what_is_predicted_has_no_error():
    model = FrictionModel(POINTS, softmax(U)[None], np.array((0.3,)), np.ones(1))
    data = list(pushes(0.5))
    moved = predict(model, *contacts_of(data))
    seen = [replace(one, twist=one.twist._make(twist)) for one, twist in zip(data, moved.twists.tolist(), strict=True)]
    found = stretches(steps_of(seen, 0.2), 0.2)
    place = problem_of(POINTS, found, 1.0).place
    assert (
        np.abs(errors(place, found, predicted(place, found, softmax(U), 0.3))).max() < 1e-7 * motion_sizes(place, found).min()
    )
