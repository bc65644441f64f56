"""Tables in the generated documents, and how the settings stand in them."""

import math
from collections.abc import Sequence
from typing import Any

import yaml


def table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    """A table in Markdown, with a line break at its end; columns that are empty in every row are left out."""
    filled = [column for column in zip(head, *rows, strict=True) if any(column[1:])]
    first, *others = (
        f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |\n" for line in zip(*filled, strict=True)
    )
    return "".join((first, f"{'|---' * len(filled)}|\n", *others))


def as_yaml(value: Any) -> str:
    """A value as it stands in one line of YAML."""
    return yaml.safe_dump(value, default_flow_style=True, width=math.inf).removesuffix("...\n").rstrip()


def limits(*ends: float | None) -> str:
    """A range, as 0 to 1; any if it has no such end."""
    return " to ".join("any" if end is None else str(end) if isinstance(end, int) else f"{end:g}" for end in ends)
