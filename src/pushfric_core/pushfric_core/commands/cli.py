"""The command line. Commands are in the modules of packages of commands; a module is loaded only when a command is called.

This package has the commands that need no node graph. Others join by an entry point of the group `pushfric.commands`, a module
with `SECTIONS`, `COMMANDS` and perhaps `MODULES` as here, and `prepare`, which is called with a command's name before the
command is loaded.
"""

import functools
import importlib
import importlib.metadata
import os
import sys
from types import ModuleType
from typing import Annotated, Any

import typer
import typer.main

import pushfric_core
from pushfric_core import commands
from pushfric_core.commands.application import HELP, Application, Group, PlainCommand, UsageError, complaint
from pushfric_core.commands.console import fail
from pushfric_core.commands.program import undoing
from pushfric_core.errors import InvalidInput, MissingPackage, PushfricError

GROUP = "pushfric.commands"


class Commands(Group):
    """Lists the commands without loading them."""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(catalog())

    def sections(self, ctx: Any) -> dict[str, tuple[str, ...]]:
        return {title: tuple(section) for package in packages() for title, section in package.SECTIONS.items()}

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        if len(packages()) == 1:
            formatter.write_paragraph()
            formatter.write_text("The commands that run a robot cell, such as demo, come with the package pushfric_ros.")

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """A command as the list shows it; None if there is no such command."""
        package = package_of(cmd_name)
        return None if package is None else PlainCommand(cmd_name, help=package.COMMANDS[cmd_name])

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name, command, rest = super().resolve_command(ctx, args)  # refuses a name that is not in the list
        if name is None:  # a shell completes an unknown command
            return name, command, rest
        package = package_of(name)
        if package is not commands and package is not None and not (ctx.resilient_parsing or {*HELP} & {*rest}):
            package.prepare(name)
        return name, load(name), rest


@functools.cache
def packages() -> list[ModuleType]:
    """The packages of commands: those that need a node graph, where they are installed, and this one."""
    return [*(entry.load() for entry in importlib.metadata.entry_points(group=GROUP)), commands]


def catalog() -> dict[str, str]:
    """Every command and the first paragraph of its help."""
    return {name: text for package in packages() for name, text in package.COMMANDS.items()}


def package_of(name: str) -> ModuleType | None:
    """The package of a command; None if there is no such command."""
    if name in commands.COMMANDS:  # at once: entry points are found by reading the metadata of every installed package
        return commands
    return next((package for package in packages() if name in package.COMMANDS), None)


def load(name: str) -> Any:
    """A command with its options, from its module.

    Raises:
        InvalidInput: there is no such command.
    """
    package = package_of(name)
    if package is None:
        raise InvalidInput(f"no such command {name!r}")
    module = importlib.import_module(f"{package.__name__}.{getattr(package, 'MODULES', {}).get(name, name)}")
    command = typer.main.get_command(module.app)
    command = getattr(command, "commands", {}).get(name, command)
    for one in (command, *getattr(command, "commands", {}).values()):
        one.callback = one.callback and undoing(one.callback)
    command.name, command.help = name, "\n\n".join(filter(None, (package.COMMANDS[name], command.help)))
    return command


app = Application(
    cls=Commands,
    pretty_exceptions_enable=False,
    add_completion=True,
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


def main(program: typer.Typer = app, name: str = "pushfric") -> None:
    """Entry point, of another program too. Unusable input ends with one line and exit code 2."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # the search for some reads the metadata of every package
    try:
        sys.exit(program(prog_name=name, standalone_mode=False))
    except UsageError as error:
        fail(complaint(error), 2)
    except (InvalidInput, MissingPackage) as error:
        fail(str(error), 2)
    except PushfricError as error:
        fail(str(error), 1)
    except OSError as error:
        if error.filename is None:
            raise
        fail(f"{error.filename}: {error.strerror}", 2)  # such as a name that is too long
    except (KeyboardInterrupt, typer.Abort):
        sys.exit(130)
