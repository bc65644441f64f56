"""Import of real pushes: a block pushed along a line by a controller, MIT MCube Lab, from the user's own copy of cpush.

A file is a run: one long push on the -x face of a block of 90 mm, with the poses of the block and of the tip. Each is cut into
strokes, and each stroke that keeps to the face is an observation.
"""

import json
import pathlib
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.public.strokes import LARGEST, Stroke, Written, leaving_out, observed, save_model, save_set
from pushfric_core import InvalidInput, Outline
from pushfric_core.geometry.planar import Array, Pose, inverse, transform
from pushfric_core.wording import counted, shortened

NAME = "cpush"
BLOCK, SIDE = "block", 0.09  # [m]

KEYS = {"timeJSON": 1, "q_sliderJSON": 3, "q_pusher_sensedJSON": 2}
"""Rows of each table: time [s]; x, y [m], theta [rad] of the block; x, y of the tip [m]; all in the robot's frame."""

LENGTH = 0.02
"""The tip goes this far in a stroke [m]: far enough for the noise of the poses, and near enough that its way is straight."""

POKED = re.compile(r"pertur?bation", re.IGNORECASE)
"""A file of which the name says this, in either spelling, was poked by hand."""

SURFACES = ("black", "plywood")
"""A file of which the name has one of these is of a run on that surface; the others are on the usual one."""


def import_pushes(sources: Sequence[pathlib.Path], out: pathlib.Path) -> Written:
    """Write the files of `strokes` for the block on each surface; push_id is the number of the run.

    Args:
        sources: files of runs.
        out: folder to write into.
    Returns:
        What was written, and why a file is not a run, or one that cannot be used.
    """
    outline = Outline.rectangle(SIDE, SIDE)
    written: Written = []
    sets: dict[str, list[Stroke]] = {}
    for run, path in enumerate(sources):
        with leaving_out(written):
            strokes = read_run(path)
            surface = next((surface for surface in SURFACES if surface in path.name.lower()), NAME)
            sets.setdefault(surface, []).extend(stroke._replace(run=run) for stroke in strokes)
    save_model(BLOCK, outline, out)
    for name, strokes in sets.items():
        # the radius of the tip: its distance from the outline, in the median over begins and ends
        ends = [end for one in strokes for end in ((one.before, one.tip_before), (one.after, one.tip_after))]
        radius = float(np.median(outline.distances_to([transform(inverse(pose), tip) for pose, tip in ends])))
        strokes = [stroke._replace(tip_radius=radius) for stroke in strokes]
        written.append(save_set(f"{name}_{BLOCK}", strokes, list(observed(strokes, outline)), out))
    return written


def read_run(path: pathlib.Path) -> list[Stroke]:
    """The strokes of a run, one after another.

    Raises:
        InvalidInput: the file is not a run, the block was poked, or the tip goes less than LENGTH.
    """
    if POKED.search(path.name):
        raise InvalidInput(f"{path}: the block was poked by hand in this run")
    try:
        content = json.loads(path.read_text())
        rows = [row for key, count in KEYS.items() for row in _table(content, key, count)]
    except (OSError, ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise InvalidInput(f"{path}: not a run of {NAME}: {type(error).__name__}: {shortened(str(error))}") from error
    run = np.array(list(zip(*rows, strict=False)))  # they may differ in length by a few
    run = run[np.isfinite(run).all(axis=1)]  # some values are null
    times, block, tip = run[:, 0], run[:, 1:4], run[:, 4:]
    # between new values of the block's pose, the last one is repeated
    new = np.concatenate(([True], np.diff(block, axis=0).any(axis=1)))
    block[:, 2] = np.unwrap(block[:, 2])
    strokes, begin = [], 0
    while begin < len(tip) and len(further := np.flatnonzero(np.linalg.norm(tip[begin:] - tip[begin], axis=1) >= LENGTH)):
        end = begin + int(further[0])
        before, after = (Pose(*(float(np.interp(times[k], times[new], row[new])) for row in block.T)) for k in (begin, end))
        strokes.append(Stroke(before, after, tuple(tip[begin].tolist()), tuple(tip[end].tolist())))
        begin = end
    if not strokes:
        raise InvalidInput(f"{path}: the tip goes less than {1e3 * LENGTH:g} mm")
    return strokes


def _table(content: dict[str, Any], key: str, rows: int) -> Array:
    """The numbers (rows, n) under a key; those that are null become NaN."""
    table = np.atleast_2d(np.array(content[key], dtype=float))
    if table.ndim != 2 or len(table) != rows or not table.size or (np.abs(table) > LARGEST).any():
        raise ValueError(f"{key} must be {counted(rows, 'list')} of numbers, got an array of shape {table.shape}")
    return table
