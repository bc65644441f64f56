"""The estimator's settings are recorded in the bag, and read from it again."""

import re

import numpy as np
import pytest
from calls import figures
from problems import observations_of
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from pushfric_core import TABLE_1, Estimator, EstimatorConfig, InvalidInput, TrajectoryConfig
from pushfric_core.bags.bag_writer import BagWriter, offered
from pushfric_core.bags.recorded import Recorded
from pushfric_core.estimation.region import RegionConfig
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.object_file import load_object
from pushfric_ros.messages.conversions import observation_to_msg
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE

NAME = "rubber_rect4"
DATA = observations_of(TABLE_1[NAME].outline, TABLE_1[NAME].support, 0.5, 8, np.random.default_rng(5))
UNUSUAL = EstimatorSettings(
    EstimatorConfig(useful_radius=1.0, terms=("moment", "cone"), mu_bound=0.4, cor_radius=0.01, tie_break=False),
    TrajectoryConfig(window=7),
    (2, 5),
    RegionConfig(region_margin=0.005),
    (3,),
)


def bag_of(folder, text, before=EstimatorSettings().to_text()):  # noqa: B008
    """A bag of observations, with the settings as the estimator publishes them, if there are any."""
    with BagWriter(folder) as writer:
        writer.add_topic("/cell/observation", "pushfric_msgs/msg/Observation", [offered(RELIABLE)])
        if text is not None:
            writer.add_topic("/cell/estimator_settings", "std_msgs/msg/String", [offered(LATCHED)])
            for said in (before, text):  # the settings with an exclusion come later
                writer.write("/cell/estimator_settings", 1, serialize_message(String(data=said)))
        for stamp, observation in enumerate(DATA):
            writer.write("/cell/observation", 1 + stamp, serialize_message(observation_to_msg(observation, NAME)))
    return folder


def estimated(bag, *options):
    return figures("estimate", bag, "--object", NAME, *options)


def test_parameters_have_types_that_ros_accepts():
    parameters = EstimatorSettings().parameters()
    assert (parameters["cor_radius"], parameters["terms"]) == ("auto", ["moment"])
    assert "exclude_pushes" not in parameters  # ROS cannot tell the type of an empty list
    assert {**UNUSUAL.parameters(), "exclude_pushes": [2, 5], "window": 7} == UNUSUAL.parameters()


def test_a_bag_is_estimated_as_it_was_recorded(tmp_path):
    bag = bag_of(tmp_path / "bag", UNUSUAL.to_text())
    assert Recorded(bag).settings == UNUSUAL
    model = Estimator(load_object(NAME).support_points, UNUSUAL.estimator)
    for observation in DATA:
        if observation.push_id not in UNUSUAL.excluded:
            expected = model.add(observation)
    result = estimated(bag)
    assert (result["objective"], result["w"]) == (expected.solution.objective, list(expected.w))
    assert result["pushes"] == 6


def test_options_override_what_was_recorded(tmp_path):
    bag = bag_of(tmp_path / "bag", UNUSUAL.to_text())
    options = ["--terms", "moment", "--cor-radius", "auto", "--tie-break", "--exclude-push", "1"]
    plain = bag_of(tmp_path / "plain", None)
    excluded = [part for push_id in (1, 2, 5) for part in ("--exclude-push", str(push_id))]
    assert estimated(bag, *options)["w"] == estimated(plain, *excluded, "--useful-radius", "1")["w"]


def test_a_bag_without_settings_was_recorded_with_the_defaults(tmp_path):
    assert Recorded(bag_of(tmp_path / "bag", None)).settings == EstimatorSettings()


def test_unknown_settings_are_left_out_and_refused_where_there_are_no_others(tmp_path):
    strange, why = '{"colour": 1}', r"bag: /cell/estimator_settings is not understood: expected any of terms, .*, got colour$"
    recorded = Recorded(bag_of(tmp_path / "bag", strange, UNUSUAL.to_text()))
    assert recorded.settings == UNUSUAL
    assert any(re.search(f"a message is left out: .*{why}", doubt.text) for doubt in recorded.ledger().doubts)
    with pytest.raises(InvalidInput, match=why):
        _ = Recorded(bag_of(tmp_path / "other_bag", strange, strange)).settings
