"""Pushes to be judged, as CSV files: SI units, object frame, one push a row."""

import csv
import math
import pathlib
from typing import NamedTuple

import numpy as np

from pushfric_core.errors import InvalidInput
from pushfric_core.observation import OFF_OUTLINE, UNIT
from pushfric_core.outline import Outline
from pushfric_core.planar import Array
from pushfric_ros.files.file_errors import reading

CONTACT = ("contact_x", "contact_y", "normal_x", "normal_y")
MOVED = (*CONTACT, "tip_vx", "tip_vy")
TURNED = (*CONTACT, "half_width", "cor_x", "cor_y", "turn")


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
        InvalidInput: names the file, the line, and what was expected there.
    """
    rows, _ = _read(path, MOVED, outline)
    return PointPushes(rows[:, 0:2], rows[:, 2:4], rows[:, 4:6])


def read_edge_pushes(path: pathlib.Path, outline: Outline) -> EdgePushes:
    """The rows of a CSV file with the columns TURNED; others are ignored. The rest as for `read_point_pushes`."""
    rows, lines = _read(path, TURNED, outline)
    for line, half_width, turn in zip(lines, rows[:, 4], rows[:, 7], strict=True):
        if half_width < 0:
            raise InvalidInput(f"{path}, line {line}: half_width must be at least 0, got {half_width:g}")
        if abs(turn) != 1:
            raise InvalidInput(f"{path}, line {line}: turn must be +1 (counter-clockwise) or -1, got {turn:g}")
    return EdgePushes(rows[:, 0:2], rows[:, 2:4], rows[:, 4], rows[:, 5:7], rows[:, 7])


def _read(path: pathlib.Path, columns: tuple[str, ...], outline: Outline) -> tuple[Array, list[int]]:
    """Numbers (k, columns) and the lines they stand on; contacts and normals checked."""
    rows, lines = [], []
    with reading(path), path.open(newline="", encoding="utf-8-sig") as stream:
        reader = csv.DictReader(stream)
        reader.fieldnames = [name.strip() for name in reader.fieldnames or []]
        if missing := [name for name in columns if name not in reader.fieldnames]:
            raise InvalidInput(f"{path}: missing column {', '.join(missing)}; expected {', '.join(columns)}")
        for row in reader:
            rows.append([_number(row, name, f"{path}, line {reader.line_num}") for name in columns])
            lines.append(reader.line_num)
    if not rows:
        raise InvalidInput(f"{path}: no pushes; expected a row for each")
    numbers = np.array(rows)
    for line, (x, y, normal_x, normal_y) in zip(lines, numbers[:, :4].tolist(), strict=True):
        if abs(math.hypot(normal_x, normal_y) - 1) > UNIT:
            raise InvalidInput(f"{path}, line {line}: the normal must have length 1, got ({normal_x:g}, {normal_y:g})")
        if (distance := outline.distance_to((x, y))) > OFF_OUTLINE:
            expected = f"the contact must be within {OFF_OUTLINE * 1e3:g} mm of the outline"
            raise InvalidInput(f"{path}, line {line}: {expected}, got ({x:g}, {y:g}) m, {distance:.3g} m away")
    return numbers, lines


def _number(row: dict[str, str], name: str, where: str) -> float:
    try:
        value = float(row[name])
    except (TypeError, ValueError):
        raise InvalidInput(f"{where}: {name} must be a number, got {row[name]!r}") from None
    if not math.isfinite(value):
        raise InvalidInput(f"{where}: {name} must be finite, got {value}")
    return value
