"""The example cell with an arm: plan, push, estimate, by the command line, with the arm in a process of its own."""

import json
import pathlib

import pytest
import yaml
from calls import all_was_seen, pushfric, simulated_arm

EXAMPLES = pathlib.Path(__file__).parents[2] / "examples"
PATIENT = {"silence": 30.0, "owner_timeout": 60.0, "requires_timeout": 60.0}  # for a busy machine [s]
PUSHES = [{"edge": 0, "offset": 0.042}, {"edge": 0, "offset": 0.0}, {"edge": 0, "offset": -0.042}, {"edge": 1, "offset": 0.0}]
SPEED = 0.008  # [m/s]: in real time, a busy machine sees a slow push often enough
COMMANDS = {
    "twist": "/servo_node/delta_twist_cmds",
    "trajectory": "/joint_trajectory_controller/joint_trajectory",
}


@pytest.mark.parametrize(("driver", "pushes"), [("twist", 1), ("trajectory", len(PUSHES))])
def test_an_arm_finds_the_centre_of_friction(driver, pushes, tmp_path):
    """From a plan of pushes; what an arm of the other kind sees of a push is the same."""
    content = yaml.safe_load((EXAMPLES / "arm.yaml").read_text())
    (tmp_path / "plan.yaml").write_text(json.dumps({"pushes": PUSHES[:pushes]}))
    content["camera"]["calibration"] = str(EXAMPLES / content["camera"]["calibration"])
    content["pusher"] |= {"driver": driver, "command": COMMANDS[driver], **PATIENT}
    content["plan"] |= {"file": "plan.yaml", "distance": 0.03, "speed": SPEED, "lost_object": 60.0, "lost_result": 60.0}
    (tmp_path / "cell.yaml").write_text(json.dumps(content))
    with simulated_arm(tmp_path / "log") as arm:
        run = pushfric("run", tmp_path / "cell.yaml", "--simulated-camera", "--headless", "--bag", tmp_path / "bag")
    assert arm.returncode == 0, (tmp_path / "log").read_text()
    seen = all_was_seen(run)
    estimate = json.loads(pushfric("estimate", tmp_path / "bag", "--json").stdout)
    assert estimate["pushes"] == pushes
    if seen and pushes == len(PUSHES):
        assert estimate["center_of_friction"] == pytest.approx((0.0, 0.0), abs=0.5e-3)
