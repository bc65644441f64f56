"""How the process of a node starts: forked from a server that has imported what nodes need, once for all of them.

Six interpreters that import the same libraries take seconds of CPU time, and hold them in memory six times. The server is a
process of its own because one with threads, such as the command line, cannot be forked safely: a thread that does not exist
in the new process may have held a lock. It runs in a session of its own, out of reach of the terminal's Ctrl-C. It dies with
the command line, and the nodes die with it.
"""

import contextlib
import gc
import importlib
import json
import os
import pathlib
import runpy
import select
import selectors
import signal
import socket
import subprocess
import sys
import time
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

from pushfric_core.errors import PushfricError
from pushfric_ros.node_kit.executable import die_with_parent

PRELOADED = (
    "pushfric_ros.node_kit.executable",
    "pushfric_ros.node_kit.process",
    "pushfric_ros.node_kit.diagnostics",
    "pushfric_ros.node_kit.parameters",
    "pushfric_core.files.object_file",
    "pushfric_core.cell.node_settings",
    "pushfric_ros.messages.conversions",
    "numpy.ma",  # which np.median loads when it is first called
)
"""Modules that the server imports because several nodes need them.

It must start no threads. The one exception is LTTng's, if rclpy is built with it: they wait for a tracing daemon, and hold no
lock that a node takes.
"""

LONGEST = 1 << 16
"""Largest size of a request or report [bytes]."""

ROOM = 512
"""The name of a process is written over the arguments that it was started with, so these must be this long [bytes]."""

END_TIMEOUT = 2.0
"""How long the server may take to end after its last request [s]."""


class ServerGone(PushfricError):
    """The server has ended, and its nodes have been asked to."""


class NodeProcess:
    """A process that the server has forked, in a process group of its own.

    Attributes:
        pid: of the process, and of its group.
        output: what it prints to stdout and stderr.
        returncode: exit code; negative: the signal that killed the process; None: it has not ended, or its end is unknown.
    """

    def __init__(self, server: "ForkServer", pid: int, output: int) -> None:
        self._server = server
        self.pid, self.output = pid, os.fdopen(output, errors="replace")
        self.returncode: int | None = None

    @property
    def running(self) -> bool:
        """Whether the process has not ended yet."""
        self._server.listen()
        return self.returncode is None and (not self._server.gone or state_of(self.pid) not in "ZX")

    def wait(self, seconds: float) -> None:
        """Wait for the end of the process, for at most this long [s]."""
        deadline = time.monotonic() + seconds
        while self.running and (left := deadline - time.monotonic()) > 0:
            if self._server.gone:
                time.sleep(0.01)
            else:
                self._server.listen(left)


