"""Import of real pushes with two fingers: the aluminium triangle of `zhou2015`, folder PushExp/sensor_log/stablepush.

Two fingers in contact with one edge were turned about a commanded centre. If the object followed them, the push was stable.
"""

import pathlib
from typing import NamedTuple

import numpy as np

from bench.public.strokes import SECOND, Imported
from bench.public.zhou2015 import MILLIMETRE, write_bag
from pushfric_core import InvalidInput, Observation, PushfricError
from pushfric_core.errors import blaming
from pushfric_core.files.csv_files import TURNED, EdgePushes, read_table, save_table
from pushfric_core.geometry.planar import Array, Twist

NAME = "stablepush"
PUSHES = "pushes.csv"
"""A file next to each bag: all pushes of the object in the form that the command `stable` reads, plus the measured `stable`."""

COLUMNS = (
    *("object", "cx_mm", "cy_mm", "nx", "ny", "half_width_mm", "cor_x_mm", "cor_y_mm", "commanded_rad"),
    *("dx_mm", "dy_mm", "dtheta_rad", "stable"),
)
UNITS = [MILLIMETRE if name.endswith("_mm") else 1.0 for name in COLUMNS[1:]]


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
        objects.setdefault(row.texts["object"], []).append(row.numbers(COLUMNS[1:]))
    return {name: _pushes(np.array(rows) * UNITS) for name, rows in objects.items()}


def _pushes(rows: Array) -> TwoFingerPushes:
    edge = EdgePushes(rows[:, :2], rows[:, 2:4], rows[:, 4], rows[:, 5:7], np.sign(rows[:, 7]))
    return TwoFingerPushes(edge, rows[:, 8:11], rows[:, 11] > 0)


def import_pushes(source: pathlib.Path, out: pathlib.Path) -> list[Imported]:
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
        with blaming(f"{source}: {name}", ValueError, PushfricError):
            observations = [_observation(found, index) for index in np.flatnonzero(found.stable).tolist()]
        if not observations:
            raise InvalidInput(f"{source}: no push of {name} was stable")
        written.append(write_bag(folder, name, observations))
        save_table((*TURNED, "stable"), np.column_stack((*found.pushes, found.stable)).tolist(), folder / PUSHES)
    return written


def _observation(found: TwoFingerPushes, index: int) -> Observation:
    point, normal, half_width, *_ = (row[index].tolist() for row in found.pushes)
    return Observation(point, normal, Twist(*found.twists[index].tolist()), index, half_width, stamp=(index + 1) * SECOND)
