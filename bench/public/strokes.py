"""Strokes of which only the begin and the end are known: as CSV files, and as observations.

A folder of sets has, for each SURFACE_OBJECT, SURFACE_OBJECT.strokes.csv and SURFACE_OBJECT.tip.csv (`save_set`), perhaps
SURFACE_OBJECT.csv with pairs of force and motion, and for each object OBJECT.yaml (`save_model`).
"""

import math
import pathlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from typing import NamedTuple

import numpy as np

from pushfric_core import InvalidInput, Observation, Outline
from pushfric_core.files.csv_files import OPTIONAL, REQUIRED, read_table, save_table
from pushfric_core.files.object_file import ObjectFile, SupportFile, make_object, save_object
from pushfric_core.geometry.planar import Pose, compose, exp, inverse, log, rotation, transform

STROKES, DATA_POINTS = ".strokes.csv", ".tip.csv"
"""After the name of a set, the names of its files."""

COLUMNS = ("x0", "y0", "th0", "x1", "y1", "th1", "tipx0", "tipy0", "tipx1", "tipy1")
PREDICTED = ("zhou_x1", "zhou_y1", "zhou_th1")
"""Columns of the end that another model predicts."""

RUN = ("run", "tip_radius")
"""Number of the push of which a stroke is a part, and radius of the tip [m]; without these columns, each stroke is a push, and
the radius that of `mitpush`."""

USUAL_RADIUS = 0.00475
"""Radius of the tip of `mitpush` [m]."""

SUPPORTS = 55
"""Support points are spaced so that about this many lie on an object."""

LARGEST_TURN = math.radians(35)
"""A stroke that turns the object further is no observation: the contact moves too much."""

LEAST_WAY = 0.003
"""... and one that moves its origin less [m]."""

LARGEST_GAP = 0.0025
"""The tip touches if its surface is this near the outline [m], at the begin, halfway and at the end."""

SAME_SIDE = math.radians(50)
"""Between the edges at the begin and at the end, the normal turns by less: it does along a curve, but not round a corner."""

SECOND = 10**9

LARGEST = 1e12
"""Largest number accepted in a file; times are seconds since 1970."""


class Imported(NamedTuple):
    """A bag, or a set of CSV files, that was written."""

    path: pathlib.Path  # of the bag, or of the file with the strokes
    object: str
    observations: int


Written = list[Imported | InvalidInput]
"""What was written of a data set, and why its other parts were not."""


class Stroke(NamedTuple):
    """A stroke in the table frame."""

    before: Pose
    after: Pose
    tip_before: tuple[float, float]  # its centre [m]
    tip_after: tuple[float, float]
    predicted: Pose | None = None  # the end, by a model of others
    run: int | None = None  # the push of which it is a part; None: it is a push
    tip_radius: float = USUAL_RADIUS  # [m]


@contextmanager
def leaving_out(written: Written) -> Iterator[None]:
    """Import a part of a data set: if it cannot be used, the error goes to the list, and the others go on."""
    try:
        yield
    except InvalidInput as error:
        written.append(error)


def observed(strokes: Sequence[Stroke], outline: Outline) -> Iterator[Observation]:
    """The strokes that are observations: the screw of the whole stroke, with the contact halfway.

    The push is the run, or else the number of the stroke.
    """
    for number, one in enumerate(strokes):
        motion = log(compose(inverse(one.before), one.after))
        halfway = compose(one.before, exp(motion, 0.5))
        poses = (one.before, halfway, one.after)
        tips = (one.tip_before, np.add(one.tip_before, one.tip_after) / 2, one.tip_after)
        places = np.array([[transform(inverse(pose), tip)] for pose, tip in zip(poses, tips, strict=True)])
        along = np.clip(np.sum((places - outline.vertices) * outline.edges, axis=2) / outline.lengths**2, 0.0, 1.0)
        feet = outline.vertices + along[..., None] * outline.edges  # the nearest points of each edge
        gaps = np.linalg.norm(places - feet, axis=2)
        begin, middle, end = gaps.argmin(axis=1)  # a corner belongs to the first of its two edges
        if (
            abs(motion.omega) > LARGEST_TURN
            or math.hypot(motion.vx, motion.vy) < LEAST_WAY
            or np.abs(gaps.min(axis=1) - one.tip_radius).max() > LARGEST_GAP
            or outline.normals[begin] @ outline.normals[end] < math.cos(SAME_SIDE)
        ):
            continue
        moved = rotation(-halfway.theta) @ np.subtract(one.tip_after, one.tip_before)
        push = number if one.run is None else one.run
        yield Observation(feet[1, middle], outline.normals[middle], motion, push, stamp=(push + 1) * SECOND, tip_velocity=moved)


