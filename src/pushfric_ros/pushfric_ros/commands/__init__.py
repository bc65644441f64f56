"""The commands that need the node graph, a pusher or a camera; they join the command line as an entry point."""

from typing import Any

SECTIONS = {
    "Cell": {
        "demo": "Run the whole node graph on a simulated cell: camera frames, a GRBL controller on a pseudo-terminal,"
        " an operator.",
        "run": "Run the real cell: carry out its push plan, estimate, record.",
        "replay": "Play a bag through the live graph, with the settings it was recorded with;"
        " this gives the estimate of the live run.",
        "doctor": "Check everything that a cell needs, without moving anything, and say what to do about each fault.",
        "security": "Write what the nodes of a cell may do, as a policy for SROS 2: only the experiment may push.",
    },
    "Pusher": {
        "rehearse": "Cause every fault of docs/safety.md on a real controller without an object; measure how the pusher stops.",
        "stop": "Stop the pusher of a running cell; nothing moves before ./pushfric reset.",
        "reset": "After a stop, fault or alarm: home, or if the cell does not home, confirm the reported position.",
        "status": "Print what the pusher of a running cell is doing, where it is, and what is wrong.",
        "echo": "Print the states of the pusher of a running cell as they come, until Ctrl-C.",
        "jog": "Move the pusher of a running cell a little, without a push; it stops when this command ends.",
    },
}
"""The sections of the list of commands: each command's name and the first paragraph of its help; its function's docstring
adds to that."""

COMMANDS = {name: text for section in SECTIONS.values() for name, text in section.items()}

MODULES = dict.fromkeys(("reset", "status", "echo", "jog"), "pusher")
"""Modules of the commands whose name is not that of a module."""

RUN_NODES = ("demo", "run", "replay")
"""Commands that start the nodes of a graph."""


def launched(name: str) -> Any:
    """For `ros2 launch`: the launch description of the graph with this name in `launch_files`."""
    try:
        from pushfric_ros.commands import launch_files
        from pushfric_ros.graph.launch import launch_description
    except (ImportError, AttributeError, TypeError) as error:
        from pushfric_core.commands import dependencies

        dependencies.explain(error)
        raise
    return launch_description(getattr(launch_files, name))


def prepare(name: str) -> None:
    """Called before a command is loaded: what it will need loads at the same time."""
    if name in RUN_NODES:
        from pushfric_ros.graph import fork_server  # not for the other commands

        fork_server.prepare()
