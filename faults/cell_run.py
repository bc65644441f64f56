"""A cell that runs in a process of its own, as its user starts it, with its output and its nodes."""

import contextlib
import os
import pathlib
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence

NODES = ("tracker", "actuator", "estimator", "experiment", "recorder", "player", "simulated_cell")

PROCESSES = {"pushfric_ros.graph.fork_server": "fork_server", **{f"{node}_node": node for node in NODES}}
"""What the command lines of a run's processes contain, and the names of those processes here."""

RUN_TIMEOUT = 300.0
"""How much CPU time a run may use before an awaited event, or before the next line that it prints [s]."""

STANDSTILL = 600.0
"""A run that uses less than a second of CPU time within this time [s], and prints nothing, does nothing more."""

MARKER = "PUSHFRIC_RUN"
"""Environment variable that all processes of a run inherit."""


class DidNotHappen(AssertionError):
    """An awaited event did not come."""


def demo(folder: pathlib.Path, *options: str) -> list[str]:
    """The command that records a demo into a folder's `bag`."""
    return [sys.executable, "-m", "pushfric_core", "demo", "--headless", "--bag", str(folder / "bag"), *options]


def nodes_alive(marker: str) -> dict[int, str]:
    """The processes of nodes, and of what starts them, whose environment holds a marker: their names, by process id."""
    alive = {}
    for process in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            command = (process / "cmdline").read_bytes().decode(errors="replace")
            environment = (process / "environ").read_bytes().decode(errors="replace")
        except OSError:
            continue  # it has ended meanwhile
        for part, name in PROCESSES.items():
            if part in command and marker in environment:
                alive[int(process.name)] = name
    return alive


class CellRun:
    """A command that runs a cell; a context manager that leaves no process behind.

    Args:
        command: what to run.
        folder: where the bag is made, as `bag`; its name must be unique, as it marks the run's processes.
    """

    def __init__(self, command: Sequence[str], folder: pathlib.Path) -> None:
        self.folder, self.bag = folder, folder / "bag"
        self._marker = f"{MARKER}={folder}"
        environment = os.environ | dict([self._marker.split("=", 1)])
        self.process = subprocess.Popen(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=pathlib.Path(__file__).resolve().parents[1],
        )
        self._lines: list[str] = []
        self._used: dict[int, float] = {}  # CPU time, by process [s]
        self._listener = threading.Thread(target=self._listen)
        self._listener.start()

    def _listen(self) -> None:
        assert self.process.stdout is not None
        with contextlib.suppress(ValueError):  # a fault may be that nobody reads any more
            self._lines.extend(iter(self.process.stdout.readline, ""))

    def note(self, line: str) -> None:
        """Add what a strike found to the run's output."""
        self._lines.append(f"\n{line}\n")

    @property
    def output(self) -> str:
        """What the run has printed."""
        return "".join(self._lines)

    @property
    def ended(self) -> bool:
        """Whether the run has ended."""
        return self.process.poll() is not None

    def wait_for(self, predicate: Callable[[], object], what: str) -> None:
        """Wait until a predicate holds, for as long as the run makes progress, however slow the machine is.

        Raises:
            DidNotHappen: the run has used RUN_TIMEOUT, or stood still for STANDSTILL, and printed nothing meanwhile.
        """
        printed, spent, since, looked = len(self._lines), self._cpu_time(), time.monotonic(), time.monotonic()
        begin = spent
        while not predicate():
            time.sleep(0.05)
            if time.monotonic() - looked < 1.0:
                continue
            now, looked = self._cpu_time(), time.monotonic()
            if len(self._lines) > printed:
                printed, begin, spent, since = len(self._lines), now, now, looked
            elif now - spent > 1.0:
                spent, since = now, looked
            if now - begin > RUN_TIMEOUT or looked - since > STANDSTILL:
                used = f"{now - begin:.0f} s of CPU time and {looked - since:.0f} s without any"
                raise DidNotHappen(f"{what} did not come within {used}, only: {self.output}")

    def _cpu_time(self) -> float:
        """CPU time that the run's processes have used [s]; that of those that have ended is kept."""
        for pid in (self.process.pid, *self.nodes_alive()):
            with contextlib.suppress(OSError):  # it has ended meanwhile
                used = pathlib.Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
                self._used[pid] = sum(map(int, used)) / os.sysconf("SC_CLK_TCK")
        return sum(self._used.values())

    def wait_for_push(self) -> None:
        """Wait until the first push is over and the second under way, or the run has ended."""
        self.wait_for(lambda: self.ended or "\npush" in self.output, "the first push")

    def wait_for_output(self, pattern: str) -> None:
        """Wait until the run has printed a match of a regular expression, or has ended."""
        self.wait_for(lambda: self.ended or re.search(pattern, self.output), pattern)

    def wait_for_end(self) -> int:
        """Wait until the run has ended; return its exit code."""
        self.wait_for(lambda: self.ended, "the end")
        self._listener.join(10.0)
        return self.process.returncode

    def nodes_alive(self) -> dict[int, str]:
        """Names of the run's nodes that are alive, by process id."""
        return nodes_alive(self._marker)

    def pid_of(self, node: str) -> int:
        """The process of a node.

        Raises:
            DidNotHappen: the node is not alive.
        """
        for pid, name in self.nodes_alive().items():
            if name == node:
                return pid
        raise DidNotHappen(f"no {node} is alive: {self.output}")

    def signal(self, node: str, number: signal.Signals) -> None:
        """Send a signal to a node."""
        os.kill(self.pid_of(node), number)

    def __enter__(self) -> "CellRun":
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        for pid in self.nodes_alive():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self._listener.join(10.0)
        if self.process.stdout is not None:
            self.process.stdout.close()
