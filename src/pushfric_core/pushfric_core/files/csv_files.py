"""CSV files with named columns, in SI units and the object frame: of observations, and of pushes to be judged.

An error names the file, the line and the column.
"""

import csv
import math
import pathlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pushfric_core.errors import InvalidInput, PushfricError, blaming
from pushfric_core.files.disk import as_named_here, reading, write_whole
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, Twist
from pushfric_core.plausible import FARTHEST, FARTHEST_TURN_CENTER, FASTEST, check_within
from pushfric_core.trajectories.observation import Observation, check_half_width, check_planned_contact
from pushfric_core.wording import shortened

REQUIRED = ("contact_x", "contact_y", "normal_x", "normal_y", "vx", "vy", "omega", "push_id")
PAIRS = (("force_x", "force_y"), ("tip_vx", "tip_vy"))
OPTIONAL = ("half_width", *PAIRS[0], *PAIRS[1], "duration", "depth", "stamp")
NAMES = {
    "contact_point": "contact_x, contact_y",
    "contact_normal": "normal_x, normal_y",
    "the twist": "vx, vy, omega",
    "force": "force_x, force_y",
    "tip_velocity": "tip_vx, tip_vy",
}
"""The columns of each field of an observation."""


class CsvRow(NamedTuple):
    """A row of a table."""

    where: str  # file and line, for errors
    texts: Mapping[str, str]  # of its columns

    def number(self, name: str) -> float:
        """The number in a column.

        Raises:
            InvalidInput: the text is not a finite number.
        """
        text = self.texts[name]
        try:
            value = float(text.replace("_", "?"))  # Python takes 1_0 for 10
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
        with blaming(self.where):
            check_within(" and ".join(names), found, FARTHEST, "m")
        return found


class CsvTable(NamedTuple):
    """A table with a row of names first."""

    columns: Sequence[str]
    rows: Sequence[CsvRow]


def read_table(path: pathlib.Path, columns: Sequence[str], things: str, expected: str = "") -> CsvTable:
    """Read a CSV file that must have these columns and at least one row; it may have further columns, each once.

    Args:
        path: the file.
        columns: names of the columns that it must have.
        things: what the rows are, in the plural, for the error of a table without rows.
        expected: what the error of a missing column says was expected; by default, the columns.
    Raises:
        InvalidInput: the file cannot be read as such a table.
    """
    rows = []
    with reading(path), path.open(newline="", encoding="utf-8-sig") as stream:
        reader = csv.reader(stream, skipinitialspace=True)
        found = [name.strip() for name in next(reader, [])]
        if missing := [name for name in columns if name not in found]:
            raise InvalidInput(f"{path}: missing column {', '.join(missing)}; expected {expected or ', '.join(columns)}")
        if twice := sorted({name for name in found if name and found.count(name) > 1}):
            raise InvalidInput(f"{path}: expected each column once, got more of {', '.join(twice)}")
        for texts in filter(None, reader):  # some lines are blank
            where = f"{path}, line {reader.line_num}"
            if len(texts) != len(found):
                raise InvalidInput(f"{where}: expected {len(found)} values, as the first line has names, got {len(texts)}")
            rows.append(CsvRow(where, dict(zip(found, texts, strict=True))))
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


def read_observations(path: pathlib.Path, outline: Outline) -> list[Observation]:
    """The observations of a CSV file, in its order. Columns other than `REQUIRED` and `OPTIONAL` are ignored.

    Args:
        path: the file.
        outline: of the object; contacts must lie on it.
    Raises:
        InvalidInput: the file cannot be read as such a table; the text names the file, the line, and what was expected there.
    """
    columns, rows = read_table(path, REQUIRED, "observations")
    for x, y in PAIRS:
        if (x in columns) != (y in columns):
            raise InvalidInput(f"{path}: expected both of {x} and {y}, or neither")
    return [_observation(row, outline) for row in rows]


