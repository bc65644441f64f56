"""The command line. Each command is a module of this folder, which is loaded only when the command is called."""

import importlib
import os
import sys
from typing import Annotated, Any

import typer
import typer.core
import typer.main

import pushfric_core
from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_ros.commands.console import fail
from pushfric_ros.commands.group import Group
from pushfric_ros.commands.json_option import spelled_out
from pushfric_ros.graph import fork_server

COMMANDS = {
    "demo": "Run the whole node graph on a simulated cell: camera frames, a GRBL controller on a pseudo-terminal, an operator.",
    "run": "Run the real cell: carry out its push plan, estimate, record.",
    "replay": "Play a bag through the live graph, with the settings it was recorded with; this gives the estimate of the live"
    " run.",
    "estimate": "Estimate from a bag or a CSV, as fast as possible.",
    "recognize": "Rank the hypotheses in the object's file by how well they explain the data (section 5.2).",
    "predict": "Predict where pushes with a point take the object: its twist, whether the tip sticks or slides, the spread.",
    "stable": "Say which pushes with an edge or two fingers hold the object while they turn it about a centre.",
    "region": "Say where p_CF can lie, without support points (section 6.2), and which pushes would narrow it down.",
    "reproduce": "Reproduce the paper's tables and figures from simulated pushes: report.html, tables.json, images.",
    "study": "Measure how far the estimates can be relied on, with simulated pushes of many seeds and with real ones.",
    "doctor": "Check everything that a cell needs, without moving anything, and say what to do about each fault.",
    "security": "Write what the nodes of a cell may do, as a policy for SROS 2: only the experiment may push.",
    "rehearse": "Cause every fault of docs/safety.md on a real controller without an object; measure how the pusher stops.",
    "calibrate": "Calibrate the camera: print a board, then calibrate the lens, then the table.",
    "measure": "Measure the object and the pushing line with the cell's camera; write object.yaml and the pusher's entries.",
    "bag": "Check and recover bags.",
    "stop": "Stop the pusher of a running cell; nothing moves before ./pushfric reset.",
    "reset": "After a stop, fault or alarm: home, or if the cell does not home, confirm the reported position.",
    "status": "Print what the pusher of a running cell is doing, where it is, and what is wrong.",
    "echo": "Print the states of the pusher of a running cell as they come, until Ctrl-C.",
    "jog": "Move the pusher of a running cell a little, without a push; it stops when this command ends.",
    "import": "Turn a public data set of real pushes into bags of observations, each with its object.yaml.",
}
"""Each command's name and the first paragraph of its help; the docstring of its function adds to that."""

MODULES = {"import": "import_"}
"""Modules of the commands whose own name cannot be that of a module."""

RUN_NODES = ("demo", "run", "replay")
"""Commands that start the nodes of a graph."""

UsageError: type[Exception] = typer.BadParameter.__bases__[0]  # typer does not export it
"""A command line that names no known command or option, or gives a value of the wrong kind."""


class Commands(Group):
    """Lists the commands without loading them."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, spelled_out(args))

    def list_commands(self, ctx: Any) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """A command as the list shows it; None if there is no such command."""
        return (
            typer.core.TyperCommand(cmd_name, help=COMMANDS[cmd_name], rich_markup_mode=None) if cmd_name in COMMANDS else None
        )

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name, _, rest = super().resolve_command(ctx, args)  # refuses a name that is not in the list
        if name in RUN_NODES and "--help" not in rest:
            fork_server.prepare()  # it loads while the command loads
        return name, load(str(name)), rest


def load(name: str) -> Any:
    """A command with its options, from its module."""
    module = importlib.import_module(f"pushfric_ros.commands.{MODULES.get(name, name)}")
    command = typer.main.get_command(module.app)
    for one in (command, *getattr(command, "commands", {}).values()):
        one.rich_markup_mode = None  # plain help: no option's name is cut short, however narrow the terminal
    command.name, command.help = name, "\n\n".join(filter(None, (COMMANDS[name], command.help)))
    return command


app = typer.Typer(
    cls=Commands,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,
    help="Push an object a few times; learn its support friction, its centre of friction and the pusher's contact friction.",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"pushfric {pushfric_core.__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Makes `app` a group."""


def main() -> None:
    """Entry point. Unusable input ends with one line and exit code 2."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # the search for some reads the metadata of every package
    try:
        sys.exit(app(prog_name="pushfric", standalone_mode=False))
    except UsageError as error:
        fail(f"{error.format_message().rstrip('.')}; see pushfric --help", 2)  # type: ignore[attr-defined]
    except InvalidInput as error:
        fail(str(error), 2)
    except PushfricError as error:
        fail(str(error), 1)
    except (KeyboardInterrupt, typer.Abort):
        sys.exit(130)
