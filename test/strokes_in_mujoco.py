"""Strokes of the exported models in MuJoCo, compared with predictions."""

from collections.abc import Sequence

import mujoco
import numpy as np

from bench.public_pushes import Line
from pushfric_core import Outline, PushingLine, predict_strokes
from pushfric_core.geometry.planar import Array, Pose
from pushfric_core.mechanics.prediction import FrictionModel

SPEED = 0.01
"""Of the tip [m/s]: slow enough to be quasi-static."""

APPROACH = 0.002
"""The tip begins this far in front of the object [m]."""

REST = 300
"""Steps after a stroke, in which the tip comes to rest."""


def strokes(outline: Outline, tip_radius: float, rng: np.random.Generator, count: int, length: float) -> list[Line]:
    """Strokes that push an object over this length [m], from all sides."""
    found: list[Line] = []
    middle = outline.lower + outline.size / 2
    while len(found) < count:
        theta, aside = rng.uniform(-np.pi, np.pi), rng.uniform(-0.35, 0.35) * outline.size.min()
        c, s = np.cos(theta), np.sin(theta)
        x, y = (-np.array(((c, -s), (s, c))) @ middle).tolist()
        pose = Pose(x, y, theta)
        line = PushingLine((aside, -1.0), (0.0, 1.0), tip_radius)
        touch = line.touch(outline, pose)
        if touch is not None:
            found.append(Line(pose, line, touch.distance, touch.distance + length))
    return found


def pushed(scene: str, pose: Pose, line: PushingLine, begin: float, end: float) -> Array:
    """Pose (3,) after the tip has moved along a line from just before stroke position `begin` to `end` [m]."""
    model = mujoco.MjModel.from_xml_string(scene)
    data = mujoco.MjData(model)
    origin, direction = line.origin - model.body("pusher").pos[:2], np.array(line.direction)
    begin -= APPROACH
    place = [*pose, *(origin + begin * direction)]
    for joint, value in zip(("x", "y", "theta", "pusher_x", "pusher_y"), place, strict=True):
        data.joint(joint).qpos = value
    positions = np.arange(begin, end, SPEED * model.opt.timestep)
    for position in (*positions, *np.full(REST, end)):
        data.ctrl[:] = origin + position * direction
        mujoco.mj_step(model, data)
    return np.array([data.joint(joint).qpos[0] for joint in ("x", "y", "theta")])


def distances(scene: str, model: FrictionModel, outline: Outline, chosen: Sequence[Line]) -> tuple[Array, Array]:
    """How far MuJoCo and the prediction end from each other in each stroke [m], [rad]."""
    poses, lines, _, ends = zip(*chosen, strict=True)
    predicted = predict_strokes(model, outline, poses, lines, ends).means
    x, y, turned = (np.array([pushed(scene, *one) for one in chosen]) - predicted).T
    return np.hypot(x, y), np.abs(turned)
