"""mu_c from measured forces alone, of which nobody saw whether the tip slid."""

import math

import numpy as np
import pytest
from problems import four_feet

from bench.paper.pushes import estimated
from pushfric_core import Estimator, EstimatorConfig, Observation, Touch, pushed_motion
from pushfric_core.files.object_file import load_object
from pushfric_core.files.observation_file import read_observations
from pushfric_core.geometry.contact import tangent
from pushfric_core.uncertainty.contact_friction import Kind, Tip, percentile, tip_at
from pushfric_core.uncertainty.force_ratios import sliding

FEET = four_feet()


def pushes(mu, angles, noise, rng):
    """Pushes at these angles to the normal, anywhere; their forces are off by a share, and the tip is not seen."""
    for number, angle in enumerate(angles):
        edge = number % 4
        start, along, normal = FEET.outline.vertices[edge], FEET.outline.edges[edge], FEET.outline.normals[edge]
        contact = start + rng.uniform(0.1, 0.9) * along
        tip = -math.cos(angle) * normal + math.sin(angle) * tangent(normal)
        motion = pushed_motion(FEET.truth, Touch(0.0, contact, normal, edge), tip, mu)
        force = motion.force + noise * np.hypot(*motion.force) * rng.normal(size=2)
        yield Observation(
            tuple(contact.tolist()), tuple(normal.tolist()), motion.twist, push_id=number, force=tuple(force.tolist())
        )


def ratios(data):
    """Shear over normal force, of each measured force."""
    normals, forces = (np.array([getattr(one, name) for one in data]) for name in ("contact_normal", "force"))
    return np.abs(np.sum(forces * normals[:, ::-1] * (-1, 1), axis=1) / np.sum(forces * normals, axis=1))


def estimate(data):
    estimator = Estimator(FEET.truth.points, EstimatorConfig(terms=("moment", "force")))
    for observation in data:
        estimator.add(observation)
    return estimator.estimate()


@pytest.mark.parametrize("mu", [0.15, 0.3, 0.5])
@pytest.mark.parametrize("seed", range(3))
def test_forces_of_pushes_at_any_angle_give_mu_c(mu, seed):
    rng = np.random.default_rng((seed, round(100 * mu)))
    found = estimate(pushes(mu, rng.uniform(-1.2, 1.2, 60), 0.02, rng)).mu_c
    assert found.kind is Kind.FORCE
    assert found.value == pytest.approx(mu, abs=0.02)
    assert found.low <= found.value <= found.high


@pytest.mark.parametrize("seed", range(4))
def test_forces_of_a_tip_that_sticks_are_bounds_and_never_more(seed):
    rng = np.random.default_rng(seed)
    data = list(pushes(2.0, rng.uniform(-0.3, 0.3, 60), 0.02, rng))
    found = estimate(data)
    assert (found.mu_c.value, found.mu_c.kind) == (None, Kind.BOUND)
    assert found.mu_c.low == found.mu_c_p90 == pytest.approx(percentile(ratios(data), 0.9))


@pytest.mark.parametrize("seed", range(10))
def test_chance_does_not_make_a_tip_slide(seed):
    rng = np.random.default_rng(seed)
    ratios = rng.uniform(-0.4, 0.4, 10 * 4 ** (seed % 4)) * (1 + 0.1 * rng.normal(size=10 * 4 ** (seed % 4)))
    assert sliding(ratios) is None
    assert sliding(np.zeros(5)) is None
    assert sliding(np.full(30, 0.2)) is None  # one push, repeated


def test_real_forces_give_what_the_slips_of_other_pushes_give(mit_pushes):
    apart = []
    for path in sorted(mit_pushes.glob("*_*.tip.csv")):
        model = load_object(str(mit_pushes / f"{path.name.removesuffix('.tip.csv').rpartition('_')[2]}.yaml"))
        forces = read_observations(mit_pushes / path.name.replace(".tip", ""), model.outline)
        _, by_slip = estimated(read_observations(path, model.outline), model.support_points, EstimatorConfig())
        found = Tip(*np.array([tip_at(one) for one in forces]).T).by_ratio
        if found is not None:
            assert found[1] <= found[0] <= percentile(ratios(forces), 0.9)
            apart.append(abs(found[0] - by_slip.mu_c.value))
    assert len(apart) >= 9
    assert np.median(apart) <= 0.03
