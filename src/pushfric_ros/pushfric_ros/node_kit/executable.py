"""What the executables of the nodes run: they end quietly even if they are told to while they are still loading."""

import importlib
import os
import signal
import sys


def main() -> None:
    """Run the node that the executable is named after, NAME_node."""
    name = os.path.basename(sys.argv[0]).removesuffix("_node")
    for number in (signal.SIGINT, signal.SIGTERM):  # `run_node` replaces these handlers
        signal.signal(number, lambda *_: os._exit(0))
    importlib.import_module(f"pushfric_ros.nodes.{name}").main()
