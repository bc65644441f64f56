"""Writes the tables of docs/cell.md: every key of a cell's file, from the settings classes themselves."""

import pathlib
import sys
import typing
from collections.abc import Iterable
from typing import Any

from pushfric_core import settings
from pushfric_core.cell.cell_file import ROOT, SECTIONS, driver_kinds
from pushfric_core.cell.plugins import PUSHERS, plugin
from pushfric_ros.arms.arm import ArmConfig
from pushfric_ros.commands.markdown import as_yaml, limits, replaced, table

COMMAND = "python -m pushfric_ros.commands.cell_docs docs/cell.md"

BEGIN = f"<!-- The tables below are written by `{COMMAND}`. -->\n"
END = "<!-- End of these tables. -->\n"

HEAD = ("key", "type", "default", "what")

TYPES = {bool: "boolean", int: "integer", float: "number", str: "text"}


def tables() -> str:
    """A table for each section, without the keys of the section before if it has them all."""
    parts, before, named = [], set[tuple[str, ...]](), ""
    for name, rows in (sections() | arms()).items():
        more = before <= {*rows} and bool(before)
        title = f"### `{name}`\n\n" + (f"The keys of `{named}`, and\n\n" if more else "") if name else ""
        shown = [
            (key, ", ".join(filter(None, (kind, span))), default, what)
            for key, kind, default, span, what in rows
            if not more or (key, kind, default, span, what) not in before
        ]
        parts.append(title + table(HEAD, shown))
        if not more:
            before, named = {*rows}, name
    return "\n".join(parts)


def sections() -> dict[str, list[tuple[str, ...]]]:
    """The rows of the tables; the keys outside of any section first, with an empty name."""
    rows = {name: _rows([*configs, *driver_kinds(name, {})]) for name, configs in SECTIONS.items()}
    return {"": _rows(ROOT)} | rows


def arms() -> dict[str, list[tuple[str, ...]]]:
    """The rows of `pusher` that belong to the drivers of arms: those of any, then those of each."""
    drivers = {f"pusher: {{driver: {name}}}": _rows([plugin(PUSHERS, name)]) for name in ("twist", "trajectory")}
    return {"pusher: an arm": _rows([ArmConfig])} | drivers


def written(document: str) -> str:
    """The document with its tables replaced."""
    return replaced(document, BEGIN, END, f"\n{tables()}\n")


def _rows(configs: Iterable[type]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for config in configs:
        hints = typing.get_type_hints(config)
        for field in settings.fields_of(config):
            default = "*required*" if settings.is_required(field) else f"`{as_yaml(settings.plain_value(field.default))}`"
            what = field.metadata["description"]
            rows.append((f"`{settings.key_of(field)}`", _kind(hints[field.name]), default, _range(field), what))
    return rows


def _kind(hint: Any) -> str:
    if settings.is_optional(hint):
        return f"`{settings.AUTO}` or {_kind(settings.written(hint))}"
    if typing.get_origin(hint) is tuple:
        items = typing.get_args(hint)
        count = "" if items[-1] is Ellipsis else f"{len(items)} "
        return f"list of {count}{TYPES[settings.written(items[0])]}s"
    return TYPES.get(hint) or f"one of {', '.join(f'`{member.value}`' for member in hint)}"


def _range(field: Any) -> str:
    low, high = field.metadata["low"], field.metadata["high"]
    return "" if low is None else limits(low, high)


if __name__ == "__main__":
    path = pathlib.Path(sys.argv[1])
    path.write_text(written(path.read_text(encoding="utf-8")), encoding="utf-8")
