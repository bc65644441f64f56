"""What is believed after simulated pushes: that it holds the truth, and that no input is too poor or too wild for it."""

import itertools
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from problems import contacts_of, four_feet, observations_of

from bench.paper.pushes import NOISES, eight_places, filmed, moved, objects
from pushfric_core import Estimator, Twist, believe, predict
from pushfric_core.belief.constants import MOST_STRETCHES
from pushfric_core.belief.judge import judging
from pushfric_core.belief.stretches import steps_of, stretches, thinned
from pushfric_core.estimation.push_plan import PlannedPush, even_pushes
from pushfric_core.geometry.planar import velocity_at
from pushfric_core.mechanics import simulation
from pushfric_core.mechanics.prediction import ELLIPSE, Kind
from pushfric_core.mechanics.quasi_static import ContactMode
from pushfric_core.steps import finished

FEET = four_feet()
POINTS, OBJECTS = FEET.truth.points, objects()


@pytest.fixture(autouse=True)
def coarser(monkeypatch):
    """The simulation finds the same with longer steps."""
    monkeypatch.setattr(simulation, "STEP", 1.2e-3)


def with_tip(data):
    """The observations with a tip that sticks, as the contact moves."""
    return [replace(one, tip_velocity=tuple(velocity_at(one.twist, np.array(one.contact_point)).tolist())) for one in data]


def noisy(data, share, seed=0):
    rng = np.random.default_rng(seed)
    return [replace(one, twist=Twist(*(np.array(one.twist) * (1 + share * rng.normal(size=3))).tolist())) for one in data]


@cache
def seen(name, noise, seed, angle=0.0):
    """An object, and what a camera sees of pushes at this angle to either side, or of pushes at eight places."""
    studied, rng = OBJECTS[name], np.random.default_rng(seed)
    pushes = even_pushes(studied.outline, studied.pushes) if seed % 2 else eight_places(studied.outline, rng)
    pushes = [PlannedPush(push.edge, push.offset, angle * (-1) ** k) for k, push in enumerate(pushes)]
    return studied, filmed(studied.outline, moved(studied, pushes, rng), NOISES[noise], rng)


@pytest.mark.parametrize("name", ["unequal_feet", "five_feet", "delrin_rect_right", "ring"])
def test_the_region_holds_the_true_center_and_is_no_farther_from_it_than_the_program(name):
    off, held = [], []
    for seed in range(3):
        studied, data = seen(name, "FLAT", seed)
        belief, truth = believe(studied.support_points, data), studied.support.center_of_friction
        error = belief.center_of_friction - truth
        held.append(error @ np.linalg.solve(belief.covariance, error) <= ELLIPSE)
        program = Estimator(studied.support_points).add(data).center_of_friction
        off.append((math.hypot(*error), math.dist(program, truth), belief.confidence))
    assert sum(held) >= 2
    of_belief, of_program, radius = np.mean(off, axis=0)
    assert of_belief < 1.1 * of_program
    assert radius < 0.1 * studied.outline.size.max()


def test_mu_c_lies_in_its_interval_where_pushes_slip_and_is_bounded_where_they_stick():
    for seed in range(2):
        studied, data = seen("unequal_feet", "FEET", seed, math.radians(40))
        mu_c = believe(studied.support_points, data).known_mu_c
        assert mu_c.low < studied.mu_c < mu_c.high < 1.5 * mu_c.low
        assert mu_c.kind is Kind.SLIP
    mu_c = believe(POINTS, with_tip(observations_of(FEET.outline, FEET.truth, 0.5, 20, np.random.default_rng(0)))).known_mu_c
    assert (mu_c.value, mu_c.high, mu_c.kind) == (None, math.inf, Kind.BOUND)
    assert 0.3 < mu_c.low < 0.5  # some of the tips are about to slide


