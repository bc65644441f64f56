"""Import of real pushes: steel plates, MIT MCube Lab, from a clone of PlanarManipulationToolBox.

K. Yu, M. Bauza, N. Fazeli, A. Rodriguez, "More than a million ways to be pushed: a high-fidelity experimental data set of
planar pushing", IROS 2016. The fitted models are those of J. Zhou, Y. Hou, M. T. Mason, "Pushing revisited: differential
flatness, trajectory planning, and stabilization", 2017.

A file holds whole strokes of 40 mm with the ends that a fitted model predicts,
and pairs of force and motion that the model was fitted to.
"""

import math
import pathlib
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.io import loadmat

from pushfric_core.datasets.imported import Imported
from pushfric_core.datasets.strokes import STROKES, Stroke, save_set, save_strokes, spacing_of
from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.files.file_errors import reading, shortened, text_of
from pushfric_core.files.object_file import ObjectFile, SupportFile, make_object, save_object
from pushfric_core.files.observation_file import save_observations
from pushfric_core.files.whole_file import make_folder
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, Pose, Twist, cross, log
from pushfric_core.trajectories.observation import Observation
from pushfric_core.wording import counted

NAME = "mitpush"
FOLDER = pathlib.Path("mcube_data_proc", "motion_model_eval_logs_train_test_searchmu2_filter")
FILE = re.compile(
    r"wrench1twist1_20percenttraining(?P<surface>[a-z]+)_(?P<shape>[a-z]+\d?)_(?P<model>quadratic|poly4)_v10\.mat"
)
OUTLINES = pathlib.Path("pnpush_matlab", "get_shape.m")
"""In a clone: the measurements, and the function with the outlines, of which only that of `butter` is read."""

POLY4 = ".strokes_poly4.csv"
"""After the name of a set: its strokes with the ends that the quartic predicts, instead of the ellipsoid."""

STEP = 0.8 * 5 / 7
"""Time between the two poses of which the motion in a pair is the difference [s]."""

STEEPEST = math.radians(50)
"""A force further from the normal than this does not enter where it says; the steepest of the others is 49.7 degrees off."""

AT_CORNER = 1e-3
"""A force that passes a corner at most this far away, along the edge, enters there [m]."""

TEXT_LIMIT = 2**20
"""Largest size of the file with the outlines [characters]."""

RECTANGLES = {"rect1": (0.09, 0.09), "rect2": (0.08991, 0.11258), "rect3": (0.13501, 0.08994)}
TRIANGLES = {"tri1": (0.12587, 0.12590), "tri2": (0.12587, 0.15100), "tri3": (0.12561, 0.1765)}
"""Legs along y and x; the right angle is at (RIGHT_ANGLE, RIGHT_ANGLE)."""

RIGHT_ANGLE = 0.045
ELLIPSES = {"ellip1": (0.105, 0.105), "ellip2": (0.105, 0.13089), "ellip3": (0.105, 0.157)}
HEXAGON = 0.0605
"""Distance of the corners from the middle [m]."""

CURVE = 99
"""Corners of an ellipse."""


def import_pushes(source: pathlib.Path, out: pathlib.Path) -> list[Imported]:
    """Write the files of `datasets.strokes` for every surface and shape of a clone.

    Args:
        source: the clone.
        out: folder to write.
    Raises:
        InvalidInput: the source is not such a clone, a file cannot be read, or the folder exists already.
    """
    found = {
        (m["surface"], m["shape"], m["model"]): path
        for path in sorted(source.glob(f"{FOLDER}/*.mat"))
        if (m := FILE.fullmatch(path.name))
    }
    sets = sorted({key[:2] for key in found})
    if not sets:
        raise InvalidInput(
            f"{source}: no {FOLDER}/wrench1twist1_20percenttraining*.mat; expected a clone of PlanarManipulationToolBox"
        )
    outlines = {shape: outline_of(shape, source) for _, shape in sets}
    make_folder(out, new=True)
    written = []
    for surface, shape in sets:
        outline, name = outlines[shape], f"{surface}_{shape}"
        file = ObjectFile(name=shape, outline=_rounded(outline), support=SupportFile(spacing=spacing_of(outline)))
        save_object(make_object(file, shape), out / f"{shape}.yaml")
        count = 0
        if (path := found.get((surface, shape, "quadratic"))) is not None:
            strokes, pairs = read_file(path, outline)
            count = save_set(name, strokes, outline, out)
            save_observations(pairs, out / f"{name}.csv")
        if (path := found.get((surface, shape, "poly4"))) is not None:
            save_strokes(read_file(path, outline)[0], out / f"{name}{POLY4}")
        written.append(Imported(out / f"{name}{STROKES}", shape, count))
    return written


def read_file(path: pathlib.Path, outline: Outline) -> tuple[list[Stroke], list[Observation]]:
    """The strokes of a file, and the pairs of force and motion as observations.

    Raises:
        InvalidInput: the file is not of this data set.
    """
    try:
        content = loadmat(path, squeeze_me=True, struct_as_record=False)
        strokes = [_stroke(record) for record in np.atleast_1d(content["record_all"])]
        training = content["record_ls_training"]
        wrenches, twists = (np.asarray(getattr(training, name), dtype=float).reshape(-1, 3) for name in ("wrenches", "twists"))
        pairs = list(_pairs(wrenches, twists, outline))
    # scipy raises errors of many kinds for damaged files
    except Exception as error:
        raise InvalidInput(f"{path}: not a file of {NAME}: {type(error).__name__}: {shortened(str(error))}") from error
    if not strokes or not pairs:
        raise InvalidInput(f"{path}: not a file of {NAME}: {counted(len(strokes), 'stroke')}, {counted(len(pairs), 'pair')}")
    return strokes, pairs


