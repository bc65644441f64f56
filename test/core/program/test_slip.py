"""mu_c from pushes whose tip is seen to slide, and from measured forces."""

import math
from dataclasses import replace

import numpy as np
import pytest
from problems import four_feet

from pushfric_core import Estimator, Observation, Touch, Twist, pushed_motion
from pushfric_core.geometry.contact import tangent
from pushfric_core.geometry.support import FreeRadii, support_forces
from pushfric_core.mechanics.prediction import Kind
from pushfric_core.program.contact_friction import ContactForces, Slip, contact_forces, lower_bounds, percentile

MU = 0.4
FEET = four_feet()


def pushes(angle, with_force=False, with_tip=True, mu=MU):
    """Perpendicular pushes of each edge turned by `angle` to either side: beyond the cone, they slide."""
    data = []
    for edge, (start, along) in enumerate(zip(FEET.outline.vertices, FEET.outline.edges, strict=True)):
        for number, share in enumerate((0.3, 0.5, 0.7)):
            normal = FEET.outline.normals[edge]
            turn = angle * (1 if number % 2 else -1)
            tip = -math.cos(turn) * normal + math.sin(turn) * tangent(normal)
            contact = start + share * along
            motion = pushed_motion(FEET.truth, Touch(0.0, contact, normal, edge), tip, mu)
            data.append(
                Observation(
                    tuple(contact.tolist()),
                    tuple(normal.tolist()),
                    motion.twist,
                    push_id=len(data),
                    force=tuple((9 * motion.force).tolist()) if with_force else None,
                    tip_velocity=tuple(tip.tolist()) if with_tip else None,
                )
            )
    return data


def last(data):
    return Estimator(FEET.truth.points).add(data)


def test_sliding_pushes_give_mu_c_itself():
    mu_c = last(pushes(math.radians(60))).mu_c
    assert mu_c.kind is Kind.SLIP
    assert mu_c.value == pytest.approx(MU, rel=0.02)
    assert mu_c.low <= MU <= mu_c.high


def test_forces_of_sliding_pushes_give_it_directly():
    mu_c = last(pushes(math.radians(60), with_force=True)).mu_c
    assert mu_c.kind is Kind.FORCE
    assert mu_c.value == pytest.approx(MU, rel=1e-2)
    assert mu_c.low <= MU <= mu_c.high


@pytest.mark.parametrize(("mu", "turn", "with_tip"), [(2 * MU, 0, True), (MU, 60, False)], ids=["sticking", "unseen"])
def test_without_a_slip_it_is_only_bounded(mu, turn, with_tip):
    mu_c = last(pushes(math.radians(turn), with_tip=with_tip, mu=mu)).mu_c
    assert (mu_c.value, mu_c.high, mu_c.kind) == (None, math.inf, Kind.BOUND)
    assert mu_c.low < mu


def test_the_direction_of_the_slip_is_told_from_the_tip():
    estimate = last(pushes(math.radians(60)))
    assert {-1.0, 1.0} <= set(estimate.tip.directions)
    unknown = last(pushes(math.radians(60), with_tip=False))
    assert np.isnan(unknown.tip.directions).all()
    # errors across the edge, where the tip cannot move, raise the tolerance
    wrong = [replace(o, tip_velocity=tuple((1.4 * np.array(o.tip_velocity)).tolist())) for o in pushes(math.radians(60))]
    assert last(wrong).tip.tolerance > estimate.tip.tolerance


def test_a_push_slides_from_where_its_tip_begins_to():
    estimate = last(pushes(math.radians(60)))
    slip = np.array((0.0, 0.1, -0.1, 0.0, 0.4, 0.5, 0.45, 0.0, 0.3))
    mismatch = np.array((0.05, -0.05, 0.05, -0.05, 0.05, -0.05, 0.05, 0.05, 0.05))
    tip = replace(estimate.tip, slip=slip, mismatch=mismatch, sensed=np.full(9, np.nan), push=np.repeat((4.0, 5.0), (7, 2)))
    assert tip.directions.tolist() == [0, 0, 0, 0, 1, 1, 1, 0, 1]
    # the same, with the observations of the two pushes in another order
    order = np.array((7, 0, 1, 2, 8, 3, 4, 5, 6))
    mixed = replace(tip, slip=slip[order], mismatch=mismatch[order], push=tip.push[order])
    assert mixed.directions.tolist() == tip.directions[order].tolist()
    # more than errors usually are, and less than they can be
    unsure = replace(tip, slip=np.array((0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.3, 0.0)), mismatch=1.5 * mismatch)
    assert np.isnan(unsure.directions[7:]).all()
    assert [list(Slip)[index] for index in unsure.slips] == [Slip.STICKING] * 7 + [Slip.UNKNOWN] * 2
    assert [list(Slip)[index] for index in replace(tip, slip=-slip).slips[4:7]] == [Slip.RIGHT] * 3


MIDDLE = np.array(((0.0, 0.0),))


@pytest.mark.parametrize(
    ("direction", "bound"), [((0.0, 1.0), 0.0), ((1.0, 2.0), 0.5), ((-3.0, 1.0), 3.0), ((1.0, -1.0), math.inf)]
)
def test_the_bound_is_the_slope_of_the_force_against_the_normal(direction, bound):
    push = Observation((0.0, -0.05), (0.0, -1.0), Twist(*direction, 0.0))
    forces = contact_forces(push, support_forces(MIDDLE, push.twist))
    assert lower_bounds(forces, np.ones(1)) == pytest.approx([bound])


def test_a_force_along_the_edge_needs_no_finite_friction():
    """Whatever is left of its normal part by rounding."""
    forces = ContactForces(np.array([[1e-17], [-1e-17], [1e-9]]), np.ones((3, 1)), np.zeros((3, 1)))
    assert lower_bounds(forces, np.ones(1)) == pytest.approx([math.inf, math.inf, 1e9])


@pytest.mark.parametrize("radius", [0.0, 0.005])
def test_a_free_support_turns_the_force_to_the_normal_as_far_as_it_can(radius):
    """Against all forces it may apply, tried one by one."""
    points = np.array(((-0.03, 0.0), (0.03, 0.0), (0.0, 0.04)))
    turn = Observation((0.0, -0.05), (0.0, -1.0), Twist(0.001, -0.031, 1.0))  # about a point 1.4 mm from the second support
    forces = contact_forces(turn, support_forces(points, turn.twist, FreeRadii(radius, radius)))
    angles, sizes = np.meshgrid(np.linspace(0, 2 * np.pi, 3601), np.linspace(0, 1, 101))
    for w in ((0.4, 0.1, 0.5), (0.1, 0.2, 0.7), (0.2, 0.6, 0.2), (0.98, 0.01, 0.01)):
        fixed = w @ np.array([(forces.normal[0, j], forces.along[0, j]) for j in range(3)])
        reach = w[1] if radius else 0.0
        normal, along = fixed[0] + reach * sizes * np.cos(angles), fixed[1] + reach * sizes * np.sin(angles)
        tried = np.where(normal > 1e-9, np.abs(along) / np.maximum(normal, 1e-9), np.inf).min()
        assert lower_bounds(forces, np.array(w))[0] == pytest.approx(tried, rel=1e-3, abs=1e-3)


def test_percentiles_are_order_statistics():
    bounds = np.array((0.3, 0.1, math.inf, 0.2, 0.5, 0.4, 0.6, 0.7, 0.9, 0.8))
    assert percentile(bounds, 0.9) == 0.9
    assert percentile(bounds, 1.0) == math.inf
    assert percentile(bounds, 0.05) == 0.1
    assert percentile(bounds[:3], 0.9) == math.inf
