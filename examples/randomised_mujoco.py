"""MuJoCo with a randomised object: the same stroke in scenes drawn from the ensemble of a learned model.

A policy that is trained in all of them meets the friction that the data leave open, and no other. Needs mujoco.

    ./pushfric estimate bags/rubber_rect4 --save model.yaml
    python3 examples/randomised_mujoco.py model.yaml --samples 8
"""

import argparse
import pathlib
from collections.abc import Iterator, Sequence

import mujoco
import numpy as np

from pushfric_core import export
from pushfric_core.files.model_file import load_model
from pushfric_core.geometry.planar import Array

SPEED, LENGTH, APPROACH = 0.01, 0.05, 0.018  # of the tip: it begins 20 mm in front of the object [m/s], [m]


def scenes(path: pathlib.Path, samples: int) -> Iterator[str]:
    """Scenes of a saved model, as likely as its samples."""
    file, known = load_model(path)
    for drawn in file.friction().drawn(samples):
        (scene,) = export(drawn, known.outline, "mjcf", name=known.name, total_friction=file.total_friction).values()
        yield scene


def pushed(scene: str, aside: float) -> Array:
    """Pose (3,) of the object after a stroke along y, this far beside the middle of its edge [m]."""
    model = mujoco.MjModel.from_xml_string(scene)
    data = mujoco.MjData(model)
    data.joint("pusher_x").qpos, data.joint("pusher_y").qpos = aside, APPROACH
    for position in np.arange(APPROACH, 0.02 + LENGTH, SPEED * model.opt.timestep):
        data.ctrl[:] = aside, position
        mujoco.mj_step(model, data)
    return np.array([data.joint(joint).qpos[0] for joint in ("x", "y", "theta")])


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model", type=pathlib.Path, help="model of the object (estimate --save)")
    parser.add_argument("--samples", type=int, default=8, help="number of scenes")
    given = parser.parse_args(arguments)
    ends = np.array([pushed(scene, 0.01) for scene in scenes(given.model, given.samples)])
    for x, y, theta in ends:
        print(f"({1e3 * x:.1f}, {1e3 * y:.1f}) mm, {np.degrees(theta):.1f} degrees")
    x, y, theta = ends.std(axis=0)
    print(f"standard deviation: ({1e3 * x:.2f}, {1e3 * y:.2f}) mm, {np.degrees(theta):.2f} degrees")


if __name__ == "__main__":
    main()
