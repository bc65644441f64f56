"""Strokes of which only the begin and the end are known: as CSV files, and as observations.

A folder of sets has, for each SURFACE_OBJECT, SURFACE_OBJECT.strokes.csv and SURFACE_OBJECT.tip.csv (`save_set`), perhaps
SURFACE_OBJECT.csv with pairs of force and motion, and for each object OBJECT.yaml.
"""

import math
import pathlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pushfric_core.files.csv_table import read_table, save_table
from pushfric_core.files.observation_file import save_observations
from pushfric_core.geometry import planar
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, Pose, compose, exp, inverse, rotation, transform
from pushfric_core.trajectories.observation import Observation

STROKES, DATA_POINTS = ".strokes.csv", ".tip.csv"
"""After the name of a set, the names of its files."""

COLUMNS = ("x0", "y0", "th0", "x1", "y1", "th1", "tipx0", "tipy0", "tipx1", "tipy1")
PREDICTED = ("zhou_x1", "zhou_y1", "zhou_th1")
"""Columns of the end that another model predicts."""

RUN, TIP_RADIUS = "run", "tip_radius"
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


class Stroke(NamedTuple):
    """A stroke in the table frame."""

    before: Pose
    after: Pose
    tip_before: tuple[float, float]  # its centre [m]
    tip_after: tuple[float, float]
    predicted: Pose | None = None  # the end, by a model of others
    run: int | None = None  # the push of which it is a part; None: it is a push
    tip_radius: float = USUAL_RADIUS  # [m]

    def data_point(self, outline: Outline, push_id: int) -> Observation | None:
        """The screw of the whole stroke, with the contact halfway; None if that would not be an observation."""
        motion = planar.log(compose(inverse(self.before), self.after))
        halfway = compose(self.before, exp(motion, 0.5))
        middle = np.add(self.tip_before, self.tip_after) / 2
        poses, tips = (self.before, halfway, self.after), (self.tip_before, middle, self.tip_after)
        places = [transform(inverse(pose), tip) for pose, tip in zip(poses, tips, strict=True)]
        edges, feet, gaps = nearest_edges(outline, np.array(places))
        turned = float(outline.normals[edges[0]] @ outline.normals[edges[2]])
        if (
            abs(motion.omega) > LARGEST_TURN
            or math.hypot(motion.vx, motion.vy) < LEAST_WAY
            or np.abs(gaps - self.tip_radius).max() > LARGEST_GAP
            or turned < math.cos(SAME_SIDE)
        ):
            return None
        contact, (nx, ny) = feet[1], outline.normals[edges[1]].tolist()
        vx, vy = (rotation(-halfway.theta) @ np.subtract(self.tip_after, self.tip_before)).tolist()
        return Observation(
            contact_point=(float(contact[0]), float(contact[1])),
            contact_normal=(nx, ny),
            twist=motion,
            push_id=push_id,
            stamp=(push_id + 1) * SECOND,
            tip_velocity=(vx, vy),
        )


def nearest_edges(outline: Outline, points: Array) -> tuple[Array, Array, Array]:
    """The edges (k,) nearest to points (k, 2), the nearest points of them (k, 2), and the distances (k,) [m].

    A corner belongs to the first of its two edges.
    """
    offsets = points[:, None] - outline.vertices
    along = np.clip(np.sum(offsets * outline.edges, axis=2) / outline.lengths**2, 0.0, 1.0)
    feet = outline.vertices + along[..., None] * outline.edges
    distances = np.linalg.norm(points[:, None] - feet, axis=2)
    edges, rows = distances.argmin(axis=1), np.arange(len(points))
    return edges, feet[rows, edges], distances[rows, edges]


def spacing_of(outline: Outline) -> float:
    """Distance of the support points for an object of which nothing else is known [m]."""
    return round(math.sqrt(outline.polygon.area / SUPPORTS), 4)


def read_strokes(path: pathlib.Path) -> list[Stroke]:
    """The strokes of a CSV file with the COLUMNS; others but PREDICTED, and RUN with TIP_RADIUS, are ignored.

    Raises:
        InvalidInput: the file cannot be read as such a table; the text names the file, the line, and what was expected there.
    """
    columns, rows = read_table(path, COLUMNS, "strokes")
    predicted, parts = all(name in columns for name in PREDICTED), all(name in columns for name in (RUN, TIP_RADIUS))
    strokes = []
    for row in rows:
        x0, y0, th0, x1, y1, th1, *tips = row.numbers(COLUMNS)
        end = Pose(*row.numbers(PREDICTED)) if predicted else None
        stroke = Stroke(Pose(x0, y0, th0), Pose(x1, y1, th1), (tips[0], tips[1]), (tips[2], tips[3]), end)
        if parts:
            stroke = stroke._replace(run=int(row.number(RUN)), tip_radius=row.number(TIP_RADIUS))
        strokes.append(stroke)
    return strokes


def save_strokes(strokes: Sequence[Stroke], path: pathlib.Path) -> None:
    """Write a CSV file of strokes; all or none have a prediction, and a run.

    Raises:
        InvalidInput: the file cannot be written.
    """
    predicted, run = strokes[0].predicted is not None, strokes[0].run is not None
    columns = (*COLUMNS, *PREDICTED * predicted, *(RUN, TIP_RADIUS) * run)
    save_table(columns, [_row(one) for one in strokes], path)


def _row(stroke: Stroke) -> list[float]:
    run = () if stroke.run is None else (stroke.run, stroke.tip_radius)
    return [*stroke.before, *stroke.after, *stroke.tip_before, *stroke.tip_after, *(stroke.predicted or ()), *run]


def save_set(name: str, strokes: Sequence[Stroke], outline: Outline, out: pathlib.Path) -> int:
    """Write the strokes of a set and those of them that are observations into a folder; return the number of the latter.

    Raises:
        InvalidInput: a file cannot be written.
    """
    save_strokes(strokes, out / f"{name}{STROKES}")
    points = [point for point in data_points(strokes, outline) if point is not None]
    save_observations(points, out / f"{name}{DATA_POINTS}")
    return len(points)


def data_points(strokes: Sequence[Stroke], outline: Outline) -> list[Observation | None]:
    """The observation of each stroke; None if it would not be one. The push is the run, or else the number of the stroke."""
    return [one.data_point(outline, number if one.run is None else one.run) for number, one in enumerate(strokes)]
