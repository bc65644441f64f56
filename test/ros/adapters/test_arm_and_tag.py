"""The worked example: a simulated arm pushes an object along curves, and a detector tracks the tag on it."""

import pathlib

import arm_and_tag
import pytest
from composition import compose

from pushfric_core import TABLE_1, InvalidInput
from pushfric_core.bags.recorded import Recorded
from pushfric_core.cell.cell_file import load_cell
from pushfric_core.files.object_file import load_object
from pushfric_msgs.msg import FrictionEstimate, PusherState
from pushfric_ros.graph import graph
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE

EXAMPLES = pathlib.Path(__file__).parents[3] / "examples"


def test_an_arm_and_a_tag_give_the_friction_of_the_object(ros, tmp_path):
    cell = load_cell(EXAMPLES / "arm_and_tag.yaml")
    specs = graph.cell(cell, str(tmp_path / "bag"))
    assert [spec.name for spec in specs] == ["recorder", "estimator", "pose_source", "tip_source"]
    node = ros.node("peer", namespace=cell.namespace)
    estimates = ros.heard(node, FrictionEstimate, "friction_estimate", LATCHED)
    states = ros.heard(node, PusherState, "pusher_state", RELIABLE)
    ros.compose(*compose(specs, cell.namespace))
    example = ros.compose(arm_and_tag.ArmAndTag(namespace=cell.namespace))
    done = []
    example.timer.cancel()  # faster than in real time
    example.create_timer(1 / 300, lambda: done or example.move() or done.append(True))
    ros.wait_for(lambda: done, 240.0, "the end of the pushes")
    ros.wait_for(lambda: estimates and estimates[-1].pushes == len(arm_and_tag.PUSHES), 60.0, "an estimate of all pushes")
    last, known = estimates[-1], TABLE_1[arm_and_tag.NAME]
    center = last.center_of_friction
    assert (center.x, center.y) == pytest.approx(known.support.center_of_friction, abs=0.004)
    assert len({round(state.direction.x, 2) for state in states if state.push_id == 0}) > 5  # the tip moved along a curve
    model = load_object(cell.object)
    found = Recorded(tmp_path / "bag").read(model, cell.estimator, lambda _: None, partial=True).observations
    assert len({point.push_id for point in found}) >= len(arm_and_tag.PUSHES) - 1


def test_a_cell_has_one_tracker_and_one_robot(tmp_path):
    text = (EXAMPLES / "arm_and_tag.yaml").read_text()
    for section, other in (("camera", "poses"), ("pusher", "tip")):
        (tmp_path / "cell.yaml").write_text(f"{text}\n{section}: {{calibration: c.yaml}}\n")
        with pytest.raises(InvalidInput, match=section):
            load_cell(tmp_path / "cell.yaml")
        assert other in text
