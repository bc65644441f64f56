"""CSV files with named columns; an error names the file, the line and the column."""

import csv
import math
import pathlib
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from pushfric_core.errors import InvalidInput
from pushfric_core.files.file_errors import reading
from pushfric_core.files.whole_file import write_whole
from pushfric_core.plausible import FARTHEST, check_within


class CsvRow(NamedTuple):
    """A row of a table."""

    where: str  # file and line, for errors
    texts: Mapping[str, str | None]  # of its columns; None: the row is too short

    def number(self, name: str) -> float:
        """The number in a column.

        Raises:
            InvalidInput: the text is not a finite number.
        """
        text = self.texts[name]
        try:
            value = float(text or "")
        except ValueError:
            raise InvalidInput(f"{self.where}: {name} must be a number, got {text!r}") from None
        if not math.isfinite(value):
            raise InvalidInput(f"{self.where}: {name} must be finite, got {value}")
        return value

    def numbers(self, names: Sequence[str]) -> list[float]:
        """The numbers in some columns; raises as `number` does."""
        return [self.number(name) for name in names]

    def lengths(self, names: Sequence[str]) -> list[float]:
        """The coordinates in some columns [m].

        Raises:
            InvalidInput: one is not a number, or beyond FARTHEST.
        """
        found = self.numbers(names)
        try:
            check_within(" and ".join(names), found, FARTHEST, "m")
        except ValueError as error:
            raise InvalidInput(f"{self.where}: {error}") from error
        return found


class CsvTable(NamedTuple):
    """A table with a row of names first."""

    columns: Sequence[str]
    rows: Sequence[CsvRow]


def read_table(path: pathlib.Path, columns: Sequence[str], things: str, expected: str = "") -> CsvTable:
    """Read a CSV file that must have these columns and at least one row; it may have further columns.

    Args:
        path: the file.
        columns: names of the columns that it must have.
        things: what the rows are, in the plural, for the error of a table without rows.
        expected: what the error of a missing column says was expected; by default, the columns.
    Raises:
        InvalidInput: the file cannot be read as such a table.
    """
    with reading(path), path.open(newline="", encoding="utf-8-sig") as stream:
        reader = csv.DictReader(stream, skipinitialspace=True)
        found = [name.strip() for name in reader.fieldnames or []]
        reader.fieldnames = found
        if missing := [name for name in columns if name not in found]:
            raise InvalidInput(f"{path}: missing column {', '.join(missing)}; expected {expected or ', '.join(columns)}")
        rows = [CsvRow(f"{path}, line {reader.line_num}", row) for row in reader]
    if not rows:
        raise InvalidInput(f"{path}: no {things}; expected a row for each")
    return CsvTable(found, rows)


def save_table(columns: Sequence[str], rows: Iterable[Sequence[float | None]], path: pathlib.Path) -> None:
    """Write a CSV file of numbers, to nine digits; None is an empty cell.

    Raises:
        InvalidInput: the file cannot be written.
    """
    lines = [",".join("" if value is None else f"{value:.9g}" for value in row) for row in rows]
    write_whole(path, "\n".join((",".join(columns), *lines, "")))
