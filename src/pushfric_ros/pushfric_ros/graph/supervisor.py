"""Runs the processes of a node graph: starts them, restarts those that may be restarted, and leaves none and no file behind."""

import contextlib
import json
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from ament_index_python.packages import get_package_prefix

from pushfric_ros.graph import fork_server
from pushfric_ros.graph.fork_server import NodeProcess, ServerGone, describe, state_of
from pushfric_ros.graph.graph import PACKAGE, NodeSpec
from pushfric_ros.node_kit.lock import lock
from pushfric_ros.node_kit.visit import enclave

KEEPER = ("/bin/sh", "-c", 'read -r _; rm -rf -- "$1"', "pushfric-scratch")
"""Command that removes the folder named by its last argument once nobody can write to its input any longer."""


@contextlib.contextmanager
def scratch_folder() -> Iterator[pathlib.Path]:
    """A temporary folder for the context; it is removed with this process, even if the process is killed."""
    folder = tempfile.mkdtemp(prefix="pushfric-")
    keeper = subprocess.Popen(
        [*KEEPER, folder],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # out of reach of the terminal's Ctrl-C
    )
    try:
        yield pathlib.Path(folder)
    finally:
        keeper.communicate()


ENDING = ((signal.SIGTERM, 20.0), (signal.SIGKILL, 5.0))
"""The signals that end a process, and how long to wait after each [s]; SIGINT would print a traceback."""

RESPAWN_DELAY = 1.0
"""A node that has died is started again after this long [s]."""

STOPPED = 10.0
"""A node whose process is stopped (SIGSTOP) for this long [s] is killed, and counts as dead; one that hangs ends itself."""

DEATHS, DEATHS_WITHIN = 3, 30.0
"""A node that dies this many times within this time [s] is not started again."""


class Ended(NamedTuple):
    """How a run ended."""

    code: int  # exit code for the command line
    reason: str


class Restarts:
    """Which nodes of a graph are started again when they have ended, and which end the run; for any way to start them."""

    def __init__(self) -> None:
        self._deaths: dict[str, deque[float]] = {}

    def after(self, spec: NodeSpec, code: int) -> Ended | None:
        """How the run ends because a node has ended with an exit code; None: the node is started again."""
        if code == 0 and spec.ends_run:
            return Ended(0, f"{spec.name} has finished")
        if not spec.respawn or code in (0, 2):  # 2: unusable input, with which it would only end again
            return Ended(code if code > 0 else 1, f"{spec.name} {describe(code)}")
        deaths = self._deaths.setdefault(spec.name, deque(maxlen=DEATHS))
        deaths.append(time.monotonic())
        if len(deaths) == DEATHS and deaths[-1] - deaths[0] < DEATHS_WITHIN:
            return Ended(code if code > 0 else 1, f"{spec.name} {describe(code)}, {DEATHS} times within {DEATHS_WITHIN:g} s")
        return None


