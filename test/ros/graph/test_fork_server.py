"""The server that forks the processes of nodes, with small programs instead of nodes."""

import contextlib
import fcntl
import os
import pathlib
import select
import signal
import socket
import subprocess
import sys
import termios

import pytest
from calls import wait_until

from pushfric_ros.graph import fork_server
from pushfric_ros.graph.fork_server import ForkServer, ServerGone

PATIENCE = 120.0
"""How long a process may take for anything; far more than it needs [s]."""

WAITS = "import time\nprint('waits', flush=True)\ntime.sleep(300)"


@pytest.fixture(scope="module")
def server():
    with contextlib.closing(ForkServer()) as server:
        wait_until(lambda: server.ready(0.1), "a server that can fork", PATIENCE)
        yield server


@pytest.fixture
def start(server, tmp_path):
    """A function that starts a program; the fixture ends what is left of it."""
    started = []

    def start(program, *arguments, **environment):
        script = tmp_path / f"{len(started)}_node"
        script.write_text(program)
        started.append(server.start([sys.executable, str(script), *arguments], environment))
        return started[-1]

    yield start
    for process in started:
        with contextlib.suppress(ProcessLookupError):  # it may have ended without having been reported yet
            os.killpg(process.pid, signal.SIGKILL)
        process.output.close()


def test_the_server_has_started_no_thread_and_has_imported_what_nodes_need(server, start):
    # rclpy alone may have brought threads that wait for a tracing daemon
    count = "import os, rclpy.node; print(len(os.listdir('/proc/self/task')))"
    alone = subprocess.run([sys.executable, "-c", count], capture_output=True, check=True)
    assert len(list(pathlib.Path(f"/proc/{server.pid}/task").iterdir())) == int(alone.stdout)
    program = f"import sys, gc; print([name in sys.modules for name in {fork_server.PRELOADED}], gc.isenabled())"
    assert start(program).output.read() == f"{[True] * len(fork_server.PRELOADED)} True\n"


@pytest.mark.parametrize(
    ("program", "code"),
    [
        ("", 0),
        ("raise SystemExit(3)", 3),
        ("import os; os._exit(4)", 4),
        ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", -signal.SIGKILL),
        ("1 / 0", 1),
    ],
)
def test_how_a_process_ends_is_known(start, program, code):
    process = start(program)
    process.wait(PATIENCE)
    assert (process.running, process.returncode) == (False, code)
    assert ("ZeroDivisionError" in process.output.read()) == (code == 1)


def test_an_end_that_is_reported_together_with_the_start_is_known(server, start, monkeypatch):
    """As on a busy machine, where the command line wakes up when both reports have come."""
    together = []

    def late(*arguments):
        ready = select_(*arguments)
        if ready[0] and not together:
            started = len(server._socket.recv(fork_server.LONGEST, socket.MSG_PEEK))
            wait_until(lambda: int.from_bytes(fcntl.ioctl(server._socket, termios.FIONREAD, bytes(4)), sys.byteorder) > started)
            together.append(started)
        return ready

    select_ = select.select
    monkeypatch.setattr(fork_server.select, "select", late)
    process = start("import os; os._exit(4)")
    process.wait(PATIENCE)
    assert (together != [], process.returncode) == (True, 4)


def test_a_process_is_what_a_fresh_interpreter_would_be(start):
    program = "import sys, os, signal; print(sys.argv[1:], __name__, os.getpgrp() == os.getpid(), sys.stdin.read() == '')\n"
    program += "print([signal.getsignal(n) is h for n, h in ((2, signal.SIG_DFL), (17, signal.SIG_DFL))])\n"
    program += "import random; print(os.listdir('/proc/self/fd').__len__(), file=sys.stderr)"
    process = start(program, "--ros-args", "-r", "__node:=tracker")
    lines = sorted(process.output.read().splitlines())
    assert lines[1:] == ["['--ros-args', '-r', '__node:=tracker'] __main__ True True", "[True, True]"]
    assert int(lines[0]) == 4  # three streams, and the folder that is listed


def test_ps_shows_the_name_of_a_process_and_its_environment(server, start):
    process = start(WAITS, "--ros-args", "-r", "__node:=tracker")
    assert process.output.readline() == "waits\n"
    ps = ["ps", "-ww", "-o", "args=", "-p", str(process.pid)]
    shown = subprocess.run(ps, capture_output=True, text=True, check=True).stdout
    assert "0_node --ros-args -r __node:=tracker" in shown
    assert fork_server.__name__ not in shown
    own = f"ROS_DOMAIN_ID={os.environ['ROS_DOMAIN_ID']}".encode()
    assert own in pathlib.Path(f"/proc/{process.pid}/environ").read_bytes().split(b"\0")


def test_a_server_that_cannot_import_says_so(monkeypatch, capfd):
    monkeypatch.setattr(fork_server, "PRELOADED", ("no_such_module",))
    with contextlib.closing(ForkServer()) as server, pytest.raises(ServerGone, match="the nodes ended with exit code 1"):
        server.ready(PATIENCE)
    assert "No module named 'no_such_module'" in capfd.readouterr().err
