"""Tables in Markdown, and the marks of a page between which they are written."""

import re
from collections.abc import Iterable

from pushfric_core import InvalidInput


def table(head: Iterable[object], rows: Iterable[Iterable[object]]) -> str:
    """A table in Markdown, with a line break at its end; columns that are empty in every row are left out."""
    filled = [column for column in zip(head, *rows, strict=True) if any(column[1:])]
    first, *others = (" | ".join(str(cell).replace("|", "\\|") for cell in line) for line in zip(*filled, strict=True))
    return "\n".join((f"| {first} |", "|---" * len(filled) + "|", *(f"| {line} |" for line in others), ""))


def replaced(document: str, begin: str, end: str, text: str) -> str:
    """The document with another text between these two marks.

    Raises:
        InvalidInput: it does not hold both marks, each once.
    """
    parts = re.split(f"({re.escape(begin)}|{re.escape(end)})", document)
    if parts[1::2] != [begin, end]:
        raise InvalidInput(f"expected the lines {begin.strip()} and {end.strip()}, each once")
    return "".join((*parts[:2], text, *parts[3:]))
