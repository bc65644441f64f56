"""The results as tables."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

from rich.table import Table

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


def verdict_table(verdicts: Iterable[Verdict]) -> Table:
    table = Table(title="Targets")
    for heading in ("target", "asked", "measured", ""):
        table.add_column(heading, justify="left" if heading == "target" else "right")
    for target, asked, measured, met in verdicts:
        mark = "[green]met[/]" if met else "[red]missed[/]"
        table.add_row(target, asked, *(("-", "not measured") if measured is None else (short(measured), mark)))
    return table


def plain_tables(title: str, figures: Figures | list[Figures]) -> Iterator[Table]:
    """Figures of any kind: a table for each list of rows, and one with a line for each other figure."""
    if isinstance(figures, list):
        flat = [_flattened(row) for row in figures]
        keys = list(dict.fromkeys(key for row in flat for key in row))
        table = Table(*keys, title=title)
        for row in flat:
            table.add_row(*(_text(row.get(key)) for key in keys))
        yield table
        return
    lists = {key for key, value in figures.items() if isinstance(value, list)}
    if lists < figures.keys():
        table = Table("figure", "measured", title=title)
        for key, value in _flattened({key: value for key, value in figures.items() if key not in lists}).items():
            table.add_row(key, _text(value))
        yield table
    for key in figures:
        if key in lists:
            yield from plain_tables(f"{title}: {key}", figures[key])


def pivot_table(
    title: str, rows: Iterable[Figures], across: str, value: str, **summaries: Callable[[list[float]], Any]
) -> Table:
    """A column for each `across` that holds `value`, and a line for each combination of all other keys.

    Args:
        title: of the table.
        rows: each with the same keys.
        across: a key.
        value: a key.
        summaries: further columns, each a function of the values of a line.
    """
    lines: dict[tuple[tuple[str, str], ...], dict[str, float]] = {}
    for row in rows:
        rest = tuple((key, str(one)) for key, one in row.items() if key not in (across, value))
        lines.setdefault(rest, {})[str(row[across])] = row[value]
    columns = list(dict.fromkeys(column for values in lines.values() for column in values))
    table = Table(*(key for key, _ in next(iter(lines), ())), *columns, *summaries, title=title)
    for rest, values in lines.items():
        cells = [*(values.get(column) for column in columns), *(of(list(values.values())) for of in summaries.values())]
        table.add_row(*(one for _, one in rest), *map(_text, cells))
    return table


def _flattened(figures: Figures, before: str = "") -> Figures:
    """Nested figures by the words of all their keys."""
    flat: Figures = {}
    for key, value in figures.items():
        flat |= _flattened(value, f"{before}{key} ") if isinstance(value, dict) else {f"{before}{key}": value}
    return flat


def _text(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(_text, value))
    if value is None:
        return "-"
    return short(value) if isinstance(value, float) else str(value)


def short(value: float) -> str:
    """At least three digits, without an exponent."""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"
