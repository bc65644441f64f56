"""A cell checked against statics, with simulated pushes of a plate on three feet."""

import csv
import json
import math

import numpy as np
import pytest
from calls import invoked

from pushfric_core import FrictionModel, Observation, Observations, Support, Twist, predict

FEET = np.array([(-0.04, -0.02), (0.04, -0.02), (0.0, 0.02)])
PLATE = {
    "name": "plate",
    "outline": [[-0.06, -0.04], [0.06, -0.04], [0.06, 0.04], [-0.06, 0.04]],
    "support": {"points": FEET.tolist()},
}
MASS, LOAD = 0.1, 0.05  # [kg]
PLACES = {"left": (-0.02, 0.0), "right": (0.02, 0.0)}


def pushes(center) -> Observations:
    """Pushes of the plate, whose feet bear what statics says if its centre of mass is there."""
    weights = np.linalg.solve(np.vstack((FEET.T, np.ones(3))), (*center, 1.0))
    model = FrictionModel.of(Support(FEET, weights), 0.3)
    contacts = [((x, side * 0.04), (0.0, float(side))) for x in (-0.03, 0.0, 0.03) for side in (-1, 1)]
    contacts += [((side * 0.06, 0.01), (float(side), 0.0)) for side in (-1, 1)]
    points, normals = (np.array(column) for column in zip(*contacts, strict=True))
    twists = predict(model, points, normals, -0.02 * normals).twists
    return Observations(
        Observation(point, normal, Twist(*twist), push)
        for push, ((point, normal), twist) in enumerate(zip(contacts, twists.tolist(), strict=True))
    )


@pytest.fixture
def cell(tmp_path):
    """A folder with the data of both loads, and the loads' file."""
    share = LOAD / (MASS + LOAD)
    for name, (x, y) in PLACES.items():
        rows = pushes((share * x, share * y)).to_rows()
        known = [key for key in rows[0] if not math.isnan(rows[0][key])]
        with (tmp_path / f"{name}.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, known, extrasaction="ignore")
            writer.writeheader()
            writer.writerows(rows)
    (tmp_path / "plate.yaml").write_text(json.dumps(PLATE))
    return tmp_path


def check(folder, *options, **changed):
    trials = [{"data": f"{name}.csv", "mass": LOAD, "at": at} for name, at in PLACES.items()]
    (folder / "loads.yaml").write_text(json.dumps({"mass": MASS, "object": "plate.yaml", "trials": trials} | changed))
    return invoked("check-cell", folder / "loads.yaml", *options)


def test_known_loads_are_found(cell):
    ended = check(cell, "--json")
    assert ended.exit_code == 0, ended.output
    left, right = json.loads(ended.stdout)["trials"]
    assert left["expected"] == pytest.approx([-0.02 / 3, 0.0])
    assert right["expected"] == pytest.approx([0.02 / 3, 0.0])
    assert max(left["off"], right["off"]) < 1e-4


def test_a_load_that_lies_elsewhere_than_said_is_a_fault_of_the_cell(cell):
    trials = [{"data": f"{name}.csv", "mass": LOAD, "at": PLACES["left"]} for name in PLACES]
    ended = check(cell, trials=trials)
    assert ended.exit_code == 1
    assert [line.count("✗") for line in ended.stdout.splitlines() if ".csv" in line] == [0, 1]
    assert check(cell, "--limit", "0.02", trials=trials).exit_code == 0


@pytest.mark.parametrize(("changed", "said"), [({"mass": 0}, "mass"), ({"trials": []}, "trials"), ({"mas": 1}, "mas")])
def test_what_is_no_loads_file_is_one_line(cell, changed, said):
    ended = check(cell, **changed)
    assert ended.exit_code != 0
    assert said in str(ended.exception)
