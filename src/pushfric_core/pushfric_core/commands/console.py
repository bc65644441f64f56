"""Output of every command: on stderr what it does, warnings, and the one line of a failure; on stdout or in a file, JSON."""

import pathlib
import sys
from typing import NoReturn

from rich.console import Console

from pushfric_core.commands.application import STDOUT
from pushfric_core.files.disk import write_whole

console = Console(stderr=True, soft_wrap=True)


def say(line: str) -> None:
    """Print a line as it is."""
    console.print(line, highlight=False, markup=False)


def warn(line: str) -> None:
    """Print a warning and go on."""
    say(f"warning: {line}")


def fail(line: str, code: int) -> NoReturn:
    """Print why the command failed, and end with this exit code."""
    say(f"error: {line}")
    sys.exit(code)


def write_json(text: str, where: str | None) -> None:
    """Print or write a result, if asked to.

    Args:
        text: the JSON.
        where: value of the option.
    Raises:
        InvalidInput: the file cannot be written.
    """
    if where == STDOUT:
        print(text, flush=True)
    elif where is not None:
        write_whole(pathlib.Path(where), f"{text}\n")
