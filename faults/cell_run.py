"""A cell that runs in a process of its own, as its user starts it, with its output and its nodes."""

import contextlib
import pathlib
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator

from pushfric_ros.faults.fault import EndedEarly, Otherwise
from pushfric_ros.faults.processes import PROGRAM, end_nodes, nodes_alive, started

STANDSTILL = 300.0
"""A run that prints nothing for this long does nothing more [s]."""

ROOT = pathlib.Path(__file__).resolve().parents[1]
PLAN = "pushes: [{edge: 0}, {edge: 1, offset: 0.01}, {edge: 2}, {edge: 3}]"


@contextlib.contextmanager
def new_run() -> Iterator["CellRun"]:
    """A run in a folder of its own, which a fault has yet to start."""
    with tempfile.TemporaryDirectory(prefix="pushfric-faults-") as folder, CellRun(pathlib.Path(folder)) as run:
        yield run


class CellRun(contextlib.ExitStack):
    """A command that runs a cell; a context manager that leaves no process behind.

    Attributes:
        bag: where the run makes its bag.
        plan: file with a plan of four pushes.
    """

    process: "subprocess.Popen[str]"

    def __init__(self, folder: pathlib.Path) -> None:
        """The name of the folder must be unique, as it marks the run's processes."""
        super().__init__()
        self.folder, self.bag, self.plan = folder, folder / "bag", folder / "plan.yaml"
        self.plan.write_text(PLAN)
        self._lines: list[str] = []

    def demo(self, short: bool = False, through: str = "") -> None:
        """Start a demo, with a plan of four pushes if `short`; `through` is a module of this folder that runs the command."""
        options = ("--plan", str(self.plan)) if short else ()
        runner = (sys.executable, "-m", through) if through else ()
        self.start(*runner, *PROGRAM, "demo", "--headless", "--bag", str(self.bag), *options)

    def start(self, *command: str) -> None:
        """Start a command."""
        self.process = process = started(command, self.folder, cwd=ROOT)
        self._listener = threading.Thread(target=self._listen, args=(process.stdout,))
        self._listener.start()
        self.callback(self._end, process)

    def _listen(self, said: Iterator[str]) -> None:
        with contextlib.suppress(ValueError):  # a fault may be that nobody reads any more
            self._lines.extend(said)

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
        """Wait until a predicate holds, for as long as the run says anything, however slow the machine is.

        Raises:
            Otherwise: the run has printed nothing for STANDSTILL.
        """
        printed, since = -1, 0.0
        while not predicate():
            if len(self._lines) > printed:
                printed, since = len(self._lines), time.monotonic()
            if time.monotonic() - since > STANDSTILL:
                raise Otherwise(f"{what} did not come, and nothing was said for {STANDSTILL:.0f} s, only: {self.output}")
            time.sleep(0.05)

    def wait_for_push(self) -> None:
        """Wait until the first push is over and the second under way.

        Raises:
            EndedEarly: the run has ended.
        """
        self.wait_for(lambda: self.ended or "\npush" in self.output, "the first push")
        if self.ended:
            raise EndedEarly(f"the run ended before the fault: {self.output}")

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
        return nodes_alive(self.folder)

    def _end(self, process: "subprocess.Popen[str]") -> None:
        process.kill()
        process.wait()
        end_nodes(self.folder)
        self._listener.join(10.0)
        process.stdout.close()