class Supervisor:
    """The processes of a graph, each in a process group of its own; use it as a context manager and call `poll` often.

    Inside the context, SIGINT and SIGTERM interrupt only `poll`.

    Args:
        specs: the nodes.
        namespace: namespace of all nodes.
        say: called from threads with (node name, line) for each line that a node prints.
    Attributes:
        failed_at_the_end: the first node that was asked to end and ended with an error, such as a recorder that found messages
            missing.
    Raises:
        InvalidInput: on entry, if a cell of this name is already running.
    """

    def __init__(self, specs: Sequence[NodeSpec], namespace: str, say: Callable[[str, str], None]) -> None:
        self._specs, self._namespace, self._say = list(specs), namespace, say
        self._processes: dict[str, NodeProcess] = {}
        self._listeners: list[threading.Thread] = []
        self._due: dict[str, float] = {}  # when a node is started again
        self._restarts = Restarts()
        self._stopped: dict[str, float] = {}  # since when a node's process stands still
        self._interrupted = False
        self.failed_at_the_end: Ended | None = None
        self._leaving = contextlib.ExitStack()  # undoes what was done on entry, in reverse order

    def __enter__(self) -> "Supervisor":
        with self._leaving as leaving:
            # set a flag for `poll`, because an exception could strike anywhere, even in a fork
            for caught in (signal.SIGINT, signal.SIGTERM):
                leaving.callback(signal.signal, caught, signal.signal(caught, self._on_signal))
            self._claim = leaving.enter_context(lock(self._namespace))
            self._folder = leaving.enter_context(scratch_folder())
            self._server = leaving.enter_context(contextlib.closing(fork_server.prepared()))
            leaving.callback(self.end)
            while not self._server.ready(0.1):
                if self._interrupted:
                    raise KeyboardInterrupt
            for spec in self._specs:
                self._start(spec)
            self._leaving = leaving.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._leaving.close()

    @property
    def processes(self) -> dict[str, int]:
        """The process ids of the nodes that run."""
        return {name: process.pid for name, process in self._processes.items() if process.returncode is None}

    def poll(self) -> Ended | None:
        """Restart processes that have died; return how the run ended, once it has.

        Raises:
            KeyboardInterrupt: SIGINT or SIGTERM came since the start.
        """
        if self._interrupted:
            raise KeyboardInterrupt
        try:
            self._server.check()
            return self._restart()
        except ServerGone as error:
            return Ended(1, str(error))

    def _restart(self) -> Ended | None:
        for spec in self._specs:
            code = self._processes[spec.name].returncode
            if code is None:
                self._end_if_stopped(spec.name)
                continue
            if spec.name in self._due:
                if time.monotonic() >= self._due[spec.name]:
                    del self._due[spec.name]
                    self._start(spec)
            elif (ended := self._restarts.after(spec, code)) is not None:
                return ended
            else:
                self._say("supervisor", f"{spec.name} {describe(code)}; starting it again")
                self._due[spec.name] = time.monotonic() + RESPAWN_DELAY
        return None

    def _end_if_stopped(self, name: str) -> None:
        process = self._processes[name]
        if state_of(process.pid) != "T":
            self._stopped.pop(name, None)
        elif time.monotonic() - self._stopped.setdefault(name, time.monotonic()) > STOPPED:
            self._say("supervisor", f"{name} was stopped (SIGSTOP) for {STOPPED:g} s and is ended")
            with contextlib.suppress(ProcessLookupError):
                os.kill(process.pid, signal.SIGKILL)

    def end(self, but: str = "") -> None:
        """End all processes, the first one last, because the others may depend on it; the one named `but` runs on."""
        started = [self._processes[spec.name] for spec in self._specs if spec.name in self._processes and spec.name != but]
        for processes in (started[1:], started[:1]):
            _end(processes)
        for listener in [] if but else self._listeners:
            listener.join(1.0)
        codes = ((spec.name, self._processes[spec.name].returncode) for spec in self._specs if spec.name in self._processes)
        failed = (Ended(code, f"{name} {describe(code)}") for name, code in codes if code is not None and code > 0)
        self.failed_at_the_end = next(failed, None)

    def _on_signal(self, *_: Any) -> None:
        self._interrupted = True

    def _start(self, spec: NodeSpec) -> None:
        process = self._server.start(command(spec, self._namespace, self._folder), spec.environment, self._claim)
        self._processes[spec.name] = process
        listener = threading.Thread(target=self._listen, args=(spec.name, process), daemon=True)
        listener.start()
        self._listeners.append(listener)

    def _listen(self, name: str, process: NodeProcess) -> None:
        with process.output as lines:
            for line in lines:
                self._say(name, line.rstrip())


def _end(processes: Sequence[NodeProcess]) -> None:
    """End processes: ask each first, and kill it as a last resort."""
    for number, seconds in ENDING:
        alive = [process for process in processes if process.running]
        for process in alive:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, number)
        deadline = time.monotonic() + seconds
        for process in alive:
            process.wait(max(0.0, deadline - time.monotonic()))


def command(spec: NodeSpec, namespace: str, folder: pathlib.Path) -> list[str]:
    """The command line of a node; writes its parameters to a file in `folder`."""
    parameters = folder / f"{spec.name}.yaml"
    # JSON is YAML without aliases, which rcl does not read
    parameters.write_text(json.dumps({"/**": {"ros__parameters": dict(spec.parameters)}}))
    executable = pathlib.Path(get_package_prefix(PACKAGE)) / "lib" / PACKAGE / spec.executable
    remaps = [f"__node:={spec.name}", f"__ns:={namespace}", *(f"{name}:={other}" for name, other in spec.remappings.items())]
    return [
        sys.executable,
        str(executable),
        "--ros-args",
        *(part for remap in remaps for part in ("-r", remap)),
        "--enclave",
        enclave(namespace, spec.name),
        "--params-file",
        str(parameters),
    ]
