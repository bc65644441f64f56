"""Strokes of the exported models in MuJoCo, compared with predictions."""

from collections.abc import Callable, Iterator, Sequence

import mujoco
import numpy as np

from bench.display import Figures, Verdict
from bench.public_pushes import Line
from pushfric_core import TABLE_1, Outline, PushingLine, export, predict_strokes
from pushfric_core.geometry.planar import Array, Pose
from pushfric_core.mechanics.prediction import FrictionModel

SPEED = 0.01
"""Of the tip [m/s]: slow enough to be quasi-static."""

APPROACH = 0.002
"""The tip begins this far in front of the object [m]."""

REST = 300
"""Steps after a stroke, in which the tip comes to rest."""

STROKE, STROKES, TIP_RADIUS = 0.05, 50, 0.005
"""Length [m], number for each object, and radius of the tip [m]."""

OBJECTS = tuple(TABLE_1)


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


def measure(progress: Callable[[str], None]) -> Figures:
    """Strokes of all objects of Table 1 with their true friction, in MuJoCo, against `predict_strokes`.

    Returns:
        {"strokes": [{"object", "median_mm", "p90_mm", "median_deg", "p90_deg"}]}: how far apart they end.
    """
    rows = []
    for number, name in enumerate(OBJECTS):
        progress(f"MuJoCo: {name}")
        known = TABLE_1[name]
        model = FrictionModel.of(known.support, known.mu_c)
        (scene,) = export(model, known.outline, "mjcf", pusher_radius=TIP_RADIUS).values()
        chosen = strokes(known.outline, TIP_RADIUS, np.random.default_rng(number), STROKES, STROKE)
        apart, turned = distances(scene, model, known.outline, chosen)
        found = {"object": name}
        for unit, values in (("mm", 1e3 * apart), ("deg", np.degrees(turned))):
            found[f"median_{unit}"], found[f"p90_{unit}"] = np.percentile(values, (50, 90)).tolist()
        rows.append(found)
    return {"strokes": rows}


def verdicts(figures: Figures) -> Iterator[Verdict]:
    """The targets, next to what was measured."""
    for row in figures["strokes"]:
        for unit, asked in (("mm", 0.5), ("deg", 1.0)):
            yield Verdict.at_most(f"stroke in MuJoCo, {row['object']}, {unit}", asked, row[f"median_{unit}"])
