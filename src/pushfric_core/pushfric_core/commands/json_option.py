"""The options `--json [FILE.json]`, which means the same in every command, and `--ledger [FILE.json]`."""

import pathlib
from collections.abc import Sequence
from typing import Annotated

import typer

from pushfric_core.errors import InvalidInput
from pushfric_core.files.whole_file import make_folder, write_whole

STDOUT = "-"
"""The value of the option if no file is given."""

SUFFIX = ".json"


def spelled_out(arguments: Sequence[str]) -> list[str]:
    """Arguments in which these options have a value: what follows, if that is the name of a JSON file, else STDOUT."""
    pairs = zip(arguments, [*arguments, ""][1:], strict=True)
    options = ("--json", "--ledger")
    return [f"{one}={STDOUT}" if one in options and not after.endswith(SUFFIX) else one for one, after in pairs]


def _checked(where: str | None) -> str | None:
    """Refuse, before any work is done, what cannot be written."""
    if where is None or where == STDOUT:
        return where
    file = pathlib.Path(where)
    if file.suffix != SUFFIX or file.is_dir():
        raise InvalidInput(f"{file}: expected the name of a file to write that ends in {SUFFIX}")
    make_folder(file.parent)
    return where


JsonOption = Annotated[
    str | None,
    typer.Option(
        "--json",
        help="Print only the result, as one JSON object, on stdout; with FILE.json, print as usual and write the object there.",
        metavar="[FILE.json]",
        callback=_checked,
        show_default=False,
    ),
]

LedgerOption = Annotated[
    str | None,
    typer.Option(
        "--ledger",
        help="Print what became of every message, on stderr and in the JSON; with FILE.json, write it there.",
        metavar="[FILE.json]",
        callback=_checked,
        show_default=False,
    ),
]


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
