"""What a run leaves behind when it is killed: nothing."""

import os
import pathlib
import signal
import subprocess
import sys

import pytest
from ament_index_python.packages import get_package_prefix
from calls import wait_until

from pushfric_ros.graph.supervisor import scratch_folder
from pushfric_ros.node_kit.executable import PARENT

KEEPS = """
import signal
from pushfric_ros.graph.supervisor import scratch_folder
with scratch_folder() as folder:
    (folder / "file").write_text("text")
    print(folder, flush=True)
    signal.pause()
"""

STARTS = f"""
import os, signal, subprocess, sys
node = subprocess.Popen(sys.argv[1:], env=os.environ | {{{PARENT!r}: str(os.getpid())}}, stderr=subprocess.PIPE, text=True)
print(node.pid, flush=True)
signal.pause()
"""


def test_a_folder_goes_with_its_context():
    with scratch_folder() as folder:
        (folder / "file").touch()
    assert not folder.exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_folder_goes_with_a_process_that_is_killed(number):
    process = subprocess.Popen([sys.executable, "-c", KEEPS], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    folder = pathlib.Path(process.stdout.readline().strip())
    assert (folder / "file").exists()
    process.send_signal(number)
    process.communicate(timeout=120)
    wait_until(lambda: not folder.exists(), "the end of the folder")


def test_a_node_ends_with_what_launched_it():
    """`ros2 launch` leaves its processes running when it is killed."""
    executable = pathlib.Path(get_package_prefix("pushfric_ros")) / "lib/pushfric_ros/estimator_node"
    node = [sys.executable, str(executable), "--ros-args", "-p", "object:=rubber_rect4"]
    launched = subprocess.Popen([sys.executable, "-c", STARTS, *node], stdout=subprocess.PIPE, text=True)
    pid = int(launched.stdout.readline())
    launched.kill()
    launched.communicate(timeout=120)

    def ended():
        try:
            return pathlib.Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
        except (FileNotFoundError, ProcessLookupError):
            return True

    try:
        wait_until(ended, "the end of the node")
    except AssertionError:
        os.kill(pid, signal.SIGKILL)
        raise
