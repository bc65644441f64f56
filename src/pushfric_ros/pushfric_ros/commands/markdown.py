"""Tables in the generated documents, and how the settings stand in them."""

import math
import re
from collections.abc import Sequence
from typing import Any

import yaml

from pushfric_core.errors import InvalidInput


def table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    """A table in Markdown, with a line break at its end; columns that are empty in every row are left out."""
    filled = [column for column in zip(head, *rows, strict=True) if any(column[1:])]
    first, *others = (
        f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |\n" for line in zip(*filled, strict=True)
    )
    return "".join((first, f"{'|---' * len(filled)}|\n", *others))


def replaced(document: str, begin: str, end: str, text: str) -> str:
    """The document with another text between these two marks.

    Raises:
        InvalidInput: it does not hold both marks, each once.
    """
    parts = re.split(f"({re.escape(begin)}|{re.escape(end)})", document)
    if parts[1::2] != [begin, end]:
        raise InvalidInput(f"expected the lines {begin.strip()} and {end.strip()}, each once")
    return "".join((*parts[:2], text, *parts[3:]))


def as_yaml(value: Any) -> str:
    """A value as it stands in one line of YAML."""
    return yaml.safe_dump(value, default_flow_style=True, width=math.inf).removesuffix("...\n").rstrip()


def limits(*ends: float | None) -> str:
    """A range, as 0 to 1; any if it has no such end."""
    return " to ".join("any" if end is None else str(end) if isinstance(end, int) else f"{end:g}" for end in ends)