def _observation(row: CsvRow, outline: Outline) -> Observation:
    number, where = row.number, row.where

    def optional(name: str) -> float | None:
        return number(name) if row.texts.get(name) else None

    def pair(x: str, y: str) -> tuple[float, float] | None:
        return (number(x), number(y)) if row.texts.get(x) or row.texts.get(y) else None

    push_id = number("push_id")
    if push_id != int(push_id) or not 0 <= push_id < 2**31:
        raise InvalidInput(f"{where}: push_id must be a whole number in [0, 2^31), got {push_id:g}")
    stamp = row.texts.get("stamp") or "0"
    if not (stamp.isdecimal() and int(stamp) < 2**63):
        raise InvalidInput(f"{where}: stamp must be a whole number of nanoseconds, got {shortened(stamp)}")
    try:
        observation = Observation(
            contact_point=(number("contact_x"), number("contact_y")),
            contact_normal=(number("normal_x"), number("normal_y")),
            twist=Twist(number("vx"), number("vy"), number("omega")),
            push_id=int(push_id),
            half_width=optional("half_width") or 0.0,
            duration=optional("duration"),
            stamp=int(stamp),
            force=pair("force_x", "force_y"),
            tip_velocity=pair("tip_vx", "tip_vy"),
            depth=optional("depth"),
        )
        observation.check_contact(outline)
    except InvalidInput:
        raise
    except (ValueError, PushfricError) as error:
        raise InvalidInput(f"{where}: {as_named_here(error, NAMES)}") from error
    nearest = outline.nearest(observation.contact_point)
    # a measured contact says where the tip was
    measured = observation.depth is None and nearest.edge is not None
    return replace(observation, depth=-nearest.distance) if measured else observation


CONTACT = ("contact_x", "contact_y", "normal_x", "normal_y")
MOVED = (*CONTACT, "tip_vx", "tip_vy")
TURNED = (*CONTACT, "half_width", "cor_x", "cor_y", "turn")

BOUNDS = {
    **dict.fromkeys(("contact_x", "contact_y", "half_width"), (FARTHEST, "m")),
    **dict.fromkeys(("tip_vx", "tip_vy"), (FASTEST, "m/s")),
    **dict.fromkeys(("cor_x", "cor_y"), (FARTHEST_TURN_CENTER, "m")),
}
"""Bounds of these columns, and their units; of the others, FARTHEST without a unit."""


class PointPushes(NamedTuple):
    """Pushes with a point."""

    contact_points: Array  # (k, 2) [m]
    contact_normals: Array  # (k, 2) unit, outward
    tip_velocities: Array  # (k, 2) [m per any unit of time]


class EdgePushes(NamedTuple):
    """Pushes with an edge or two fingers."""

    contact_points: Array  # (k, 2) middles of the contact intervals [m]
    contact_normals: Array  # (k, 2) unit, outward
    half_widths: Array  # (k,) [m]
    centers: Array  # (k, 2) of rotation [m]
    turns: Array  # (k,) +1 or -1


def read_point_pushes(path: pathlib.Path, outline: Outline) -> PointPushes:
    """The rows of a CSV file with the columns MOVED; others are ignored.

    Args:
        path: the file.
        outline: of the object; contacts must lie on it.
    Raises:
        InvalidInput: the file cannot be read as such a table; the text names the file, the line, and what was expected there.
    """
    rows, _ = _read(path, MOVED, outline)
    return PointPushes(rows[:, 0:2], rows[:, 2:4], rows[:, 4:6])


def read_edge_pushes(path: pathlib.Path, outline: Outline) -> EdgePushes:
    """The rows of a CSV file with the columns TURNED; others are ignored. For arguments and errors see `read_point_pushes`."""
    rows, places = _read(path, TURNED, outline)
    for where, half_width, turn in zip(places, rows[:, 4], rows[:, 7], strict=True):
        with blaming(where):
            check_half_width(outline, half_width)
        if abs(turn) != 1:
            raise InvalidInput(f"{where}: turn must be +1 (counter-clockwise) or -1, got {turn:g}")
    return EdgePushes(rows[:, 0:2], rows[:, 2:4], rows[:, 4], rows[:, 5:7], rows[:, 7])


def _read(path: pathlib.Path, columns: tuple[str, ...], outline: Outline) -> tuple[Array, list[str]]:
    """Numbers (k, columns), and the place of each row for errors; contacts and normals are checked."""
    _, rows = read_table(path, columns, "pushes")
    numbers = np.array([row.numbers(columns) for row in rows])
    places = [row.where for row in rows]
    for where, row in zip(places, numbers.tolist(), strict=True):
        x, y, normal_x, normal_y = row[:4]
        with blaming(where):
            for name, value in zip(columns, row, strict=True):
                check_within(name, (value,), *BOUNDS.get(name, (FARTHEST, "")))
            check_planned_contact(outline, (x, y), (normal_x, normal_y))
    return numbers, places
