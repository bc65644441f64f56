"""Whole strokes: where straight pushes leave an object, for many strokes and many friction distributions at once."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.contact import PushingLine
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, Pose, as_array
from pushfric_core.mechanics import quasi_static
from pushfric_core.mechanics.prediction import FrictionModel, of_misfit, scattered
from pushfric_core.mechanics.simulation import TOUCHING
from pushfric_core.plausible import LARGEST, check_within
from pushfric_core.records import comparable
from pushfric_core.steps import finished

STEP = 1e-3
"""Longest advance of the tip in one step of the midpoint rule [m]; the error over 50 mm is below 0.05 mm."""

OVERLAP = 1e-3
"""A tip may overlap the object at first, as poses err, and pushes it on: by its radius, and at least by this much [m]."""


@comparable
class Strokes(NamedTuple):
    """Where k strokes leave the object, with the mean friction of its model and with each of the s samples.

    Example:
        >>> from pushfric_core import TABLE_1, FrictionModel, Pose, PushingLine, predict_strokes
        >>> known = TABLE_1["wood_rect4"]
        >>> model, line = FrictionModel.of(known.support, known.mu_c), PushingLine((0.0, -0.1), (0.0, 1.0), 0.003)
        >>> strokes = predict_strokes(model, known.outline, [Pose(0.0, 0.0, 0.0)], [line], [0.075])
        >>> strokes.means.shape, strokes.poses.shape
        ((1, 3), (1, 1, 3))
    """

    means: Array  # (k, 3) with the mean friction: x, y [m], theta [rad], table frame; theta is not wrapped
    poses: Array  # (k, s, 3) with each of the samples, whose shares are those of the model
    modes: npt.NDArray[np.int8]  # (k, s) indices of quasi_static.MODES: how the tip last met the object; FREE if it never did
    covariance: Array  # (k, 3, 3) of the pose that is seen about that of the mean friction: of the samples, and of the misfit


def predict_strokes(
    model: FrictionModel,
    outline: Outline,
    poses: Sequence[Pose],
    lines: Sequence[PushingLine],
    positions: npt.ArrayLike,
    step: float = STEP,
) -> Strokes:
    """Bring the tip on each of k lines to a stroke position, and move the object out of its way.

    The method is that of `simulation.PushedObject.push`, for all strokes at once. Each step finds where the tip touches the
    object, measures from there what is left to push, and takes the motion halfway for the whole step. An object behind
    stroke position 0 stays where it is.

    Args:
        model: of the object.
        outline: of the object, object frame.
        poses: (k,) where the object lies before each stroke, table frame.
        lines: (k,) of the tip, table frame.
        positions: (k,) stroke position of the tip at the end of each [m].
        step: longest advance of the tip in one step [m].
    Raises:
        ValueError: poses, lines and positions differ in length, the step is not positive, a number is not finite, a position is
            beyond LARGEST, or a tip starts inside an object.
        SolverFailed: a motion did not converge.

    Example:
        >>> from pushfric_core import TABLE_1, FrictionModel, Pose, PushingLine, predict_strokes
        >>> known = TABLE_1["wood_rect4"]
        >>> model, line = FrictionModel.of(known.support, known.mu_c), PushingLine((0.0, -0.1), (0.0, 1.0), 0.003)
        >>> strokes = predict_strokes(model, known.outline, [Pose(0.0, 0.0, 0.0)], [line], [0.075])
        >>> round(float(strokes.means[0, 1]), 3)
        0.01
    """
    return finished(stroke_steps(model, outline, poses, lines, positions, step))


def stroke_steps(
    model: FrictionModel,
    outline: Outline,
    poses: Sequence[Pose],
    lines: Sequence[PushingLine],
    positions: npt.ArrayLike,
    step: float = STEP,
) -> Generator[None, None, Strokes]:
    """As `predict_strokes`, but pauses after each step, for a program that has other things to do meanwhile."""
    stops = as_array(positions)
    if not len(poses) == len(lines) == len(stops) or stops.ndim != 1:
        lengths = f"{len(poses)}, {len(lines)} and {len(stops)}"
        raise ValueError(f"poses, lines and positions must have the same length, got {lengths}")
    if not step > 0:
        raise ValueError(f"step must be positive, got {step:g} m")
    check_within("positions", stops, LARGEST, "m")
    if not np.isfinite(as_array(poses)).all():
        raise ValueError("poses must be finite")
    w, mu_c = model.with_mean
    k, s = len(stops), len(w)
    state = as_array(poses).reshape(-1, 3)
    origins = as_array([line.origin for line in lines]).reshape(-1, 2)
    directions = as_array([line.direction for line in lines]).reshape(-1, 2)
    radii = as_array([line.tip_radius for line in lines])
    ahead = _ahead(outline, state, origins, directions, radii)  # of each stroke: at first, all its samples are alike
    rows = np.repeat(np.arange(k), s)
    state, origins, directions, radii, stops = (each[rows] for each in (state, origins, directions, radii, stops))
    modes, ways = np.full(len(rows), quasi_static.FREE, dtype=np.int8), np.zeros(len(rows))
    going = np.flatnonzero(ahead[rows])
    samples = np.tile(np.arange(s), k)
    while len(going):
        pose = state[going]
        motion = _Motion(
            (model.support_points, w, mu_c), outline, origins[going], directions[going], radii[going], samples[going]
        )
        distances, twists, _ = motion.at(pose)
        pushed = stops[going] - distances > TOUCHING
        depths = np.where(pushed, np.minimum(stops[going] - distances, step), 0.0)
        halfway = _moved(pose, twists * (depths / 2)[:, None])
        _, twists, mode = motion.at(halfway, twists)
        state[going] = _moved(pose, twists * depths[:, None])
        modes[going] = np.where(pushed, mode, modes[going])
        ways[going] += depths
        going = going[pushed]
        yield
    ends, count = state.reshape(k, s, 3), len(model.w)
    means, poses_of_samples = ends[:, -1], ends[:, :count]
    off = model.stroke_misfit * ways.reshape(k, s)[:, -1]
    covariance = scattered(poses_of_samples, means, model.share) + of_misfit(model, off, means[:, 2])
    return Strokes(means, poses_of_samples, modes.reshape(k, s)[:, :count], covariance)


def _ahead(outline: Outline, poses: Array, origins: Array, directions: Array, radii: Array) -> npt.NDArray[np.bool_]:
    """Whether the objects at poses (r, 3) are not wholly behind the tips. Raises ValueError if a tip starts inside one."""
    starts, along = _turned(origins - poses[:, :2], -poses[:, 2]), _turned(directions, -poses[:, 2])
    first = outline.first_touches(starts, along, radii).distances
    last = -outline.first_touches(starts, -along, radii).distances
    for row in np.flatnonzero((first < -np.maximum(radii, OVERLAP)) & (last > 0)):
        where = f"{origins[row].tolist()} m, {-1e3 * first[row]:.1f} mm inside the object at {poses[row, :2].tolist()} m"
        raise ValueError(f"a tip starts at {where}, expected it beside or before the object")
    return np.asarray(last > 0)


class _Motion:
    """The motion per metre of stroke of some rows: each a line, and a sample of the friction: support points, w and mu_c."""

    def __init__(
        self,
        friction: tuple[Array, Array, Array],
        outline: Outline,
        origins: Array,
        directions: Array,
        radii: Array,
        samples: npt.NDArray[np.int64],
    ) -> None:
        self._friction, self._outline = friction, outline
        self._origins, self._directions, self._radii, self._samples = origins, directions, radii, samples

    def at(self, poses: Array, otherwise: Array | None = None) -> tuple[Array, Array, npt.NDArray[np.int8]]:
        """Stroke positions (r,) of the touch, twists (r, 3) and modes (r,) at poses (r, 3).

        If the tip passes by, the position is infinite and the twist zero, or that of `otherwise`.
        """
        starts = _turned(self._origins - poses[:, :2], -poses[:, 2])
        directions = _turned(self._directions, -poses[:, 2])
        touches = self._outline.first_touches(starts, directions, self._radii)
        met = np.isfinite(touches.distances)
        twists = np.zeros((len(poses), 3)) if otherwise is None else otherwise.copy()
        modes = np.full(len(poses), quasi_static.FREE, dtype=np.int8)
        support_points, w, mu_c = self._friction
        twists[met], modes[met] = quasi_static.motions_of_rows(
            support_points,
            w,
            mu_c[self._samples[met]],
            self._samples[met],
            touches.points[met],
            touches.normals[met],
            directions[met],
        )[:2]
        return touches.distances, twists, modes


def _turned(vectors: Array, angles: Array) -> Array:
    """Vectors (r, 2) turned by angles (r,)."""
    c, s = np.cos(angles), np.sin(angles)
    return np.column_stack((c * vectors[:, 0] - s * vectors[:, 1], s * vectors[:, 0] + c * vectors[:, 1]))


def _moved(poses: Array, twists: Array) -> Array:
    """Poses (r, 3) after a unit of time of constant body twists (r, 3): `planar.compose` with `planar.exp`, row by row."""
    angle = twists[:, 2]
    along = np.sinc(angle / np.pi)
    across = np.sin(angle / 2) * np.sinc(angle / (2 * np.pi))
    shift = np.column_stack((along * twists[:, 0] - across * twists[:, 1], across * twists[:, 0] + along * twists[:, 1]))
    return np.column_stack((poses[:, :2] + _turned(shift, poses[:, 2]), poses[:, 2] + angle))
