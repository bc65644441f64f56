"""Ctrl-C at moments that are hard to hit: while the command line loads and while it ends; and what it leaves behind."""

import os
import pathlib
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from calls import PROGRAM

from pushfric_ros.commands.recorded_run import left_behind

ROOT = pathlib.Path(__file__).resolve().parents[2]
RECORDED = ROOT / "bags/rubber_rect4"


WHILE_LOADING = """
import os, signal, sys

class Interrupts:
    def find_spec(self, name, *_):
        if name == "pushfric_core.commands.cli":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupts())
"""

WHILE_ENDING = """
import atexit, os, signal
from pushfric_core.commands import program
start = program.end_at_once
program.end_at_once = lambda: (start(), atexit.register(os.kill, os.getpid(), signal.SIGINT))
"""

IN_A_COMMAND = """
import os, signal
from pushfric_ros.commands import run
run.load_cell = lambda _: os.kill(os.getpid(), signal.SIGINT)
"""


@pytest.mark.parametrize("moment", [WHILE_LOADING, WHILE_ENDING, IN_A_COMMAND])
def test_ctrl_c_is_quiet_whenever_it_comes(moment):
    program = moment + "import sys; sys.argv[1:] = ['run', 'none.yaml']; from pushfric_core.__main__ import main; main()"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    said = "error: none.yaml: " if moment == WHILE_ENDING else ""
    assert (ended.returncode, ended.stdout) == (130, "")
    assert ended.stderr.startswith(said)
    assert ended.stderr.count("\n") == bool(said)


TOO_LATE = """
import os, signal, threading, time
from pushfric_core.commands.program import run

class Late:
    def __del__(self, kill=os.kill, pid=os.getpid(), number=signal.SIGINT):
        kill(pid, number)

late = Late()
threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
run(lambda: 0)
"""


def test_ctrl_c_that_comes_when_all_is_done_changes_nothing():
    """A thread was there to take it, as of the middleware, and Python's handler was gone."""
    assert subprocess.run([sys.executable, "-c", TOO_LATE], timeout=60).returncode == 0


WHILE_RECOVERING = """
import os, signal
from pushfric_core.bags.bag_writer import BagWriter
BagWriter.write = lambda *_: os.kill(os.getpid(), signal.{})
"""


@pytest.mark.parametrize("caught", ["SIGINT", "SIGTERM"])
def test_a_recovery_that_is_ended_leaves_no_folder(tmp_path, caught):
    arguments = ["bag", "recover", str(RECORDED), "--out", str(tmp_path / "out")]
    program = f"import sys; sys.argv[1:] = {arguments}; from pushfric_core.__main__ import main; main()"
    ended = subprocess.run([sys.executable, "-c", WHILE_RECOVERING.format(caught) + program], timeout=60)
    assert (ended.returncode, list(tmp_path.iterdir())) == (130, [])


def test_ctrl_c_says_that_no_object_was_written(tmp_path):
    command = [*PROGRAM, "edit", "object.yaml", "--port", "0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as drawing:
        assert drawing.stderr.readline().startswith("view: http://127.0.0.1:")
        drawing.send_signal(signal.SIGINT)
        said = drawing.stderr.read()
    assert (drawing.returncode, said) == (130, "nothing was written to object.yaml\n")
    assert not (tmp_path / "object.yaml").exists()


AFTER_A_RUN = """
import os, signal
from rich.console import Console
from pushfric_ros.commands import watch

class Monitor:
    estimate = next_push = settled = None

    def __init__(self, *_, **__):
        os.kill(os.getpid(), signal.SIGINT)

    def watch(self, supervisor, _):
        try:
            supervisor.poll()
        finally:
            os.kill(os.getpid(), signal.SIGINT)

    def close(self):
        os.kill(os.getpid(), signal.SIGINT)
        print("closed")

class Interrupted:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)

watch.Monitor = Monitor
try:
    watch.watch(Console(), [], "/test_interrupt", "watching", live=False)
except KeyboardInterrupt:
    print("ended", flush=True)
Interrupted()
print("never reached")
"""


def test_ctrl_c_during_a_run_waits_for_its_end_and_afterwards_for_nothing():
    ended = subprocess.run([sys.executable, "-c", AFTER_A_RUN], capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "closed\nended\n", "")


def test_a_bag_that_is_left_is_named_with_its_pushes(tmp_path):
    assert left_behind(tmp_path / "bag") == "interrupted before there was a bag"
    shutil.copytree(RECORDED, tmp_path / "bag")
    expected = f"bag left in {tmp_path}/bag (pushes: 14); ./pushfric estimate {tmp_path}/bag reads it"
    assert left_behind(tmp_path / "bag") == f"report: {tmp_path}/bag/report.html\n{expected}"
    for name in ("report.html", "model.yaml"):
        assert "the run was interrupted" in (tmp_path / "bag" / name).read_text()
    left_behind(tmp_path / "bag", had_an_end=False)
    assert "interrupted" not in (tmp_path / "bag/model.yaml").read_text()


def test_a_bag_that_gives_no_estimate_says_why(tmp_path):
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag/bag_0.mcap").touch()
    assert left_behind(tmp_path / "bag").startswith(f"the bag {tmp_path}/bag gives no estimate: {tmp_path}/bag")


def test_a_damaged_bag_leaves_its_result_under_what_is_in_doubt(tmp_path):
    shutil.copytree(RECORDED, tmp_path / "bag")
    recording = next((tmp_path / "bag").glob("*.mcap"))
    recording.write_bytes(recording.read_bytes()[: recording.stat().st_size // 2])
    said = left_behind(tmp_path / "bag")
    assert said.endswith(f"./pushfric estimate {tmp_path}/bag --partial reads it")
    assert "the bag is damaged, " in (tmp_path / "bag/model.yaml").read_text()


HELD_BACK = """
import os, signal, sys
signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
os.kill(os.getpid(), signal.SIGINT)
os.execv(sys.argv[1], sys.argv[1:])
"""


def test_a_ctrl_c_from_before_the_first_instruction_is_answered(tmp_path):
    """It passes through the script, bash and the interpreter, and nothing is done before it is answered."""
    command = [str(ROOT / "pushfric"), "import", "stablepush", "none.csv", "--out", str(tmp_path / "out")]
    ended = subprocess.run([sys.executable, "-c", HELD_BACK, *command], capture_output=True, text=True, timeout=120)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "")


def cpu_time(process):
    """What the main thread of a process has used [s] (schedstat, in ns)."""
    return int(pathlib.Path(f"/proc/{process.pid}/schedstat").read_text().split()[0]) * 1e-9


@pytest.mark.parametrize("seconds", np.linspace(0.002, 0.35, 5).round(3))
def test_ctrl_c_is_quiet_after_any_time(seconds):
    command = [ROOT / "pushfric", "estimate", RECORDED, "--grid", "20", "20"]  # takes longer than that on any machine
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True) as early:
        while cpu_time(early) < seconds:
            time.sleep(0.0005)
        os.killpg(early.pid, signal.SIGINT)
        said = early.communicate(timeout=120)
    # the shell that reads the first line of the script dies of the signal itself
    assert (early.returncode, *said) in ((130, "", ""), (-signal.SIGINT, "", ""))