def read_strokes(path: pathlib.Path) -> list[Stroke]:
    """The strokes of a CSV file with the COLUMNS; others but PREDICTED and RUN are ignored.

    Raises:
        InvalidInput: the file cannot be read as such a table; the text names the file, the line, and what was expected there.
    """
    columns, rows = read_table(path, COLUMNS, "strokes")
    strokes = []
    for row in rows:
        x0, y0, th0, x1, y1, th1, *tips = row.numbers(COLUMNS)
        end = Pose(*row.numbers(PREDICTED)) if {*PREDICTED} <= {*columns} else None
        more = (int(row.number("run")), row.number("tip_radius")) if {*RUN} <= {*columns} else ()
        strokes.append(Stroke(Pose(x0, y0, th0), Pose(x1, y1, th1), (tips[0], tips[1]), (tips[2], tips[3]), end, *more))
    return strokes


def save_strokes(strokes: Sequence[Stroke], path: pathlib.Path) -> None:
    """Write a CSV file of strokes; all or none have a prediction, and a run.

    Raises:
        InvalidInput: the file cannot be written.
    """
    columns = (*COLUMNS, *PREDICTED * (strokes[0].predicted is not None), *RUN * (strokes[0].run is not None))
    # the fields of a stroke have the order of the columns; without a run, the last two are left out
    rows = [(*chain(*one[:4]), *(one.predicted or ()), *one[5:])[: len(columns)] for one in strokes]
    save_table(columns, rows, path)


def save_set(name: str, strokes: Sequence[Stroke], observations: Sequence[Observation], out: pathlib.Path) -> Imported:
    """Write the strokes of a set, SURFACE_OBJECT, into a folder, and those of them that are observations.

    Args:
        name: of the set.
        strokes: of the set.
        observations: those that `observed` makes of the strokes.
        out: the folder.
    Raises:
        InvalidInput: a file cannot be written.
    """
    save_strokes(strokes, out / f"{name}{STROKES}")
    save_observations(observations, out / f"{name}{DATA_POINTS}")
    return Imported(out / f"{name}{STROKES}", name.rpartition("_")[2], len(observations))


def save_observations(observations: Sequence[Observation], path: pathlib.Path) -> None:
    """Write a CSV file of observations, with the columns of `OPTIONAL` that one of them needs.

    Raises:
        InvalidInput: the file cannot be written.
    """
    missing = (None, None)
    rows = [
        (*one.contact_point, *one.contact_normal, *one.twist, one.push_id)
        + (one.half_width or None, *(one.force or missing), *(one.tip_velocity or missing), one.duration, one.depth, None)
        for one in observations
    ]
    names = REQUIRED + OPTIONAL
    used = [k for k, name in enumerate(names) if name in REQUIRED or any(row[k] is not None for row in rows)]
    save_table([names[k] for k in used], [[row[k] for k in used] for row in rows], path)


def save_model(name: str, outline: Outline, out: pathlib.Path) -> None:
    """Write the file of an object of which nothing but the outline is known, to a micrometre, into a folder."""
    support = SupportFile(spacing=round(math.sqrt(outline.polygon.area / SUPPORTS), 4))
    file = ObjectFile(name=name, outline=outline.vertices.round(6).tolist(), support=support)
    save_object(make_object(file, name), out / f"{name}.yaml")
