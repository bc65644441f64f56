"""Mistakes in simulated runs of a rectangle on four unequal feet, as the comparison of models names them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from bench.paper.pushes import NOISES, filmed, moved, objects
from bench.paper.spoilt import with_moved_load
from pushfric_core.estimation.estimator import Estimator
from pushfric_core.estimation.push_plan import even_pushes
from pushfric_core.geometry.planar import Twist, left_of, velocity_at
from pushfric_core.uncertainty.model_comparison import compare
from pushfric_core.uncertainty.reasons import ReasonCode

STUDIED = objects()["unequal_feet"]
PUSHES = even_pushes(STUDIED.outline, STUDIED.plans["all"])


@pytest.fixture(scope="module")
def run():
    """The observations of fourteen pushes, as a CSV without the tip's velocity would hold them."""
    rng = np.random.default_rng(7)
    data = filmed(STUDIED.outline, moved(STUDIED, PUSHES, rng), NOISES["FEET"], rng)
    return [replace(one, tip_velocity=None, duration=None) for one in data]


def with_twists(run, change):
    return [replace(one, twist=Twist(*map(float, change(one.twist, one)))) for one in run]


def seen_at(point):
    """The motion of another point of the object."""
    return lambda t, _: (*(np.array(t[:2]) + t.omega * left_of(np.array(point))), t.omega)


MISTAKES = {
    ReasonCode.OMEGA_NEGATED: lambda t, _: (t.vx, t.vy, -t.omega),
    ReasonCode.SPEEDS_IN_MILLIMETRES: lambda t, _: (1e3 * t.vx, 1e3 * t.vy, t.omega),
    ReasonCode.OMEGA_IN_DEGREES: lambda t, _: (t.vx, t.vy, math.degrees(t.omega)),
    ReasonCode.SPEEDS_SWAPPED: lambda t, _: (t.vy, t.vx, t.omega),
    ReasonCode.COLUMNS_MIXED: lambda t, _: (t.omega, t.vx, t.vy),
    ReasonCode.MIRRORED: lambda t, _: (t.vx, -t.vy, -t.omega),
    ReasonCode.CONTACTS_RECEDE: lambda t, _: (-t.vx, -t.vy, -t.omega),
    ReasonCode.TWIST_OF_CONTACT: lambda t, one: (*velocity_at(t, one.contact_point), t.omega),
    ReasonCode.ORIGIN_OFF: seen_at((0.0, 0.02)),
}


def test_no_mistake_is_named_in_a_good_run(run):
    found = compare(STUDIED.support_points, run)
    assert found.explanations == ()
    assert 0.004 <= found.misfit < 0.05


@pytest.mark.parametrize("code", MISTAKES)
def test_each_mistake_is_named_first(run, code):
    first = compare(STUDIED.support_points, with_twists(run, MISTAKES[code])).explanations[0]
    assert first.reason.code == code
    assert first.gain > 4
    assert first.reason.text


def test_a_frame_that_is_off_is_told_where_it_is(run):
    first = compare(STUDIED.support_points, with_twists(run, seen_at((0.0, 0.02)))).explanations[0]
    assert first.size == pytest.approx(0.02, abs=0.004)
    assert "of a point at" in first.reason.text


def test_a_load_that_moved_is_told_with_its_shift_within_the_support():
    rng = np.random.default_rng(5)
    other = STUDIED._replace(support=with_moved_load(STUDIED.support, 0.012, rng))
    shuffled = [PUSHES[k] for k in rng.permutation(len(PUSHES)).tolist()]
    pushed = [*moved(STUDIED, shuffled[:10], rng), *moved(other, shuffled[10:], rng)]
    data = filmed(STUDIED.outline, pushed, NOISES["FEET"], rng)
    first = compare(STUDIED.support_points, data).explanations[0]
    assert first.reason.code == ReasonCode.OBJECT_CHANGED
    assert first.since == 10
    expected = other.support.center_of_friction - STUDIED.support.center_of_friction
    assert first.shift == pytest.approx(expected, abs=0.003)


def test_the_verdict_names_the_likeliest_with_its_odds(run):
    """It is compared once no other observation follows at once, and then stays."""
    estimator = Estimator(STUDIED.support_points)
    wrong = with_twists(run, MISTAKES[ReasonCode.SPEEDS_SWAPPED])
    verdict = estimator.add(wrong).verdict
    assert not verdict.use
    first, *others = verdict.reasons
    assert first.code == ReasonCode.SPEEDS_SWAPPED
    assert "vx and vy are swapped: swap their columns (this is " in first.text
    assert len(others) <= 1
    assert estimator.add(wrong[0]).verdict.reasons[0].code == ReasonCode.SPEEDS_SWAPPED
    assert Estimator(STUDIED.support_points).add(run).verdict.use
