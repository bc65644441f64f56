"""The results as tables."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from rich.box import SIMPLE
from rich.table import Column, Table

Figures = dict[str, Any]


class Verdict(NamedTuple):
    """One target; if it was not measured, it is not met."""

    target: str
    asked: str
    measured: float | None
    met: bool

    @classmethod
    def at_most(cls, target: str, limit: float, measured: float) -> "Verdict":
        return cls(target, f"<= {limit:g}", measured, measured <= limit)

    def row(self) -> Figures:
        """As a line of a table."""
        mark = "not measured" if self.measured is None else "[green]met[/]" if self.met else "[red]missed[/]"
        return {"target": self.target, "asked": self.asked, "measured": self.measured, "": mark}


def plain_tables(title: str, figures: Figures | list[Figures]) -> Iterator[Table]:
    """Figures of any kind: a table for each list of rows, and one with a line for each other figure."""
    if isinstance(figures, list):
        flat = [_flattened(row) for row in figures]
        keys = list(dict.fromkeys(key for row in flat for key in row))
        table = Table(*(Column(key, overflow="fold") for key in keys), title=title, box=SIMPLE, pad_edge=False)
        for row in flat:
            table.add_row(*(_text(row.get(key)) for key in keys))
        yield table
        return
    lists = {key: value for key, value in figures.items() if isinstance(value, list)}
    if rest := _flattened({key: value for key, value in figures.items() if key not in lists}):
        yield from plain_tables(title, [{"figure": key, "measured": value} for key, value in rest.items()])
    for key, rows in lists.items():
        yield from plain_tables(f"{title}: {key}", rows)


def _flattened(figures: Figures, before: str = "") -> Figures:
    """Nested figures by the words of all their keys."""
    flat: Figures = {}
    for key, value in figures.items():
        flat |= _flattened(value, f"{before}{key} ") if isinstance(value, dict) else {f"{before}{key}": value}
    return flat


def _text(value: Any) -> str:
    """Of a number at least three digits, without an exponent."""
    if isinstance(value, list):
        return ", ".join(map(_text, value))
    if isinstance(value, float):
        return f"{value:.0f}" if value >= 100 else f"{value:.3g}"
    return "-" if value is None else str(value)
