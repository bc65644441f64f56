"""What the executables of the nodes run: they end quietly even if they are told to while they are still loading."""

import importlib
import os
import signal
import sys


def main() -> None:
    """Run the node that the executable or module is named after, NAME_node or NAME.py; with --help, describe it."""
    # One thread for each process, so that estimates are reproducible to the last bit and no update takes long.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    name = os.path.basename(sys.argv[0]).removesuffix(".py").removesuffix("_node")
    for number in (signal.SIGINT, signal.SIGTERM):  # `run_node` replaces these handlers
        signal.signal(number, lambda *_: os._exit(0))
    if {"-h", "--help"} & set(sys.argv[1:]):
        importlib.import_module("pushfric_ros.commands.node_help").print_help(name)
        sys.exit()
    importlib.import_module(f"pushfric_ros.nodes.{name}").main()
