"""The exported object slides in MuJoCo as `predict_strokes` says, whatever table and tip it meets."""

import mujoco
import numpy as np
import pytest
from exported import OBJECTS
from strokes_in_mujoco import distances, strokes

from pushfric_core import export

TIP = 0.005


@pytest.mark.parametrize("name", ["wood_rect4", "delrin_rect_right", "triangle"])
def test_strokes_of_50_mm_end_where_they_are_predicted(name, rng):
    outline, model = OBJECTS[name]
    (scene,) = export(model, outline, "mjcf", mass=0.3, pusher_radius=TIP).values()
    apart, turned = distances(scene, model, outline, strokes(outline, TIP, rng, 6, 0.05))
    assert np.median(apart) <= 0.5e-3
    assert np.median(turned) <= np.radians(1.0)


def test_feet_bear_the_weights_of_the_support():
    outline, model = OBJECTS["wood_rect3"]
    (scene,) = export(model, outline, "mjcf", mass=0.4).values()
    loaded = mujoco.MjModel.from_xml_string(scene)
    data = mujoco.MjData(loaded)
    mujoco.mj_step(loaded, data, nstep=1000)
    forces = np.zeros((data.ncon, 6))
    for k, force in enumerate(forces):
        mujoco.mj_contactForce(loaded, data, k, force)
    assert forces[:, 0] == pytest.approx(0.4 * 9.81 / 3, rel=1e-4)
