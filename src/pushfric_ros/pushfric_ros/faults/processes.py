"""Processes of a run: starting one, finding its nodes, the last words of one that has ended, and ending one."""

import contextlib
import os
import pathlib
import signal
import subprocess
import sys
from collections.abc import Sequence
from functools import partial
from typing import Any

from pushfric_ros.faults.fault import Otherwise
from pushfric_ros.node_kit.executable import die_with_parent

PROGRAM = (sys.executable, "-m", "pushfric_core")

MARKER = "PUSHFRIC_RUN"
"""Environment variable that all processes of a run inherit."""

NODES = ("tracker", "estimator", "recorder", "actuator", "experiment", "simulated_cell")

PROCESSES = {"pushfric_ros.graph.fork_server": "fork_server", **{f"{node}_node": node for node in (*NODES, "player")}}
"""By a part of the command line of each process of a run: its name here."""


def started(
    arguments: Sequence[str], run: pathlib.Path, output: Any = subprocess.PIPE, stdin: int = subprocess.DEVNULL, **more: Any
) -> "subprocess.Popen[str]":
    """Start a process of a run, which has this folder, out of reach of the terminal's Ctrl-C; it ends with this process."""
    return subprocess.Popen(
        arguments,
        stdin=stdin,
        stdout=output,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | {MARKER: str(run)},
        start_new_session=True,
        preexec_fn=partial(die_with_parent, signal.SIGTERM),
        **more,
    )


def nodes_alive(folder: pathlib.Path) -> dict[int, str]:
    """The processes of nodes, and of what starts them, in whose environment `MARKER` is this folder: names, by process id."""
    alive = {}
    for process in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            command = (process / "cmdline").read_bytes().decode(errors="replace")
            environment = (process / "environ").read_bytes().decode(errors="replace")
        except OSError:
            continue  # it has ended meanwhile
        for part, name in PROCESSES.items():
            if part in command and f"{MARKER}={folder}" in environment:
                alive[int(process.name)] = name
    return alive


def end_nodes(folder: pathlib.Path) -> None:
    """Kill what has outlived the run with this folder."""
    for pid in nodes_alive(folder):
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def pid_of(node: str, folder: pathlib.Path) -> int:
    """The process id of a node.

    Raises:
        Otherwise: it is not alive.
    """
    for pid, name in nodes_alive(folder).items():
        if name == node:
            return pid
    raise Otherwise(f"no {node} is alive")


def words_of(process: "subprocess.Popen[str]") -> str:
    """The last line that an ended process printed."""
    assert process.stdout is not None
    return (process.stdout.read().strip().splitlines() or ["nothing"])[-1]


def end(process: "subprocess.Popen[str] | None") -> None:
    """Ask a process to end, then kill it; None: there is none."""
    for number, seconds in ((signal.SIGCONT, 0.0), (signal.SIGTERM, 8.0), (signal.SIGKILL, 8.0)):
        if process is not None and process.poll() is None:
            process.send_signal(number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(seconds)
