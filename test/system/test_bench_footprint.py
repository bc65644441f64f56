"""The benchmark's footprint figures, of real processes."""

import os
import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]


@pytest.fixture
def footprint(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    from bench import footprint

    return footprint


def test_the_memory_of_a_family_is_that_of_each_member(footprint):
    program = "print(flush=True); input()"
    child = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {program!r}, '__node:=inner'])"
    with subprocess.Popen([sys.executable, "-c", child], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        process.stdout.readline()  # both have loaded all that they need
        memory = footprint._memory_of_family(process.pid)
        process.communicate(b"\n")
    assert memory.keys() == {"command line", "inner"}
    assert all(1 < mebibytes < 100 for mebibytes in memory.values())


def test_the_end_of_a_node_is_timed(footprint):
    seconds, codes = footprint._end(("recorder",), busy=False)
    assert seconds > 0
    assert codes == {"recorder": 0}


def test_cpu_time_is_that_of_the_command_and_its_children(footprint, monkeypatch):
    monkeypatch.setattr(footprint, "ROUNDS", 1)
    burn = "import time\nwhile time.process_time() < 0.3: pass"
    seconds = footprint._cpu(["bash", "-c", f"{sys.executable} -c '{burn}'; true"])
    assert seconds >= 0.3
    assert footprint._cpu_of(os.getpid()) > 0


def test_figures_are_shown_next_to_those_of_a_bare_node_and_judged(footprint):
    from rich.console import Console

    from bench import display

    figures = {
        "memory_mib": {"command line": 50.0, "estimator": 110.0, "total": 160.0},
        "bare_memory_mib": 32.0,
        "bare_start_cpu_s": 0.3,
        "help_cpu_s": 0.6,
        "estimate_cpu_s": 0.7,
        "first_pose_s": 1.4,
        "end_s": {"bare": 0.5, "alone": 0.1, "together": 0.2, "together_busy": 0.9},
        "end_codes": {"tracker, alone": -2},
    }
    targets = list(footprint.verdicts(figures))
    assert [target.met for target in targets] == [True, False, True, True, True, True, False]
    console = Console(width=120, record=True, file=open(os.devnull, "w"))  # noqa: SIM115
    console.print(*display.plain_tables("footprint", figures), display.verdict_table(targets))
    said = " ".join(console.export_text().split())
    assert "memory_mib total │ 160 │" in said
    assert "end_s alone │ 0.1 │" in said
    assert "./pushfric --help, s of CPU │ <= 0.5 │ 0.6 │ missed" in said
