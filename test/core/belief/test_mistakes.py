"""Mistakes in simulated runs of a rectangle on four unequal feet, as the belief names them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from bench.paper.pushes import NOISES, filmed, moved, objects
from pushfric_core.belief.mistakes import explaining
from pushfric_core.belief.stretches import size_of, steps_of
from pushfric_core.estimation.estimator import Estimator
from pushfric_core.estimation.push_plan import even_pushes
from pushfric_core.geometry.planar import Twist, left_of, velocity_at
from pushfric_core.steps import finished

STUDIED = objects()["unequal_feet"]
PUSHES = even_pushes(STUDIED.outline, STUDIED.pushes)


@pytest.fixture(scope="module")
def seen():
    """The observations of fourteen pushes."""
    rng = np.random.default_rng(7)
    return filmed(STUDIED.outline, moved(STUDIED, PUSHES, rng), NOISES["FEET"], rng)


@pytest.fixture(scope="module")
def run(seen):
    """As a CSV without the tip's velocity would hold them."""
    return [replace(one, tip_velocity=None, duration=None) for one in seen]


def with_twists(run, change):
    return [replace(one, twist=Twist(*map(float, change(one.twist, one)))) for one in run]


MISTAKES = {
    "omega_negated": lambda t, _: (t.vx, t.vy, -t.omega),
    "speeds_in_millimetres": lambda t, _: (1e3 * t.vx, 1e3 * t.vy, t.omega),
    "omega_in_degrees": lambda t, _: (t.vx, t.vy, math.degrees(t.omega)),
    "speeds_swapped": lambda t, _: (t.vy, t.vx, t.omega),
    "columns_mixed": lambda t, _: (t.omega, t.vx, t.vy),
    "mirrored": lambda t, _: (t.vx, -t.vy, -t.omega),
    "contacts_recede": lambda t, _: (-t.vx, -t.vy, -t.omega),
    "twist_of_contact": lambda t, one: (*velocity_at(t, one.contact_point), t.omega),
    "origin_off": lambda t, _: (*(np.array(t[:2]) + t.omega * left_of(np.array((0.0, 0.02)))), t.omega),
}


def beside(one, offset):
    """The same, but the contact is said to lie elsewhere along the edge."""
    return replace(one, contact_point=tuple((np.array(one.contact_point) + offset * left_of(one.contact_normal)).tolist()))


def explained(data, points=STUDIED.support_points):
    size = size_of(points)
    return finished(explaining(points, steps_of(data, size), size))


def test_no_mistake_is_named_in_a_good_run(run):
    found = explained(run)
    assert found.mistakes == ()
    assert 0.004 <= found.misfit < 0.05


@pytest.mark.parametrize("code", MISTAKES)
def test_each_mistake_is_named_first(run, code):
    first = explained(with_twists(run, MISTAKES[code])).mistakes[0]
    assert first.reason.code == code
    assert first.odds > 4
    assert first.reason.text
    if code == "origin_off":  # and where
        assert first.size == pytest.approx(0.02, abs=0.004)
        assert "of a point at" in first.reason.text


@pytest.mark.parametrize(("offset", "side"), [(0.004, "left"), (-0.004, "right")])
def test_a_line_that_is_off_sideways_is_told_with_its_size(seen, offset, side):
    first = explained([beside(one, offset) for one in seen]).mistakes[0]
    assert first.reason.code == "line_off_sideways"
    assert first.size == pytest.approx(0.004, abs=0.001)
    assert f"mm further to the {side}" in first.reason.text


def test_supports_that_leave_out_what_bears_the_object_are_told(run):
    within = 0.3 * STUDIED.support_points
    assert explained(run, within).mistakes[0].reason.code == "support_too_small"


def test_a_contact_anywhere_between_two_fingers_is_no_mistake(run):
    rng = np.random.default_rng(0)
    between = [replace(beside(one, rng.uniform(-0.02, 0.02)), half_width=0.02) for one in run]
    assert explained(between).mistakes == ()


def test_the_verdict_names_the_likeliest_first(run):
    wrong = with_twists(run, MISTAKES["speeds_swapped"])
    estimator = Estimator(STUDIED.support_points)
    verdict = estimator.add(wrong).verdict
    assert not verdict.use
    first, *others = verdict.reasons
    assert first.code == "speeds_swapped"
    assert first.text == "vx and vy are swapped: swap their columns"
    assert len(others) <= 1
    assert estimator.add(wrong[0]).verdict.reasons[0].code == "speeds_swapped"
    assert Estimator(STUDIED.support_points).add(run).verdict.use
