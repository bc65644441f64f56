"""The exported object slides in MuJoCo as `predict_strokes` says, whatever table and tip it meets."""

import re

import mujoco
import numpy as np
import pytest
from exported import OBJECTS

from bench.simulators import distances, strokes
from pushfric_core import export

TIP = 0.005


@pytest.mark.parametrize("name", ["wood_rect4", "delrin_rect_right", "triangle"])
def test_strokes_of_50_mm_end_where_they_are_predicted(name, rng):
    outline, model = OBJECTS[name]
    (scene,) = export(model, outline, "mjcf", mass=0.3, pusher_radius=TIP).values()
    apart, turned = distances(scene, model, outline, strokes(outline, TIP, rng, 6, 0.05))
    assert np.median(apart) <= 0.5e-3
    assert np.median(turned) <= np.radians(1.0)


def test_any_table_and_any_tip_meet_the_object_with_its_coefficients():
    outline, model = OBJECTS["wood_rect4"]
    (scene,) = export(model, outline, "mjcf", table_friction=0.2).values()
    slippery = re.sub(r'name="(table|pusher)" type', r'name="\1" friction="0.9 0.005 0.0001" type', scene)
    assert slippery.count("0.9 0.005") == 2
    loaded = mujoco.MjModel.from_xml_string(slippery)
    data = mujoco.MjData(loaded)
    data.joint("pusher_y").qpos = 0.0201  # 0.1 mm into the edge, from 20 mm in front of it
    mujoco.mj_forward(loaded, data)
    found = {loaded.geom(max(contact.geom)).name: contact.friction[0] for contact in data.contact}
    assert found == {"pusher": pytest.approx(model.mean_mu_c), **{f"foot_{k}": pytest.approx(0.2) for k in range(4)}}


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
