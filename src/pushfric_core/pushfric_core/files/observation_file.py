"""Observations as a CSV file: SI units, object frame, one observation in each row."""

import pathlib
from collections.abc import Sequence
from dataclasses import replace

from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.files.csv_table import CsvRow, read_table, save_table
from pushfric_core.files.file_errors import as_named_here
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Twist
from pushfric_core.trajectories.observation import Observation

REQUIRED = ("contact_x", "contact_y", "normal_x", "normal_y", "vx", "vy", "omega", "push_id")
PAIRS = (("force_x", "force_y"), ("tip_vx", "tip_vy"))
OPTIONAL = ("half_width", *PAIRS[0], *PAIRS[1])
NAMES = {
    "contact_point": "contact_x, contact_y",
    "contact_normal": "normal_x, normal_y",
    "the twist": "vx, vy, omega",
    "force": "force_x, force_y",
    "tip_velocity": "tip_vx, tip_vy",
}
"""The columns of each field of an observation."""


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


def save_observations(observations: Sequence[Observation], path: pathlib.Path) -> None:
    """Write a CSV file of observations, with the columns of `OPTIONAL` that one of them needs.

    Raises:
        InvalidInput: the file cannot be written.
    """
    missing = (None, None)
    rows = [
        (*one.contact_point, *one.contact_normal, *one.twist, one.push_id)
        + (one.half_width or None, *(one.force or missing), *(one.tip_velocity or missing))
        for one in observations
    ]
    used = [any(row[column] is not None for row in rows) for column in range(len(REQUIRED + OPTIONAL))]
    columns = [column for column in range(len(used)) if used[column] or column < len(REQUIRED)]
    names = [(REQUIRED + OPTIONAL)[column] for column in columns]
    save_table(names, [[row[column] for column in columns] for row in rows], path)


def _observation(row: CsvRow, outline: Outline) -> Observation:
    number, where = row.number, row.where

    def pair(x: str, y: str) -> tuple[float, float] | None:
        return (number(x), number(y)) if row.texts.get(x) or row.texts.get(y) else None

    push_id = number("push_id")
    if push_id != int(push_id) or not 0 <= push_id < 2**31:
        raise InvalidInput(f"{where}: push_id must be a whole number in [0, 2^31), got {push_id:g}")
    try:
        observation = Observation(
            contact_point=(number("contact_x"), number("contact_y")),
            contact_normal=(number("normal_x"), number("normal_y")),
            twist=Twist(number("vx"), number("vy"), number("omega")),
            push_id=int(push_id),
            half_width=number("half_width") if row.texts.get("half_width") else 0.0,
            force=pair("force_x", "force_y"),
            tip_velocity=pair("tip_vx", "tip_vy"),
        )
        observation.check_contact(outline)
    except InvalidInput:
        raise
    except (ValueError, PushfricError) as error:
        raise InvalidInput(f"{where}: {as_named_here(error, NAMES)}") from error
    nearest = outline.nearest(observation.contact_point)
    # a measured contact says where the tip was
    return observation if nearest.edge is None else replace(observation, depth=-nearest.distance)
