import math
import pathlib
from types import SimpleNamespace

import numpy as np
import pytest

from pushfric_core.bags.bag import Bag
from pushfric_core.bags.cdr import Decoder, encoder
from pushfric_core.bags.constants import constants
from pushfric_core.bags.contents import Definition
from pushfric_core.bags.former import FORMER, present
from pushfric_core.bags.message_types import definition, record
from pushfric_core.bags.samples import observation_from_msg

BAG = pathlib.Path(__file__).parents[3] / "bags/rubber_rect4"
"""A bag that was recorded with the former definitions."""

OBSERVATION, ESTIMATE = "pushfric_msgs/msg/Observation", "pushfric_msgs/msg/FrictionEstimate"


@pytest.fixture(scope="module")
def recorded():
    """The messages of each type, as they were recorded and in the definition of today."""
    bag, found = Bag(BAG), {}
    definitions = {topic.type_name: topic.definition for topic in bag.summary.topics}
    for message in bag.messages():
        if (name := message.type_name) in FORMER:
            former = Decoder(name, definitions[name])(message.raw)
            today = Decoder(name, Definition("ros2msg", definition(name)))(encoder(name)(bag.deserialize(message)))
            found.setdefault(name, []).append((former, today))
    return found


def test_every_former_message_can_be_written_as_it_is_defined_today(recorded):
    assert recorded.keys() == FORMER.keys()


def test_observations_keep_what_is_known(recorded):
    for former, today in recorded[OBSERVATION]:
        assert [str(getattr(today, name)) for name in ("header", "push_id", "twist")] == [
            str(getattr(former, name)) for name in ("header", "push_id", "twist")
        ]
        assert (str(today.pose), str(today.tip_velocity)) == (str(former.pose[0]), str(former.tip_velocity[0]))
        found = observation_from_msg(today)
        assert (found.duration, found.force, found.depth) == (former.duration, None, None)


def test_estimates_keep_what_is_known(recorded):
    spreads = set()
    for former, today in recorded[ESTIMATE]:
        (mu_c,) = former.mu_c
        friction = today.contact_friction
        assert (friction.kind, friction.low) == (constants("ContactFriction")["KIND_BOUND"], mu_c.low)
        assert math.isnan(friction.value)
        assert friction.slip == former.contact_friction.slip[0]
        assert [one.text for one in today.reasons] == former.reasons
        assert {one.code for one in today.reasons} <= {constants("Reason")["UNKNOWN"]}
        assert today.change.since_push == constants("ObjectChange")["NO_PUSH"]
        spreads.add(len(former.spread))
        if former.spread:
            np.testing.assert_array_equal(today.spread.covariance, former.spread[0].covariance)
            assert today.confidence == former.confidence[0]
        else:
            assert np.isnan([*today.spread.covariance, today.confidence]).all()
    assert spreads == {0, 1}


def test_what_was_measured_is_kept_and_zero_was_unknown(recorded):
    former, _ = recorded[OBSERVATION][0]
    force = record("geometry_msgs/msg/Vector3", x=1.5, y=-0.5)
    known = SimpleNamespace(**{**vars(former), "force": [force], "depth": 1e-4})
    unknown = SimpleNamespace(**{**vars(former), "pose": [], "tip_velocity": [], "duration": 0.0, "depth": 0.0})
    found = observation_from_msg(present(OBSERVATION, known))
    assert (found.force, found.depth) == ((1.5, -0.5), 1e-4)
    found = observation_from_msg(present(OBSERVATION, unknown))
    assert (found.pose, found.tip_velocity, found.duration, found.depth) == (None, None, None, None)


def test_messages_of_today_stay_as_they_are(recorded):
    for name, pairs in recorded.items():
        assert all(present(name, today) is today for _, today in pairs)
