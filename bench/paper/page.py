"""Self-contained HTML pages: sections of text, tables of numbers and figures, for a screen and for paper."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jinja2

NONE = "\N{EN DASH}"
INFEASIBLE = "\N{INFINITY}"


class Cell(NamedTuple):
    """A number of the report."""

    text: str
    detail: str = ""  # quartiles, or the claim that the number is about
    tone: str = ""  # class in the style sheet
    spread: str = ""  # of a claim


class Table(NamedTuple):
    """Numbers in rows; a row of one cell is a heading for the rows below it."""

    heads: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    groups: Sequence[tuple[str, int]] = ()  # headings, each with the number of columns that it spans


class Section(NamedTuple):
    """A part of a page, with a table or a figure."""

    key: str
    title: str
    text: str
    table: Table | None = None


def number(value: float | None, digits: int = 2) -> str:
    """A number as the page shows it, with this many decimal places."""
    if value is None:
        return NONE
    # adding zero takes the sign off a zero
    return INFEASIBLE if math.isinf(value) else f"{round(value, digits) + 0.0:.{digits}f}".replace("-", "\N{MINUS SIGN}")


def page(template: str, **values: Any) -> str:
    """A page from a template of this folder, which extends `page.html.j2`, with what it shows."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("bench.paper", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(**values)
