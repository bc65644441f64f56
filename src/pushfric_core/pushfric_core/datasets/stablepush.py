"""Import of real pushes with two fingers: the aluminium triangle of `zhou2015`, folder PushExp/sensor_log/stablepush.

Two fingers in contact with one edge were turned about a commanded centre. If the object followed them, the push was stable.
"""

import csv
import pathlib
from typing import NamedTuple

import numpy as np

from pushfric_core.datasets.imported import Imported
from pushfric_core.datasets.zhou2015 import MILLIMETRE, SECOND, write_bag
from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.files.csv_table import read_table
from pushfric_core.files.file_errors import as_named_here
from pushfric_core.files.pushes_file import TURNED, EdgePushes
from pushfric_core.geometry.planar import Array, Twist
from pushfric_core.trajectories.observation import Observation

NAME = "stablepush"
PUSHES = "pushes.csv"
"""A file next to each bag: all pushes of the object in the form that the command `stable` reads, plus the measured `stable`."""

COLUMNS = (
    *("object", "cx_mm", "cy_mm", "nx", "ny", "half_width_mm", "cor_x_mm", "cor_y_mm", "commanded_rad"),
    *("dx_mm", "dy_mm", "dtheta_rad", "stable"),
)

NAMES = {
    "contact_point": "cx_mm, cy_mm",
    "contact_normal": "nx, ny",
    "the twist": "dx_mm, dy_mm, dtheta_rad",
    "half_width": "half_width_mm",
}
"""The columns of each field of an observation."""


class TwoFingerPushes(NamedTuple):
    """All pushes of one object."""

    pushes: EdgePushes
    twists: Array  # (k, 3) measured displacement of the object-frame origin [m, m, rad]
    stable: np.ndarray  # (k,) bool, measured


def read_stable_pushes(path: pathlib.Path) -> dict[str, TwoFingerPushes]:
    """The pushes of stable_pushes.csv, object by object.

    Raises:
        InvalidInput: a column or a number is missing, or there is no push.
    """
    objects: dict[str, list[list[float]]] = {}
    for row in read_table(path, COLUMNS, "pushes", f"stable_pushes.csv of {NAME}").rows:
        objects.setdefault(row.texts["object"] or "", []).append(row.numbers(COLUMNS[1:]))
    return {name: _pushes(np.array(rows)) for name, rows in objects.items()}


def _pushes(rows: Array) -> TwoFingerPushes:
    lengths = rows[:, [0, 1, 4, 5, 6]] * MILLIMETRE
    edge = EdgePushes(lengths[:, :2], rows[:, 2:4], lengths[:, 2], lengths[:, 3:], np.sign(rows[:, 7]))
    twists = rows[:, 8:11] * (MILLIMETRE, MILLIMETRE, 1.0)
    return TwoFingerPushes(edge, twists, rows[:, 11] > 0)


def import_stable_pushes(source: pathlib.Path, out: pathlib.Path) -> list[Imported]:
    """Write, for each object, a bag of the pushes that were stable, with its object's YAML file and PUSHES next to it.

    A stable push is an observation whose contact is an interval: between the two fingers. An unstable one is not an
    observation: the contact was lost, or moved along the edge by more than its width.

    Args:
        source: stable_pushes.csv.
        out: folder of the bag; if there are several objects, of their bags.
    Raises:
        InvalidInput: the source cannot be read, or a bag exists already.
    """
    objects = read_stable_pushes(source)
    written = []
    for name, found in objects.items():
        folder = out if len(objects) == 1 else out / name
        try:
            observations = [_observation(found, index) for index in np.flatnonzero(found.stable).tolist()]
        except (ValueError, PushfricError) as error:
            raise InvalidInput(f"{source}: {name}: {as_named_here(error, NAMES)}") from error
        if not observations:
            raise InvalidInput(f"{source}: no push of {name} was stable")
        written.append(write_bag(folder, name, observations))
        with (folder / PUSHES).open("w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow((*TURNED, "stable"))
            pushes = found.pushes
            numbers = np.column_stack(
                (pushes.contact_points, pushes.contact_normals, pushes.half_widths, pushes.centers, pushes.turns)
            )
            writer.writerows([*row, int(stable)] for row, stable in zip(numbers.tolist(), found.stable, strict=True))
    return written


def _observation(found: TwoFingerPushes, index: int) -> Observation:
    pushes = found.pushes
    (cx, cy), (nx, ny) = pushes.contact_points[index].tolist(), pushes.contact_normals[index].tolist()
    return Observation(
        contact_point=(cx, cy),
        contact_normal=(nx, ny),
        twist=Twist(*found.twists[index].tolist()),
        push_id=index,
        half_width=float(pushes.half_widths[index]),
        stamp=(index + 1) * SECOND,
    )
