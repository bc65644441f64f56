"""The benchmark's figures of latency, memory and time, of what grows, and of what planners get."""

import subprocess
import sys

import numpy as np
import pytest

from bench import display, footprint, pipeline, services, soak

MS = 1_000_000


def test_latency_runs_from_the_newest_image_needed():
    """Frames come every 100 ms of both clocks. A frame is rendered in 4 ms and tracked in 3; a pusher state takes 10.

    One pusher state is lost, so the second estimate waits for the next.
    """
    listener = pipeline.Listener()
    for frame in range(10):
        stamp, wall = 100 * frame * MS, (5000 + 100 * frame) * MS
        listener.images[stamp] = wall + 4 * MS
        listener.poses[stamp] = wall + 7 * MS
        listener.pusher_states[stamp] = wall + 10 * MS
    del listener.pusher_states[400 * MS]
    listener.estimates = {100 * MS: 5412 * MS, 200 * MS: 5520 * MS}  # their newest images are frames 4 and 5
    assert listener.latency() == pytest.approx(
        {
            "estimates": 2,
            "p50_ms": 12.0,
            "p99_ms": 16.0,
            "pose_p50_ms": 3.0,
            "pusher_p50_ms": 1.5,
            "rest_p50_ms": 7.5,
        }
    )


def test_the_memory_of_a_family_is_that_of_each_member():
    program = "print(flush=True); input()"
    child = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {program!r}, '__node:=inner'])"
    with subprocess.Popen([sys.executable, "-c", child], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        process.stdout.readline()  # both have loaded all that they need
        memory = footprint._memory_of_family(process.pid)
        process.communicate(b"\n")
    assert memory.keys() == {"command line", "inner"}
    assert all(1 < mebibytes < 100 for mebibytes in memory.values())


def test_cpu_time_is_that_of_the_command_and_its_children(monkeypatch):
    monkeypatch.setattr(footprint, "ROUNDS", 1)
    burn = "import time\nwhile time.process_time() < 0.3: pass"
    seconds = footprint._cpu(["bash", "-c", f"{sys.executable} -c '{burn}'; true"])
    assert seconds >= 0.3


def growth(node: str, memory, threads=12.0, keeps=0.0) -> dict[str, dict]:
    times = np.arange(200) * 2.0
    samples = np.column_stack((times, *np.broadcast_arrays(memory, np.full(200, threads), 30.0)))
    return {one["kind"]: one for one in soak._growth(node, samples, keeps)}


def test_what_grows_is_told_from_what_is_flat(rng):
    noise = rng.normal(0, 100, 200)
    assert all(one["flat"] for one in growth("tracker", 60_000 + noise).values())
    warming = 60_000 - 20_000 * np.exp(-np.arange(200) / 10.0)
    assert growth("tracker", warming)["memory, kB"]["flat"]
    grows = growth("tracker", 60_000 + noise + 60 * np.arange(200))["memory, kB"]
    assert not grows["flat"]
    assert abs(grows["slope"] - 60 / 2 * 3600) < 3000
    (failure,) = soak.failures({"growth": [grows, *growth("tracker", 60_000 + noise).values()]})
    assert failure.startswith("memory, kB of tracker: grows from ")
    # an estimator may keep its observations
    assert growth("estimator", 60_000 + 60 * np.arange(200), keeps=2000 * soak.PER_DATA_POINT)["memory, kB"]["flat"]
    leaking = np.floor(12 + np.arange(200) / 20)
    assert not growth("tracker", 60_000.0, threads=leaking)["threads"]["flat"]


def test_every_node_of_a_running_cell_is_followed():
    figures = soak.measure(0.1, lambda _: None)
    assert {(one["node"], one["kind"]) for one in figures["growth"]} == {
        (node, kind)
        for node in ("simulated_cell", "recorder", "estimator", "tracker", "actuator", "experiment")
        for kind in soak.KINDS
    }
    assert all(max(one["first"], one["last"]) > 0 for one in figures["growth"])  # of a line through few samples


def test_figures_of_any_kind_are_tables():
    figures = {"count": 3, "cpu": {"p50": 0.25}, "rows": [{"mm": 1234.5, "of": ["a", "b"]}, {"mm": None}]}
    shown = {table.title: [list(column.cells) for column in table.columns] for table in display.plain_tables("all", figures)}
    assert shown == {"all": [["count", "cpu p50"], ["3", "0.25"]], "all: rows": [["1234", "-"], ["a, b", "-"]]}


def test_a_crowd_is_answered_by_a_planner_that_has_only_its_topic(monkeypatch):
    for constant, value in (("CLIENTS", 3), ("AT_ONCE", 6), ("EACH", 5), ("TIMES", 2)):
        monkeypatch.setattr(services, constant, value)
    figures = services._crowd()
    assert (figures["at_once"], figures["in_a_row"]) == (6, 6)
    assert figures["p50_ms"] <= figures["p99_ms"]