@pytest.mark.parametrize("which", [("five_feet", "FLAT", 1), ("three_feet", "FEET", 1, 0.5)])
def test_the_samples_are_distributions_about_the_mode_and_scatter_as_the_covariance_says(which):
    studied, data = seen(*which)
    belief = believe(studied.support_points, data)
    w = belief.w
    assert w.shape == (32, len(studied.support_points))
    assert w.sum(axis=1) == pytest.approx(1)
    assert (w >= 0).all()
    assert w[:16] + w[16:] == pytest.approx(np.broadcast_to(2 * belief.support.weights, (16, w.shape[1])))
    centers = w @ belief.support_points - belief.center_of_friction
    assert centers.T @ centers / 32 == pytest.approx(belief.covariance, abs=0.02 * np.trace(belief.covariance))
    assert belief.share == pytest.approx(1 / 32)
    assert belief.data_points == len(data)


def test_the_order_of_the_observations_does_not_change_a_bit():
    studied, data = seen("delrin_rect_right", "FLAT", 1)
    data = data + [replace(one, half_width=0.004) for one in data]
    belief = believe(studied.support_points, data)
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(len(data))
        assert believe(studied.support_points, [data[k] for k in order]) == belief


@pytest.mark.parametrize("turn", [((0, -1), (1, 0)), ((1, 0), (0, -1))], ids=["turned", "mirrored"])
@pytest.mark.parametrize(("name", "half_width"), [("five_feet", 0.0), ("L", 0.03)])
def test_the_belief_turns_with_the_frame_of_the_object(name, half_width, turn):
    studied, data = seen(name, "FEET", 1, 0.5)
    data = [replace(one, half_width=half_width, pose=None) for one in data]
    turned = []
    for one in data:
        turns = (np.array(turn) @ one.twist[:2]).tolist()
        vectors = {f"contact_{what}": tuple(turn @ np.array(getattr(one, f"contact_{what}"))) for what in ("point", "normal")}
        vectors |= {"tip_velocity": tuple(turn @ np.array(one.tip_velocity))}
        turned.append(replace(one, **vectors, twist=Twist(*turns, one.twist.omega * np.linalg.det(turn))))
    belief, other = believe(studied.support_points, data), believe(studied.support_points @ np.transpose(turn), turned)
    assert other.center_of_friction == pytest.approx(turn @ belief.center_of_friction, abs=0.1 * belief.confidence)
    assert other.confidence == pytest.approx(belief.confidence, rel=0.1)


def test_tips_that_are_known_at_half_of_the_steps_tell_more_than_none():
    studied, data = seen("eccentric", "FEET", 1, 0.5)
    some = [replace(one, tip_velocity=one.tip_velocity if k % 2 else None) for k, one in enumerate(data)]
    known = [one for one in some if one.tip_velocity]
    at_all, at_half, of_half = (believe(studied.support_points, of).confidence for of in (data, some, known))
    assert at_half < min(2 * at_all, of_half)


def test_new_motions_are_off_by_less_than_the_misfit_as_often_as_it_says():
    held = []
    for seed in range(6):
        data = noisy(with_tip(observations_of(FEET.outline, FEET.truth, 0.5, 50, np.random.default_rng(seed))), 0.1, seed)
        belief = believe(POINTS, data[:25])
        assert 0.1 < belief.misfit < 0.4
        new = data[25:]
        found = predict(belief, *contacts_of(new))
        held += (belief.angles(found.twists, [one.twist for one in new]) <= belief.misfit).tolist()
    assert np.mean(held) > 0.85


def test_motions_with_a_tip_that_slides_are_foretold_with_a_misfit_of_their_own():
    held = {ContactMode.STICKING: [], ContactMode.SLIDING: []}
    for name, seed in itertools.product(("unequal_feet", "five_feet", "ring"), (1, 3)):
        studied, data = seen(name, "FEET", seed, 0.5)
        slips = [np.hypot(*np.subtract(one.tip_velocity, velocity_at(one.twist, one.contact_point))) for one in data]
        data = [noisy([one], 0.3 if slip > 2e-3 else 0.1, k)[0] for k, (one, slip) in enumerate(zip(data, slips, strict=True))]
        belief = believe(studied.support_points, [one for one in data if one.push_id % 2])
        new = [one for one in data if not one.push_id % 2]
        found = predict(belief, *contacts_of(new))
        angles = belief.angles(found.twists, [one.twist for one in new])
        for mode, angle, spread in zip(found.modes, angles, found.spread, strict=True):
            held[mode].append(angle <= spread)
    assert all(0.86 <= np.mean(ones) <= 0.98 for ones in held.values())


