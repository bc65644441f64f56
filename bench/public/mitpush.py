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
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.io import loadmat

from bench.public.strokes import Stroke, Written, leaving_out, observed, save_model, save_observations, save_set, save_strokes
from pushfric_core import InvalidInput, Observation, Outline, PushfricError
from pushfric_core.errors import blaming
from pushfric_core.files.disk import reading
from pushfric_core.geometry.planar import Array, Pose, Twist, cross, log
from pushfric_core.wording import shortened

NAME = "mitpush"
FOLDER = pathlib.Path("mcube_data_proc", "motion_model_eval_logs_train_test_searchmu2_filter")
FILE = re.compile(r"wrench1twist1_20percenttraining([a-z]+)_([a-z]+\d?)_(quadratic|poly4)_v10\.mat")
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

SIZES = {
    **{"rect1": (0.09, 0.09), "rect2": (0.08991, 0.11258), "rect3": (0.13501, 0.08994), "hex": (0.121, 0.121)},
    **{"tri1": (0.12590, 0.12587), "tri2": (0.15100, 0.12587), "tri3": (0.1765, 0.12561)},
    **{"ellip1": (0.105, 0.105), "ellip2": (0.105, 0.13089), "ellip3": (0.105, 0.157)},
}
"""Along x and y [m]; a hexagon's is the circle round it."""

CURVE = 99
"""Corners of an ellipse."""

MATRIX = re.compile(r"=\s*\[((?:[^\[\]]|\[[^\[\]]*\])*)\]")
"""A matrix that is assigned in MATLAB, perhaps of rows in brackets of their own."""


def import_pushes(source: pathlib.Path, out: pathlib.Path) -> Written:
    """Write the files of `strokes` for every surface and shape of a clone.

    Args:
        source: the clone.
        out: folder to write into; the first file makes it.
    Returns:
        What was written, and what cannot be read: a file, or the outline of a shape.
    Raises:
        InvalidInput: the source is not such a clone.
    """
    found = [(*match.groups(), path) for path in sorted(source.glob(f"{FOLDER}/*")) if (match := FILE.fullmatch(path.name))]
    if not any(model == "quadratic" for _, _, model, _ in found):
        raise InvalidInput(f"{source}: no {FOLDER}/wrench1twist1*.mat; expected a clone of PlanarManipulationToolBox")
    written: Written = []
    outlines: dict[str, Outline] = {}
    for shape in dict.fromkeys(shape for _, shape, _, _ in found):
        with leaving_out(written):
            outlines[shape] = outline_of(shape, source)
            save_model(shape, outlines[shape], out)
    for surface, shape, model, path in found:
        with leaving_out(written):
            if (outline := outlines.get(shape)) is None:
                raise InvalidInput(f"{path}: without the outline of {shape}")
            name, (strokes, pairs) = f"{surface}_{shape}", read_file(path, outline)
            if model == "poly4":
                save_strokes(strokes, out / f"{name}{POLY4}")
            else:
                written.append(save_set(name, strokes, _rounded(shape, list(observed(strokes, outline))), out))
                save_observations(_rounded(shape, pairs), out / f"{name}.csv")
    return written


def read_file(path: pathlib.Path, outline: Outline) -> tuple[list[Stroke], list[Observation]]:
    """The strokes of a file, and the pairs of force and motion as observations.

    Raises:
        InvalidInput: the file is not of this data set.
    """
    try:
        content = loadmat(path, squeeze_me=True, struct_as_record=False)
        strokes = [_stroke(record) for record in np.atleast_1d(content["record_all"])]
        pairs = list(_pairs(content["record_ls_training"], outline))
        if not strokes or not pairs:
            raise ValueError("it has no stroke, or no pair")
    # scipy raises errors of many kinds for damaged files
    except Exception as error:
        raise InvalidInput(f"{path}: not a file of {NAME}: {type(error).__name__}: {shortened(str(error))}") from error
    return strokes, pairs


