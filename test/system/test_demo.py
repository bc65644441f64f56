"""The whole graph as its user runs it: real processes, real middleware, one demo for all tests of this module."""

import json
import os
import pathlib
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from pushfric_core.simulation import TABLE_1
from pushfric_ros.report import truth

KEYS = {
    "object",
    "objective",
    "lower_bound",
    "gap",
    "w",
    "support_points",
    "center_of_friction",
    "mu_c",
    "data_points",
    "pushes",
    "status",
}
NODES = (
    "tracker_node",
    "actuator_node",
    "estimator_node",
    "experiment_node",
    "recorder_node",
    "player_node",
    "simulated_cell_node",
)


def pushfric(*arguments, **options):
    """The command line in a process of its own, and what it said."""
    command = [sys.executable, "-m", "pushfric_ros.cli", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=240, stdin=subprocess.DEVNULL, **options)


def nodes_alive(marker):
    """Processes of the project's nodes whose environment holds a marker."""
    alive = []
    for folder in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            command = (folder / "cmdline").read_bytes().decode(errors="replace")
            environment = (folder / "environ").read_bytes().decode(errors="replace")
        except OSError:
            continue  # gone meanwhile
        if any(node in command for node in NODES) and marker in environment:
            alive.append((int(folder.name), command.replace("\0", " ")))
    return alive


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo")
    run = pushfric("demo", "--headless", "--bag", folder / "bag", "--json", folder / "demo.json", "--seed", 1)
    assert run.returncode == 0, run.stderr
    return folder / "bag", json.loads((folder / "demo.json").read_text()), run


def test_the_demo_finds_the_truth(demo):
    _, result, _ = demo
    known = TABLE_1["rubber_rect4"]
    error = np.abs(np.array(result["center_of_friction"]) - known.support.center_of_friction) / known.outline.size
    assert (error < 0.02).all()
    assert result["pushes"] >= 14
    assert result["status"] == "optimal"
    heaviest = np.argsort(result["w"])[-4:]
    corners = {tuple(np.round(result["support_points"][index], 6)) for index in heaviest}
    assert corners == {tuple(np.round(point, 6)) for point in known.support.points}


def test_the_result_has_the_documented_keys(demo):
    bag, result, _ = demo
    assert set(result) == KEYS | {"truth", "bag"}
    assert result["truth"] == truth("rubber_rect4")
    assert result["bag"] == str(bag)


def test_the_demo_reports_every_push_and_draws_its_figure(demo):
    bag, _, run = demo
    assert sum(line.startswith("push") for line in run.stderr.splitlines()) == 14
    assert (bag / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert run.stdout == ""


def test_the_bag_is_read_by_an_independent_reader(demo):
    bag, result, _ = demo
    counts, last = {}, {}
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages():
            counts[connection.topic] = counts.get(connection.topic, 0) + 1
            last[connection.topic] = reader.deserialize(raw, connection.msgtype)
        assert reader.message_count == sum(counts.values())
    assert counts["/cell/friction_estimate"] == counts["/cell/observation"] == result["data_points"]
    assert list(last["/cell/support_friction"].weights) == result["w"]
    assert last["/cell/observation"].push_id == 13
    assert counts["/cell/object_pose"] > 500


def test_the_bag_gives_exactly_the_live_estimate_offline(demo):
    bag, result, _ = demo
    run = pushfric("estimate", bag, "--json")
    assert run.returncode == 0, run.stderr
    offline = json.loads(run.stdout)
    assert offline == {key: result[key] for key in KEYS}


def test_the_bag_gives_exactly_the_live_estimate_replayed(demo):
    bag, result, _ = demo
    run = pushfric("replay", bag, "--rate", 10, "--json", "--headless")
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout) == {key: result[key] for key in KEYS}


def test_a_bag_of_observations_alone_is_replayed_too(demo, tmp_path):
    bag, _, _ = demo
    csv = tmp_path / "data.csv"
    rows = ["contact_x,contact_y,normal_x,normal_y,vx,vy,omega,push_id"]
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if c.topic == "/cell/observation"]
        for connection, _, raw in reader.messages(connections):
            o = reader.deserialize(raw, connection.msgtype)
            values = (o.contact_point.x, o.contact_point.y, o.contact_normal.x, o.contact_normal.y)
            rows.append(",".join(map(repr, (*values, o.twist.linear.x, o.twist.linear.y, o.twist.angular.z, o.push_id))))
    csv.write_text("\n".join(rows) + "\n")
    run = pushfric("estimate", csv, "--object", "rubber_rect4", "--json")
    assert json.loads(run.stdout)["w"] == demo[1]["w"]


def start_demo(folder, marker):
    environment = os.environ | {"PUSHFRIC_TEST": marker}
    command = [sys.executable, "-m", "pushfric_ros.cli", "demo", "--headless", "--bag", str(folder / "bag")]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def wait_for(predicate, what, timeout=60.0):
    deadline = time.monotonic() + timeout
    while not predicate():
        assert time.monotonic() < deadline, f"{what} did not happen within {timeout} s"
        time.sleep(0.05)


def await_first_push(process):
    """Read the demo's lines until its first push is reported."""
    for line in process.stdout:
        if line.startswith("push"):
            return
    pytest.fail("the demo ended before its first push")


def pid_of(node, marker):
    return next(pid for pid, command in nodes_alive(marker) if node in command)


def test_ctrl_c_leaves_no_process_behind(tmp_path):
    marker = f"PUSHFRIC_TEST={tmp_path.name}"
    process = start_demo(tmp_path, tmp_path.name)
    await_first_push(process)
    assert len(nodes_alive(marker)) == 6
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=30)
    assert process.returncode == 130
    assert nodes_alive(marker) == []


def test_a_killed_command_line_takes_its_nodes_along(tmp_path):
    marker = f"PUSHFRIC_TEST={tmp_path.name}"
    process = start_demo(tmp_path, tmp_path.name)
    await_first_push(process)
    process.kill()
    process.communicate(timeout=30)
    wait_for(lambda: nodes_alive(marker) == [], "the end of all nodes", timeout=20.0)


@pytest.mark.parametrize("node", ["estimator_node", "simulated_cell_node", "experiment_node", "recorder_node"])
def test_the_death_of_a_node_that_cannot_be_replaced_ends_the_run(tmp_path, node):
    marker = f"PUSHFRIC_TEST={tmp_path.name}"
    process = start_demo(tmp_path, tmp_path.name)
    await_first_push(process)
    os.kill(pid_of(node, marker), signal.SIGKILL)
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 1
    assert f"error: {node.removesuffix('_node')} was killed by SIGKILL" in output
    assert nodes_alive(marker) == []


def test_a_second_cell_of_the_same_name_is_refused(tmp_path):
    process = start_demo(tmp_path, tmp_path.name)
    try:
        await_first_push(process)
        second = pushfric("demo", "--headless", "--bag", tmp_path / "second")
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)
    assert second.returncode == 2
    assert "a cell named /cell runs already on ROS domain" in second.stderr
    assert not (tmp_path / "second").exists()


@pytest.mark.parametrize("node", ["tracker_node", "actuator_node"])
def test_a_node_that_loses_nothing_is_started_again(tmp_path, node):
    marker = f"PUSHFRIC_TEST={tmp_path.name}"
    process = start_demo(tmp_path, tmp_path.name)
    await_first_push(process)
    killed = pid_of(node, marker)
    os.kill(killed, signal.SIGKILL)
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 0, output
    assert f"{node.removesuffix('_node')} was killed by SIGKILL; starting it again" in output
    assert nodes_alive(marker) == []
