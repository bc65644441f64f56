"""Pushes to be judged, as CSV files: SI units, object frame, one push in each row."""

import pathlib
from typing import NamedTuple

import numpy as np

from pushfric_core.errors import InvalidInput
from pushfric_core.files.csv_table import read_table
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array
from pushfric_core.plausible import FARTHEST_TURN_CENTER, FASTEST, check_within
from pushfric_core.trajectories.observation import check_half_width, check_planned_contact

CONTACT = ("contact_x", "contact_y", "normal_x", "normal_y")
MOVED = (*CONTACT, "tip_vx", "tip_vy")
TURNED = (*CONTACT, "half_width", "cor_x", "cor_y", "turn")

BOUNDS = {
    "tip_vx": (FASTEST, "m/s"),
    "tip_vy": (FASTEST, "m/s"),
    "cor_x": (FARTHEST_TURN_CENTER, "m"),
    "cor_y": (FARTHEST_TURN_CENTER, "m"),
}
"""Bounds of these columns, and their units; contacts must lie on the outline."""


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
        try:
            check_half_width(outline, half_width)
        except ValueError as error:
            raise InvalidInput(f"{where}: {error}") from error
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
        try:
            for name, value in zip(columns, row, strict=True):
                if name in BOUNDS:
                    check_within(name, (value,), *BOUNDS[name])
            check_planned_contact(outline, (x, y), (normal_x, normal_y))
        except ValueError as error:
            raise InvalidInput(f"{where}: {error}") from error
    return numbers, places
