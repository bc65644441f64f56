"""What the verdict says about unusable input, with pushes of the object on four feet; good input is used."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from problems import four_feet, pushed_as_planned, three_feet

from pushfric_core.belief.doubts import Change
from pushfric_core.belief.judge import Judgement
from pushfric_core.estimation.estimator import Estimator, EstimatorConfig
from pushfric_core.estimation.push_plan import PlannedPush
from pushfric_core.estimation.verdict import verdict_on
from pushfric_core.geometry.planar import Twist, rotation, velocity_at

FEET = four_feet()


def judged(change, points=FEET.truth.points, pushes=None):
    estimator = Estimator(points)
    for number, observation in enumerate(FEET.observations[:pushes]):
        motion = velocity_at(observation.twist, FEET.truth.center_of_friction)
        force = tuple((5 * motion / np.hypot(*motion)).tolist())
        estimate = estimator.add(change(number, replace(observation, push_id=number, force=force)))
    return estimate.verdict


def turned(angle):
    return lambda _, o: replace(o, force=tuple((rotation(angle) @ o.force).tolist()))


def test_good_input_may_be_used():
    verdict = judged(lambda _, o: o)
    assert verdict.use
    assert verdict.reasons == ()


@pytest.mark.parametrize(
    ("change", "code", "text"),
    [
        (turned(math.pi), "forces_opposed", "the measured forces oppose the motion"),
        (turned(math.pi / 2), "forces_turned", "the measured forces are turned by"),
        (turned(-math.pi / 2), "forces_turned", "the measured forces are turned by -"),
        (
            lambda number, o: turned(1.1 * number)(number, o),
            "forces_scattered",
            "the measured forces do not turn with the object",
        ),
        (
            lambda _, o: replace(o, twist=Twist(o.twist.vx, o.twist.vy, math.degrees(o.twist.omega)), force=None),
            "omega_in_degrees",
            "radians",
        ),
    ],
)
def test_each_mistake_has_a_code_and_a_sentence(change, code, text):
    verdict = judged(change)
    assert not verdict.use
    (found,) = [one for one in verdict.reasons if one.code == code]
    assert text in str(found)


def inward(which):
    return lambda number, o: replace(o, contact_normal=(-o.contact_normal[0], -o.contact_normal[1])) if which(number) else o


@pytest.mark.parametrize("which", [lambda _: True, lambda number: number % 3 == 0])
def test_inward_normals_are_told_alone(which):
    """They make the program infeasible; to leave a push out would be the wrong remedy."""
    (reason,) = judged(inward(which)).reasons
    assert reason.code == "normals_inward"
    assert "the normals point inward in" in str(reason)


def test_forces_are_not_blamed_for_a_wrong_motion():
    (reason,) = judged(lambda _, o: replace(o, twist=Twist(*o.twist[:2], math.degrees(o.twist.omega)))).reasons
    assert reason.code == "omega_in_degrees"
    assert "radians" in str(reason)
    (reason,) = judged(lambda _, o: replace(o, twist=Twist(*(-np.array(o.twist)).tolist()))).reasons
    assert reason.code == "contacts_recede"


def test_what_a_change_of_the_object_brings_about_is_not_told_next_to_it():
    estimator = Estimator(FEET.truth.points)
    for number, one in enumerate(FEET.observations):
        estimate = estimator.add(inward(lambda number: number == 5)(number, replace(one, push_id=number)))
    belief, doubts = estimate.judgement
    (contradiction,) = verdict_on(estimate, Judgement(belief, doubts._replace(mistakes=()))).reasons
    change = Change(7, (0.008, 0.0))
    (told,) = verdict_on(estimate, Judgement(belief, doubts._replace(mistakes=(), change=change))).reasons
    assert contradiction.code == "contradiction"
    assert told.code == "object_changed"
    assert "the object is another one since push_id 7" in told.text


def test_a_radius_that_is_too_large_to_be_useful_is_told():
    data = [replace(one, push_id=number) for number, one in enumerate(FEET.observations)]
    estimate = Estimator(FEET.truth.points, EstimatorConfig(useful_radius=1e-4)).add(data)
    (reason,) = estimate.verdict.reasons
    assert reason.code == "uncertain"
    assert f"only known to within {1e3 * estimate.confidence:.1f} mm" in reason.text
    assert Estimator(FEET.truth.points).add(data).verdict.use
    still = [replace(one, tip_velocity=(0.0, 0.0)) for one in data[:5]]
    (reason,) = Estimator(FEET.truth.points).add(still).verdict.reasons  # no tip moves into the object
    assert (reason.code, reason.text.partition(",")[0]) == ("uncertain", "p_CF is not known")


@pytest.mark.parametrize("pushes", [1, 2, 3])
def test_too_few_pushes_tell_nothing_to_act_on(pushes):
    (reason,) = judged(lambda _, o: o, pushes=pushes).reasons
    assert reason.code == "few_pushes"
    assert reason.text.startswith(f"p_CF rests on {pushes} push")
    assert judged(lambda _, o: o, pushes=5).use


def test_supports_whose_hull_misses_the_center_of_friction_are_told():
    x, y = FEET.truth.center_of_friction
    width = np.ptp(FEET.truth.points, axis=0).max()
    aside = np.array(((x + 0.2 * width, y - width), (x + 0.2 * width, y + width), (x + width, y), (x + 0.6 * width, y)))
    verdict = judged(lambda _, o: replace(o, force=None), aside)
    assert {"support_too_small", "poor_fit", "contacts_displaced"} & {one.code for one in verdict.reasons}


TRIANGLE = three_feet()


def aimed(center=None):
    """The estimator, and the verdict on pushes that pass p_CF of the triangle at 4 to 12 mm, with a given p_CF or none."""
    outline, truth = TRIANGLE.outline, TRIANGLE.truth
    estimator = Estimator(outline.grid(6, 6, 0.01), center_of_friction=center)
    push_id = 0
    for edge in range(3):
        along = outline.edges[edge] / outline.lengths[edge]
        middle = (truth.center_of_friction - outline.vertices[edge]) @ along - outline.lengths[edge] / 2
        for offset in (-0.012, -0.008, -0.004, 0.004, 0.008, 0.012):
            observation, _ = pushed_as_planned(truth, outline, PlannedPush(edge, float(middle) + offset), 0.3)
            estimate = estimator.add(replace(observation, push_id=push_id))
            push_id += 1
    return estimate, estimate.verdict


def test_half_planes_that_contradict_the_program_are_told():
    """A p_CF 18 mm off is forced on the program: pushes that pass between it and the true one turn the object the other way."""
    _, verdict = aimed(center=TRIANGLE.truth.center_of_friction + (0.0182, 0.0))
    (reason,) = verdict.reasons
    assert re.search(r"contradict the program: in 22 % of the observations, of 4 pushes", reason.text), reason
    assert reason.code == "half_planes"
    assert "the centre of friction that was given must be wrong" in reason.text
    assert not verdict.use
    assert aimed(center=TRIANGLE.truth.center_of_friction)[1].use
    assert aimed()[1].use
