"""The whole graph as its user runs it: real processes, real middleware, one demo for all tests of this module."""

import contextlib
import fcntl
import json
import os
import pathlib
import pty
import re
import select
import signal
import struct
import termios
import time

import numpy as np
import pytest
from calls import PROGRAM, pushfric
from documents import blocks, has_the_form, shown
from rosbags.highlevel import AnyReader

from pushfric_core.geometry.table_1 import TABLE_1
from pushfric_ros.faults.processes import end, end_nodes, pid_of, started

ROOT = pathlib.Path(__file__).resolve().parents[2]

PATIENCE = 120.0
"""A demo on a terminal that does not do what it was told within this time [s] never will."""

KEYS = {
    "object",
    "objective",
    "lower_bound",
    "gap",
    "w",
    "support_points",
    "center_of_friction",
    "belief",
    "mu_c",
    "data_points",
    "pushes",
    "status",
}


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


def test_the_demo_reports_every_push_and_draws_its_figure(demo):
    bag, result, run = demo
    assert set(result) == KEYS | {"truth", "bag"}
    assert (result["truth"], result["bag"]) == (TABLE_1["rubber_rect4"].to_dict(), str(bag))
    pushes = [line for line in run.stderr.splitlines() if line.startswith("push")]
    assert len(pushes) == 14
    believed = r"(, within \d+\.\d\d mm)?(  mu_c (over \S+|\S+\.\.\S+))?"
    assert all(re.search(rf"p_CF \( *\S+, +\S+\) mm{believed}  fit error", push) for push in pushes)
    assert ", within 0." in pushes[-1]
    assert (bag / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert run.stdout == ""


def test_the_demo_ends_as_the_documents_show(demo):
    bag, _, run = demo
    said = run.stderr.replace(str(bag), "runs/first")
    (readme,) = [block.text for block in blocks("README.md") if block.text.startswith("rubber_rect4: ")]
    assert has_the_form(said, readme), said
    table, start, summary = shown("docs/tutorial.md", "./pushfric demo --bag runs/first --view").partition("rubber_rect4: ")
    assert "\npush  observations" in table  # on a terminal; without one, there is a line for each push
    assert has_the_form(said, start + summary), said


def test_the_bag_gives_exactly_the_live_estimate_offline(demo):
    bag, result, _ = demo
    run = pushfric("estimate", bag, "--json")
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout) == {key: result[key] for key in KEYS}


def test_the_keys_of_a_terminal_steer_the_demo(tmp_path):
    ours, terminal = pty.openpty()
    fcntl.ioctl(ours, termios.TIOCSWINSZ, struct.pack("4H", 50, 300, 0, 0))  # no prompt is cut by the end of a line
    command = [*PROGRAM, "demo", "--bag", str(tmp_path / "bag")]
    shown = ""
    demo = started(command, tmp_path, terminal, stdin=terminal)
    os.close(terminal)

    def read(until: str) -> None:
        nonlocal shown
        deadline = time.monotonic() + PATIENCE
        while until not in shown:
            came = select.select([ours], [], [], max(0.0, deadline - time.monotonic()))[0]
            assert came, f"{until!r} did not come: {shown}"
            shown += os.read(ours, 65536).decode(errors="replace")
        shown = shown.partition(until)[2]  # what comes next may be there already

    try:
        read("2/14")
        assert not termios.tcgetattr(ours)[3] & termios.ECHO
        os.write(ours, b" ")
        read("nothing moves until a reset")
        read("press Reset")
        os.write(ours, b"r")
        read("released")
        os.write(ours, b"e")
        read("the run ends")
        with contextlib.suppress(OSError):  # the last process with this terminal has ended
            read("never")
        assert demo.wait(60) == 0, shown
    finally:
        end(demo)
        end_nodes(tmp_path)
        os.close(ours)
    assert re.search(r"p_CF x \[mm\](?s:.*)figure.png", shown)


@pytest.fixture
def running(tmp_path, monkeypatch):
    """A demo of four pushes whose first push is over."""
    monkeypatch.syspath_prepend(ROOT)
    from faults.cell_run import CellRun

    with CellRun(tmp_path) as run:
        run.demo(short=True)
        run.wait_for_push()
        yield run


def test_ctrl_c_leaves_no_process_behind_but_a_bag(running, tmp_path):
    assert len(running.nodes_alive()) == 7  # with what forks them
    running.process.send_signal(signal.SIGINT)
    assert running.wait_for_end() == 130
    assert running.nodes_alive() == {}
    said = re.search(
        rf"^bag left in {tmp_path}/bag \(pushes: (\d+)\); ./pushfric (estimate {tmp_path}/bag) reads it$", running.output, re.M
    )
    assert "Traceback" not in running.output
    read = pushfric(*said[2].split(), "--json", "--ledger", tmp_path / "ledger.json")
    result, pushes = json.loads(read.stdout), int(said[1])
    doubts = {doubt["code"] for doubt in json.loads((tmp_path / "ledger.json").read_text())["doubts"]}
    assert (read.returncode, result["pushes"]) == (1, pushes)
    assert {"plan_unfinished"} <= doubts <= {"plan_unfinished", "no_end"}


def test_the_nodes_end_with_a_killed_command_line(running):
    running.process.kill()
    running.wait_for(lambda: running.nodes_alive() == {}, "the end of all nodes")


def test_the_death_of_a_node_that_cannot_be_replaced_ends_the_run(running):
    """The actuator, for example; test_faults.py has others."""
    os.kill(pid_of("actuator", running.folder), signal.SIGKILL)
    assert running.wait_for_end() == 1
    why = "actuator was killed by SIGKILL"
    assert f"error: {why}" in running.output
    assert running.nodes_alive() == {}
    assert why in (running.bag / "report.html").read_text()
    assert f"# in doubt: {why}" in (running.bag / "model.yaml").read_text()
    assert (running.bag / "figure.png").exists()


def test_the_death_of_what_starts_the_nodes_ends_the_run(running):
    os.kill(pid_of("fork_server", running.folder), signal.SIGKILL)
    assert running.wait_for_end() == 1
    assert "error: the process that starts the nodes was killed by SIGKILL" in running.output
    assert running.nodes_alive() == {}


def test_an_estimator_that_is_killed_goes_on_from_the_bag(running, tmp_path):
    os.kill(pid_of("estimator", running.folder), signal.SIGKILL)
    # on a slow machine it may be away long enough that the push is aborted
    code = running.wait_for_end()
    aborted = re.search(r"^error: .*(aborted|no observation came from push)", running.output, re.M)
    assert code == bool(aborted), running.output
    assert "estimator was killed by SIGKILL; starting it again" in running.output
    assert running.nodes_alive() == {}
    offline = json.loads(pushfric("estimate", tmp_path / "bag", "--json").stdout)
    with AnyReader([tmp_path / "bag"]) as reader:
        told = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages() if c.topic == "/cell/friction_estimate"]
        points = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages() if c.topic == "/cell/observation"]
    assert offline["pushes"] >= 3
    assert list(told[-1].support_friction.weights) == offline["w"]
    stamps = [(point.push_id, point.header.stamp.sec, point.header.stamp.nanosec) for point in points]
    assert len(stamps) == len(set(stamps))
    assert told[-1].data_points == offline["data_points"] >= len(stamps) - 6  # a push that was repeated is left out