def outline_of(shape: str, clone: pathlib.Path) -> Outline:
    """The outline of a plate, object frame.

    Raises:
        InvalidInput: there is no such shape, or that of `butter` cannot be read.
    """
    if shape not in SIZES:
        return _listed(shape, clone / OUTLINES)
    x, y = SIZES[shape]
    if shape.startswith("rect"):
        return Outline(np.array((x, y)) / 2 * ((1, 1), (-1, 1), (-1, -1), (1, -1)))
    if shape.startswith("tri"):
        return Outline(0.045 - np.array(((0, 0), (x, 0), (0, y))))  # with the right angle at (0.045, 0.045)
    angles = np.arange(1, 7) * math.pi / 3 if shape == "hex" else np.arange(CURVE) * 2 * math.pi / CURVE
    return Outline(np.column_stack((np.cos(angles), np.sin(angles))) * (x, y) / 2)


def _rounded(shape: str, found: list[Observation]) -> list[Observation]:
    """The observations; on an ellipse, with the normal of the curve, not of one of its edges."""
    if not shape.startswith("ellip"):
        return found
    normals = [np.divide(one.contact_point, np.square(SIZES[shape])) for one in found]
    return [replace(one, contact_normal=normal / math.hypot(*normal)) for one, normal in zip(found, normals, strict=True)]


def _listed(shape: str, path: pathlib.Path) -> Outline:
    """The outline of a shape that the MATLAB function lists: the first matrix after its name with rows of two."""
    with reading(path):
        text = path.read_text(encoding="utf-8", errors="replace")
    text = re.sub(r"\.\.\.[^\n]*\n", " ", re.sub(r"%[^\n]*", "", text))
    _, _, after = re.sub(r'"', "'", text).partition(f"'{shape}'")
    for matrix in MATRIX.findall(re.split(r"\belseif\b|\bcase\b|\belse\b", after)[0]):
        rows = [found for row in re.split(r"[;\n\[\]]", matrix) if (found := row.replace(",", " ").split())]
        if len(rows) > 2 and all(len(row) == 2 for row in rows):
            with blaming(f"{path}: the outline of {shape}", ValueError, PushfricError):
                return Outline(np.array(rows, dtype=float))
    raise InvalidInput(f"{path}: the outline of {shape}: expected a matrix of at least 3 rows of two numbers after '{shape}'")


def _stroke(record: Any) -> Stroke:
    fields = ("init_pose_gt", "final_pose_gt", "init_tip_pt", "final_tip_pt", "final_pose_sim")
    before, after, begin, end, predicted = (np.asarray(getattr(record, name), dtype=float).tolist() for name in fields)
    if not np.isfinite((*before, *after, *predicted, *begin, *end)).all():
        raise ValueError("expected finite numbers")
    return Stroke(Pose(*before), Pose(*after), (begin[0], begin[1]), (end[0], end[1]), Pose(*predicted))


def _pairs(training: Any, outline: Outline) -> Iterator[Observation]:
    """The observations whose force enters the outline; push_id is the row, because no one knows which belong to one push."""
    wrenches, twists = (np.asarray(getattr(training, name), dtype=float).reshape(-1, 3) for name in ("wrenches", "twists"))
    length = float(np.mean(np.linalg.norm(outline.vertices - outline.vertices.mean(axis=0), axis=1)))
    for row, ((fx, fy, m), (vx, vy, turn)) in enumerate(zip(wrenches.tolist(), twists.tolist(), strict=True)):
        entry = _entry(outline, np.array((fx, fy)), m * length)
        if entry is not None and any((vx, vy, turn)):
            # the difference of two poses, over the time between them: to the velocity that leads from one to the other
            omega = turn / length
            screw = log(Pose(vx * STEP, vy * STEP, omega * STEP))
            yield Observation(*entry, Twist(screw.vx / STEP, screw.vy / STEP, omega), row, force=(fx, fy))


def _entry(outline: Outline, force: Array, moment: float) -> tuple[Array, Array] | None:
    """Where the line of a force first enters an outline, and the normal there; None if it enters nowhere plausibly."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (moment - cross(outline.vertices, force)) / cross(outline.edges, force)
    on_edge = np.clip(share, 0, 1)
    near = np.abs(share - on_edge) * outline.lengths <= AT_CORNER
    enters = near & (-outline.normals @ force > math.cos(STEEPEST) * np.linalg.norm(force))
    points = outline.vertices + on_edge[:, None] * outline.edges
    first = np.argmin(np.where(enters, points @ force, np.inf))
    return (points[first], outline.normals[first]) if enters[first] else None
