"""The lines that every command prints on stderr: what it does, warnings, and the one line of a failure."""

import sys
from typing import NoReturn

from rich.console import Console

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