def outline_of(shape: str, clone: pathlib.Path) -> Outline:
    """The outline of a plate, object frame.

    Raises:
        InvalidInput: there is no such shape, or that of `butter` cannot be read.
    """
    if shape in RECTANGLES:
        return Outline(np.array(RECTANGLES[shape]) / 2 * ((1, 1), (-1, 1), (-1, -1), (1, -1)))
    if shape in TRIANGLES:
        y, x = TRIANGLES[shape]
        at = RIGHT_ANGLE
        return Outline(np.array(((at, at), (at - x, at), (at, at - y))))
    if shape == "hex":
        angles = np.arange(1, 7) * math.pi / 3
        return Outline(HEXAGON * np.column_stack((np.cos(angles), np.sin(angles))))
    if shape in ELLIPSES:
        angles = np.arange(CURVE) * 2 * math.pi / CURVE
        return Outline(np.column_stack((np.cos(angles), np.sin(angles))) * ELLIPSES[shape] / 2)
    return Outline(_listed(shape, clone / OUTLINES))


def _listed(shape: str, path: pathlib.Path) -> Array:
    """The corners (n, 2) of a shape that the MATLAB function lists: the first matrix after its name."""
    with reading(path):
        text = text_of(path, TEXT_LIMIT)
    # without comments and line continuations
    text = re.sub(r"\.\.\.[^\n]*\n", " ", re.sub(r"%[^\n]*", "", text))
    matrix = re.search(rf"['\"]{shape}['\"].*?\[([-+.\deE,;\s]+)\]", text, re.DOTALL)
    try:
        if matrix is None:
            raise ValueError("expected a matrix of its corners")
        rows = [
            [float(value) for value in re.split(r"[,\s]+", row.strip(" ,\t\r"))]
            for row in re.split(r"[;\n]", matrix[1])
            if row.strip(" ,\t\r")
        ]
        corners = np.array(rows)
        corners = corners if len(corners) > 3 else corners.T
        corners = corners[np.any(corners != np.roll(corners, 1, axis=0), axis=1), :2]  # perhaps closed
        Outline(corners)
    except (ValueError, IndexError, PushfricError) as error:
        raise InvalidInput(f"{path}: the outline of {shape}: {error}") from error
    return corners


def _rounded(outline: Outline) -> list[tuple[float, float]]:
    """To a micrometre, as people read and write it."""
    return [(round(x, 6), round(y, 6)) for x, y in outline.vertices.tolist()]


def _stroke(record: Any) -> Stroke:
    before, after, predicted = (
        Pose(*np.asarray(getattr(record, name), dtype=float).tolist())
        for name in ("init_pose_gt", "final_pose_gt", "final_pose_sim")
    )
    (x0, y0), (x1, y1) = (np.asarray(getattr(record, name), dtype=float).tolist() for name in ("init_tip_pt", "final_tip_pt"))
    if not np.isfinite((*before, *after, *predicted, x0, y0, x1, y1)).all():
        raise ValueError("expected finite numbers")
    return Stroke(before, after, (x0, y0), (x1, y1), predicted)


def _pairs(wrenches: Array, twists: Array, outline: Outline) -> Iterator[Observation]:
    """The observations whose force enters the outline; push_id is the row, because no one knows which belong to one push."""
    vertices = outline.vertices
    length = float(np.mean(np.linalg.norm(vertices - vertices.mean(axis=0), axis=1)))
    for row, ((fx, fy, m), (vx, vy, turn)) in enumerate(zip(wrenches.tolist(), twists.tolist(), strict=True)):
        entry = _entry(outline, np.array((fx, fy)), m * length)
        if entry is None or not any((vx, vy, turn)):
            continue
        edge, contact = entry
        nx, ny = outline.normals[edge].tolist()
        # the difference of two poses, over the time between them: to the velocity that leads from one to the other
        omega = turn / length
        screw = log(Pose(vx * STEP, vy * STEP, omega * STEP))
        yield Observation(
            contact_point=(float(contact[0]), float(contact[1])),
            contact_normal=(nx, ny),
            twist=Twist(screw.vx / STEP, screw.vy / STEP, omega),
            push_id=row,
            force=(fx, fy),
        )


def _entry(outline: Outline, force: Array, moment: float) -> tuple[int, Array] | None:
    """The edge and the point where the line of a force first enters an outline; None if none does so plausibly."""
    along = cross(outline.edges, force)
    inward = -outline.normals @ force
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (moment - cross(outline.vertices, force)) / along
    on_edge = np.clip(share, 0, 1)
    near = np.abs(share - on_edge) * outline.lengths <= AT_CORNER
    enters = np.flatnonzero((inward > math.cos(STEEPEST) * np.linalg.norm(force)) & near)
    if not len(enters):
        return None
    points = outline.vertices[enters] + on_edge[enters, None] * outline.edges[enters]
    first = int(np.argmin(points @ force))
    return int(enters[first]), points[first]
