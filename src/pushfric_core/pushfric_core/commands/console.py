"""The lines that every command prints on stderr: warnings, and the one line of a failure."""

import sys
from typing import NoReturn

from rich.console import Console

console = Console(stderr=True, soft_wrap=True)


def warn(line: str) -> None:
    """Print a warning and go on."""
    console.print(f"warning: {line}", highlight=False, markup=False)


def fail(line: str, code: int) -> NoReturn:
    """Print why the command failed, and end with this exit code."""
    console.print(f"error: {line}", highlight=False, markup=False)
    sys.exit(code)