class ForkServer:
    """The command line's side of the server. It is ready when it has imported everything; wait for that before `start`."""

    def __init__(self) -> None:
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._processes: dict[int, NodeProcess] = {}
        self._output = -1  # where the process that was asked for last writes
        self._started: NodeProcess | None = None  # that process, once the server has reported it
        self._ready = self.gone = False
        with theirs:
            self._server = subprocess.Popen(
                [sys.executable, "-m", __name__, str(theirs.fileno()), *PRELOADED, " " * ROOM],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                start_new_session=True,
            )

    @property
    def pid(self) -> int:
        """Process id of the server."""
        return self._server.pid

    def ready(self, seconds: float) -> bool:
        """Wait until the server can fork, for at most this long [s]; return whether it can.

        Raises:
            ServerGone: the server has ended.
        """
        if not self._ready:
            self.listen(seconds)
        self.check()
        return self._ready

    def check(self) -> None:
        """Take in what the server has reported.

        Raises:
            ServerGone: the server has ended.
        """
        self.listen()
        if self.gone:
            raise ServerGone(f"the process that starts the nodes {describe(self._server.wait())}")

    def start(self, arguments: Sequence[str], environment: Mapping[str, str], held: int | None = None) -> NodeProcess:
        """Start a process that runs a Python script.

        Args:
            arguments: the interpreter, the script and its arguments, as they would start the process without a server.
            environment: variables of the process in addition to those of the server.
            held: a file descriptor that the process holds, too, until it ends.
        Raises:
            ServerGone: the server has ended.
        """
        self.check()
        self._started = None
        self._output, write = os.pipe()
        request = json.dumps({"arguments": list(arguments), "environment": dict(environment)})
        with contextlib.suppress(ConnectionError):  # the server has gone; `listen` notices that, too
            socket.send_fds(self._socket, [request.encode()], [write, *([] if held is None else [held])])
        os.close(write)
        while self._started is None and not self.gone:
            self.listen(1.0)
        if self._started is None:
            os.close(self._output)
            self.check()
        assert self._started is not None
        return self._started

    def listen(self, seconds: float = 0.0) -> None:
        """Take in what the server has reported, and wait for a report for at most this long [s]."""
        while not self.gone and select.select([self._socket], [], [], seconds)[0]:
            try:
                report = self._socket.recv(LONGEST)
            except ConnectionError:
                report = b""
            if report:
                self._take(**json.loads(report))
            else:
                self.gone = True
            seconds = 0.0

    def close(self) -> None:
        """End the server; processes that still run are asked to end."""
        self._socket.close()
        self.gone = True
        try:
            self._server.wait(END_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._server.kill()
            self._server.wait()

    def _take(self, ready: bool = False, started: int | None = None, ended: int | None = None, code: int = 0) -> None:
        self._ready |= ready
        if started is not None:  # here, because its end may be the next report
            self._started = self._processes[started] = NodeProcess(self, started, self._output)
        if ended in self._processes:
            self._processes.pop(ended).returncode = code


def state_of(pid: int) -> str:
    """The state of a process, which follows the command's name in proc_pid_stat(5): T, stopped; Z or X, it has ended."""
    try:
        return pathlib.Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:  # it has ended, or this is not Linux
        return "X"


def describe(code: int) -> str:
    """How a process ended, in words."""
    if code == -signal.SIGALRM:
        return "hung and was ended by SIGALRM"
    if code < 0:
        return f"was killed by {signal.Signals(-code).name}"
    return f"ended with exit code {code}"


_prepared: list[ForkServer] = []


def prepare() -> None:
    """Start a server before it is needed, so that it imports while this process is still busy with its own imports."""
    if not _prepared:
        _prepared.append(ForkServer())


def prepared() -> ForkServer:
    """The server that `prepare` started, or else a new one; the caller closes it."""
    return _prepared.pop() if _prepared else ForkServer()


# From here on: the server itself.


def main() -> None:
    """Run the server: `python3 -m pushfric_ros.graph.fork_server SOCKET MODULE... ROOM`."""
    die_with_parent(signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # further threads would be threads of the server
    os.environ["SPT_NOENV"] = "1"  # setproctitle leaves the environment as it is, for those who look at it in /proc
    # of threads, as Python 3.12 does: see PRELOADED
    warnings.filterwarnings("ignore", category=DeprecationWarning, module=__name__)
    gc.disable()
    preload(sys.argv[2:-1])
    gc.freeze()  # a collection would write to every object, and so copy the memory that nodes share
    with socket.socket(fileno=int(sys.argv[1])) as commands:
        request, output = _serve(commands)
    _run_node(output, **request)


def preload(modules: Sequence[str]) -> None:
    """Import modules, and all that nodes load late."""
    for name in modules:
        importlib.import_module(name)
    from pushfric_ros.node_kit.process import load_early  # not above: it loads rclpy

    load_early()


def _serve(commands: socket.socket) -> tuple[dict[str, Any], int]:
    """Fork a process for each request, and report its end. Only the new process returns from here.

    Returns:
        What the process is to run, and the file descriptor of its output; what it is to hold just stays open.
    """
    with selectors.DefaultSelector() as selector:
        selector.register(commands, selectors.EVENT_READ)
        _report(commands, ready=True)
        while True:
            for ready, _ in selector.select():
                if pid := ready.data:  # it has ended
                    selector.unregister(ready.fd)
                    os.close(ready.fd)
                    _report(commands, ended=pid, code=os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
                    continue
                request, files = _receive(commands)
                if (pid := os.fork()) == 0:
                    for other in selector.get_map().values():
                        if other.data:
                            os.close(other.fd)
                    return request, files[0]
                os.setpgid(pid, pid)
                for file in files:
                    os.close(file)
                selector.register(os.pidfd_open(pid), selectors.EVENT_READ, pid)
                _report(commands, started=pid)


def _receive(commands: socket.socket) -> tuple[dict[str, Any], list[int]]:
    """The program of a process, the file descriptor of its output, and that of what it holds, if there is one.

    Ends the server if the command line has gone.
    """
    with contextlib.suppress(ConnectionError):
        request, (*files,), *_ = socket.recv_fds(commands, LONGEST, 2)
        if request:
            return json.loads(request), files
    os._exit(0)


def _report(commands: socket.socket, **what: Any) -> None:
    with contextlib.suppress(ConnectionError):  # the command line has gone; the next request says so
        commands.send(json.dumps(what).encode())


def _run_node(output: int, arguments: list[str], environment: Mapping[str, str]) -> None:
    """Become what `arguments` would have started."""
    # until the node takes its signals over, there is nothing to wind up: it ends at once, and without a traceback
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    die_with_parent(signal.SIGTERM)
    for stream in (1, 2):
        os.dup2(output, stream)
    os.close(output)
    os.environ.update(environment)
    import setproctitle  # reads the environment

    setproctitle.setproctitle(" ".join(arguments))
    gc.enable()
    sys.argv = arguments[1:]
    runpy.run_path(sys.argv[0], run_name="__main__")


if __name__ == "__main__":
    main()
