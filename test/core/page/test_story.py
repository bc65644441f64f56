"""The story of a run: what had been predicted, what happened when, and no more pictures than fit."""

import pytest

from pushfric_core import TABLE_1, Estimator, FrictionModel, Observation, Twist, predict
from pushfric_core.bags.constants import constants
from pushfric_core.bags.message_types import record
from pushfric_core.estimation.estimate_report import EstimateReport
from pushfric_core.files.object_file import load_object
from pushfric_core.page.story import MOST_PICTURES, Story

OBJECT = "wood_rect4"
PHASES = constants("PlanProgress")


def observations(pushes: int) -> list[Observation]:
    """Pushes of the simulated object at several places, at 2 cm/s."""
    known = TABLE_1[OBJECT]
    model = FrictionModel.of(known.support, known.mu_c)
    places = [((-0.03 + 0.012 * push, -0.032), (0.0, -1.0)) for push in range(pushes)]
    found = []
    for push, (point, normal) in enumerate(places):
        (vx, vy, omega) = predict(model, [point], [normal], [(0.0, 0.02)]).twists[0].tolist()
        found.append(Observation(point, normal, Twist(vx, vy, omega), push, stamp=10**9 * (push + 1), tip_velocity=(0.0, 0.02)))
    return found


@pytest.fixture
def story():
    return Story(load_object(OBJECT), "/cell")


def plan(phase: str, push: int = 0, **fields):
    """A message of the plan, at a second for each push."""
    msg = record("pushfric_msgs/msg/PlanProgress", phase=PHASES[f"PHASE_{phase}"], push_id=push, count=5, **fields)
    msg.header.stamp.sec = push + 1
    msg.placement.orientation.w = 1.0
    return msg


def test_a_moment_has_what_the_pushes_before_predicted(story):
    known, told = TABLE_1[OBJECT], {}
    estimator = Estimator(known.support.points)
    for observation in observations(5):
        told |= story.on_observation(observation)
        estimate = estimator.add(observation)
        told |= story.on_estimate(EstimateReport.of(estimate, OBJECT, estimate.belief))
    moments = [told[f"moment/{seen}"] for seen in range(5)]
    assert [moment["t"] for moment in moments] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert moments[0]["predicted"] is None
    offs = [moment["off"] for moment in moments[1:]]
    assert offs[0] > 5.0  # [degree]: one push leaves much open
    assert offs[-1] < 0.1 * offs[0]  # four leave little
    assert moments[-1]["predicted"] == pytest.approx(moments[-1]["twist"], abs=0.02)
    assert told[f"support/{OBJECT}"] == known.support.points.tolist()


def test_what_happens_stands_between_the_moments(story):
    first, second = observations(2)
    told = story.on_plan(plan("PUSHING")) | story.on_observation(first)
    told |= story.on_fault("stopped") | story.on_fault("stopped")
    told |= story.on_plan(plan("CHOOSING", message="push 1 was stopped")) | story.on_fault("none")
    told |= story.on_observation(second)
    events = [told[key] for key in told if key.startswith("event/")]
    assert [(event["at"], event["text"]) for event in events] == [(1, "the pusher stops (stopped)"), (1, "push 1 was stopped")]
    assert told["push/0"]["aborted"]
    assert not told["push/1"]["aborted"]


def test_pictures_that_grow_too_many_are_thinned_evenly(story):
    size, there = MOST_PICTURES / 10, set()
    for second in range(100):
        for key, value in story.on_picture(second * 10**9, size).items():
            there.discard(key) if value is None else there.add(key)
        assert len(there) * size <= MOST_PICTURES
    numbers = sorted(int(key.partition("/")[2]) for key in there)
    assert numbers == list(range(0, 100, numbers[1]))
    assert len(numbers) > 4
