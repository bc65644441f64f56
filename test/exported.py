"""Objects to export, and strokes in MuJoCo to be compared with those that `predict_strokes` predicts."""

import mujoco
import numpy as np

from pushfric_core import TABLE_1, FrictionModel, Outline, Pose, PushingLine, Support, predict_strokes

SPEED = 0.01
"""Of the tip [m/s]: slow enough to be quasi-static."""

APPROACH = 0.002
"""The tip begins this far in front of the object [m]."""

REST = 300
"""Steps after a stroke, in which the tip comes to rest."""


def even(outline, mu_c):
    """A model with uniform pressure."""
    points = outline.grid(9, 9, inset=0.004)
    return outline, FrictionModel.of(Support(points, np.full(len(points), 1 / len(points))), mu_c)


OBJECTS = {name: (known.outline, FrictionModel.of(known.support, known.mu_c)) for name, known in TABLE_1.items()}
OBJECTS["triangle"] = even(Outline([(0.0, 0.0), (0.12, 0.0), (0.0, 0.09)]), 0.25)
OBJECTS["ell"] = even(Outline([(0, 0), (0.12, 0), (0.12, 0.04), (0.05, 0.04), (0.05, 0.1), (0, 0.1)]), 0.25)


def strokes(outline, tip_radius, rng, count, length):
    """Poses, lines and stroke positions of strokes that push an object over this length, from all sides."""
    found = []
    middle = outline.lower + outline.size / 2
    while len(found) < count:
        theta, aside = rng.uniform(-np.pi, np.pi), rng.uniform(-0.35, 0.35) * outline.size.min()
        c, s = np.cos(theta), np.sin(theta)
        pose = Pose(*(-np.array(((c, -s), (s, c))) @ middle).tolist(), theta)
        line = PushingLine((aside, -1.0), (0.0, 1.0), tip_radius)
        touch = line.touch(outline, pose)
        if touch is not None:
            found.append((pose, line, touch.distance, touch.distance + length))
    return found


def pushed(scene, pose, line, begin, end):
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


def distances(scene, model, outline, chosen):
    """How far MuJoCo and the prediction end from each other in each stroke [m], [rad]."""
    poses, lines, _, ends = zip(*chosen, strict=True)
    predicted = predict_strokes(model, outline, poses, lines, ends).means
    apart = np.array([pushed(scene, *one) for one in chosen]) - predicted
    return np.hypot(apart[:, 0], apart[:, 1]), np.abs(apart[:, 2])