STICKING = with_tip(FEET.observations)
ONE = STICKING[0]
STRAIGHT = [replace(one, twist=Twist(*(-0.02 * np.array(one.contact_normal)).tolist(), 0.0)) for one in FEET.observations]
LEAVING = [replace(one, tip_velocity=tuple((0.02 * np.array(one.contact_normal)).tolist())) for one in FEET.observations]
WILD = [
    replace(one, twist=Twist(*twist))
    for one, twist in zip(STICKING, np.random.default_rng(0).normal(0, (0.02, 0.02, 0.5), (40, 3)).tolist(), strict=True)
]
POOR = {
    "one support": ([(0.01, 0.0)], STICKING),
    "two supports in one place": ([(0.01, 0.0)] * 2, STICKING),
    "supports on a line": ([(-0.04, 0.0), (0.04, 0.0)], STICKING),
    "a support at the contact": ([ONE.contact_point, (0.0, 0.0)], STICKING),
    "one observation": (POINTS, [ONE]),
    "one without a tip": (POINTS, FEET.observations[:1]),
    "three pushes": (POINTS, STICKING[:3]),
    "one push again and again": (POINTS, [replace(ONE, push_id=push) for push in range(8)]),
    "no turns": (POINTS, with_tip(STRAIGHT)),
    "contradictions": (POINTS, STICKING + [replace(o, twist=o.twist._replace(omega=-o.twist.omega)) for o in STICKING]),
    "wild motions": (POINTS, WILD),
    "motions of impossible size": (POINTS, STICKING + [replace(ONE, twist=Twist(1e90, 1e90, 1e90), push_id=99)]),
    "forces along the edge": (POINTS, [replace(o, force=tuple(np.array(o.contact_normal)[::-1].tolist())) for o in STICKING]),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", POOR)
def test_poor_input_is_believed_for_what_it_is(name):
    points, data = POOR[name]
    belief = believe(points, data)
    assert np.isfinite(belief.covariance).all()
    assert np.linalg.eigvalsh(belief.covariance).min() > 0
    assert belief.confidence < 2 * np.ptp(np.vstack((POINTS, points)), axis=0).max()
    assert 0.05 < belief.known_mu_c.low < 2


def test_nothing_is_believed_where_nothing_moves_into_the_object():
    assert believe(POINTS, []) is None
    assert believe(POINTS, LEAVING) is None
    assert finished(judging(POINTS, [replace(one, duration=0.0) for one in STICKING])).belief is None
    with pytest.raises(ValueError, match=r"support_points must have shape \(n, 2\) with n >= 1, got \(0,\)"):
        believe([], FEET.observations)
    assert believe(POINTS, [replace(one, twist=Twist(*(-np.array(one.twist)).tolist())) for one in FEET.observations]) is None


@pytest.mark.parametrize("seed", range(12))
def test_few_pushes_leave_the_center_within_the_object(seed):
    data = with_tip(observations_of(FEET.outline, FEET.truth, 0.5, 6, np.random.default_rng(seed)))
    for count in (4, 5, 6):
        belief = believe(POINTS, data[:count])
        assert belief.confidence < FEET.outline.size.max()
        assert belief.known_mu_c.low > 0.05


def test_of_many_pushes_some_are_used():
    data = noisy(with_tip(observations_of(FEET.outline, FEET.truth, 0.5, 300, np.random.default_rng(0))), 0.05)
    assert len(stretches(thinned(steps_of(data, 0.1), MOST_STRETCHES), 0.1).lengths) == MOST_STRETCHES
    belief = believe(POINTS, data)
    assert belief.center_of_friction == pytest.approx(FEET.truth.center_of_friction, abs=5e-4)
    assert belief.data_points == 300


def test_the_unit_of_time_does_not_matter():
    """Observations without durations say only how twist and tip compare."""
    belief = believe(POINTS, STICKING)
    for factor in (1e-6, 1e6):
        data = [
            replace(one, twist=Twist(*(factor * np.array(one.twist))), tip_velocity=tuple(factor * np.array(one.tip_velocity)))
            for one in STICKING
        ]
        assert believe(POINTS, data).w == pytest.approx(belief.w, abs=1e-3)
