"""The nodes' executables: they end quietly even on a signal while they are still loading."""

import importlib
import os
import signal
import sys

PARENT = "PUSHFRIC_PARENT"
"""Environment variable with the id of the process that started a node: when that process ends, the node ends, too.

Without it, `ros2 launch` leaves its nodes, and so the pusher, running when it is killed.
"""

PR_SET_PDEATHSIG = 1  # linux/prctl.h

HELP = """\
usage: ros2 run pushfric_ros {}_node [--ros-args [-p PARAMETER:=VALUE] [--params-file FILE] ...]
docs/interfaces.md lists parameters, topics and services; ros2 param describe says more while a node runs."""


def die_with_parent(number: int) -> None:
    """Have the kernel send this process a signal when the one that started it ends, even if that is killed."""
    import ctypes  # late: a signal must not find it half loaded

    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, number)


def main() -> None:
    """Run the node that the executable NAME_node is named after; with --help, say how."""
    # One thread for each process, so that estimates are reproducible to the last bit and no update takes long.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    name = os.path.basename(sys.argv[0]).removesuffix("_node")
    if {"-h", "--help"} & set(sys.argv[1:]):
        importlib.import_module("pushfric_core.commands.program").run(lambda: print(HELP.format(name)))
    for number in (signal.SIGINT, signal.SIGTERM):  # `run_node` replaces these handlers
        signal.signal(number, lambda *_: os._exit(0))
    if parent := os.environ.get(PARENT):
        if not parent.isdecimal():
            print(f"error: {PARENT} must be the id of a process, got {parent[:40]!r}", file=sys.stderr)
            sys.exit(2)
        die_with_parent(signal.SIGTERM)
        if os.getppid() != int(parent):  # the parent has ended already
            sys.exit()
    try:
        importlib.import_module(f"pushfric_ros.nodes.{name}").main()
    except (ImportError, AttributeError, TypeError) as error:
        importlib.import_module("pushfric_core.commands.dependencies").explain(error)
        raise
