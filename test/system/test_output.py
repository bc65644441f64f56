"""Output that is lost, on a full disk or because its reader has gone: one line, an exit code that is not 0, no traceback."""

import contextlib
import os
import pathlib
import subprocess
import sys

import pytest
from calls import PROGRAM

ROOT = pathlib.Path(__file__).resolve().parents[2]
RECORDED = str(ROOT / "bags/rubber_rect4")
NODE = "import sys; sys.argv[0] = 'recorder_node'; from pushfric_ros.node_kit.executable import main; main()"


@contextlib.contextmanager
def full_disk():
    with open("/dev/full", "w") as full:
        yield full.fileno()


@contextlib.contextmanager
def closed_pipe():
    read, write = os.pipe()
    os.close(read)
    yield write
    os.close(write)


SINKS = [(full_disk, "No space left on device"), (closed_pipe, "Broken pipe")]

PROGRAMS = [
    [*PROGRAM, "--version"],
    [*PROGRAM, "estimate", RECORDED, "--json"],
    [*PROGRAM, "bag", "verify", RECORDED],
    [sys.executable, "-c", NODE, "--help"],
    [sys.executable, str(ROOT / "faults"), "--help"],
]


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: " ".join(program[-2:])[-30:])
@pytest.mark.parametrize(("sink", "why"), SINKS)
def test_lost_output_is_one_line(program, sink, why):
    with sink() as stdout:
        ended = subprocess.run(program, stdout=stdout, stderr=subprocess.PIPE, text=True, timeout=120)
    assert (ended.returncode, ended.stderr) == (1, f"error: stdout cannot be written: {why}\n")


@pytest.mark.parametrize(("sink", "why"), SINKS)
def test_a_refusal_that_cannot_be_printed_is_an_exit_code(sink, why):
    with sink() as stderr:
        ended = subprocess.run([*PROGRAM, "estimate", "none"], stdout=subprocess.PIPE, stderr=stderr, text=True, timeout=120)
    assert ended.returncode == 1
    assert ended.stdout == ""


def test_closed_streams_are_not_taken_by_files():
    ended = subprocess.run(
        ["bash", "-c", '"$@" >&-', "-", *PROGRAM, "bag", "verify", RECORDED], capture_output=True, text=True, timeout=120
    )
    assert (ended.returncode, ended.stderr) == (1, "error: stdout cannot be written: Bad file descriptor\n")


@pytest.mark.parametrize(("sink", "why"), SINKS)
def test_the_script_says_it_in_one_line(sink, why):
    with sink() as stdout:
        ended = subprocess.run([ROOT / "pushfric", "--help"], stdout=stdout, stderr=subprocess.PIPE, text=True, timeout=120)
    assert ended.returncode == 1
    assert ended.stderr.splitlines()[-1].endswith(why)  # a set-up that was due may have come first
    assert "Traceback" not in ended.stderr
