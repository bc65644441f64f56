"""mu_c from pushes whose tip is seen to slide, and from measured forces."""

import math
from dataclasses import replace

import numpy as np
import pytest
from problems import four_feet

from pushfric_core.contact import tangent
from pushfric_core.contact_friction import Kind
from pushfric_core.estimator import Estimator
from pushfric_core.observation import Observation
from pushfric_core.outline import Touch
from pushfric_core.simulation import pushed_motion

MU = 0.4
FEET = four_feet()


def pushes(angle, with_force=False, with_tip=True):
    """Perpendicular pushes of each edge turned by `angle` to either side: beyond the cone, they slide."""
    data = []
    for edge, (start, along) in enumerate(zip(FEET.outline.vertices, FEET.outline.edges, strict=True)):
        for number, share in enumerate((0.3, 0.5, 0.7)):
            normal = FEET.outline.normals[edge]
            turn = angle * (1 if number % 2 else -1)
            tip = -math.cos(turn) * normal + math.sin(turn) * tangent(normal)
            contact = start + share * along
            motion = pushed_motion(FEET.truth, Touch(0.0, contact, normal, edge), tip, MU)
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
    estimator = Estimator(FEET.truth.points)
    for observation in data:
        estimate = estimator.add(observation)
    return estimate


def test_sliding_pushes_give_mu_c_itself():
    mu_c = last(pushes(math.radians(60))).mu_c
    assert mu_c.kind is Kind.SLIP
    assert mu_c.value == pytest.approx(MU, rel=0.02)
    assert mu_c.low <= MU <= mu_c.high


def test_forces_of_sliding_pushes_give_it_directly():
    mu_c = last(pushes(math.radians(60), with_force=True)).mu_c
    assert mu_c.kind is Kind.FORCE
    assert mu_c.value == pytest.approx(MU, rel=1e-2)


@pytest.mark.parametrize("data", [pushes(0.0), pushes(math.radians(60), with_tip=False)], ids=["sticking", "unseen"])
def test_without_a_slip_it_is_only_bounded(data):
    mu_c = last(data).mu_c
    assert (mu_c.value, mu_c.high, mu_c.kind) == (None, math.inf, Kind.BOUND)
    assert mu_c.low < 1.1 * MU


def test_the_direction_of_the_slip_is_told_from_the_tip():
    estimate = last(pushes(math.radians(60)))
    assert {-1.0, 1.0} <= set(estimate.tip.directions)
    unknown = last(pushes(math.radians(60), with_tip=False))
    assert np.isnan(unknown.tip.directions).all()
    # errors across the edge, where the tip cannot move, raise the tolerance
    wrong = [replace(o, tip_velocity=tuple((1.4 * np.array(o.tip_velocity)).tolist())) for o in pushes(math.radians(60))]
    assert last(wrong).tip.tolerance > estimate.tip.tolerance
