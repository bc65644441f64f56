"""Numbers in other units than SI are refused in one line, which asks for the unit in which they would make sense."""

import pathlib
import re

import pytest
import yaml
from problems import save_csv

from pushfric_core.commands import cli
from pushfric_core.errors import InvalidInput
from pushfric_core.files.object_file import load_object
from pushfric_core.files.plan_file import load_plan
from pushfric_core.plausible import FARTHEST, FASTEST, FASTEST_TURN, LARGEST, LONGEST, STRONGEST

OUTLINE = [[-0.06, -0.04], [0.06, -0.04], [0.06, 0.04], [-0.06, 0.04]]
CONTACT = {"contact_x": 0.02, "contact_y": -0.04, "normal_x": 0, "normal_y": -1}
OBSERVATION = CONTACT | {"vx": 0.001, "vy": 0.02, "omega": 0.1, "push_id": 0}
MOVED = CONTACT | {"tip_vx": 0.001, "tip_vy": 0.02}
CELL = {
    "object": "object.yaml",
    "camera": {"calibration": "camera.yaml"},
    "pusher": {"port": "/dev/none", "line_origin": [0, 0], "line_direction": [0, 1]}
    | {"tip_radius": 0.003, "stroke": 0.06, "max_speed": 0.1},
    "plan": {"file": "plan.yaml"},
}

FILES = {
    "object.yaml": {"name": "block", "outline": OUTLINE, "support": {"grid": [3, 3]}},
    "plan.yaml": {"pushes": [{"edge": 0, "offset": 0.02}]},
    "points.csv": [{"x": x, "y": y} for x, y in OUTLINE],
    "data.csv": [OBSERVATION, OBSERVATION | {"contact_x": -0.03, "omega": -0.2, "push_id": 1}],
    "moved.csv": [MOVED],
    "cell.yaml": CELL,
}
"""Right files, in SI units."""


def write(folder, files):
    for name, content in files.items():
        if name.endswith(".yaml"):
            (folder / name).write_text(yaml.safe_dump(content))
        else:
            save_csv(folder / name, content[0], *(row.values() for row in content))


ESTIMATE = ("estimate", "data.csv", "--object", "object.yaml", "--json")
PREDICT = ("predict", "data.csv", "--object", "object.yaml", "--pushes", "moved.csv")
WITH_CELL = ("security", "cell.yaml", "--out", "policy")


def changed(name, **values):
    content = FILES[name]
    return {name: [content[0] | values, *content[1:]] if isinstance(content, list) else content | values}


def in_cell(section, **values):
    return {"cell.yaml": CELL | {section: CELL[section] | values}}


WRONG = [
    (
        ESTIMATE,
        changed("object.yaml", support={"spacing": 20}),
        "spacing must lie in (0, 0.12] m, got 20: are these millimetres?",
    ),
    (ESTIMATE, changed("object.yaml", height=30), "height: the number must lie within 3 m, got 30: are these millimetres?"),
    (ESTIMATE, changed("data.csv", contact_x=20, contact_y=-40), "m away: are these millimetres?"),
    (
        ESTIMATE,
        changed("data.csv", vx=1, vy=20),
        "vx, vy, omega must lie within 10 m/s, got (1.0, 20.0): are these millimetres per second?",
    ),
    (PREDICT, changed("moved.csv", tip_vy=20), "tip_vy must lie within 10 m/s, got 20: are these millimetres per second?"),
    (WITH_CELL, in_cell("pusher", line_origin=[0, -150]), "got (0.0, -150.0): are these millimetres?"),
    (WITH_CELL, in_cell("plan", distance=50), "distance must lie in [0.001, 10.0], got 50.0: are these millimetres?"),
    (WITH_CELL, in_cell("plan", angle_tolerance=10), "got 10.0: are these degrees?"),
    ((*ESTIMATE, "--half-width", 25), {}, "half_width must lie in [0.0, 1.0], got 25.0: are these millimetres?"),
    (("jog", 5), {}, "distance must lie in [-0.5, 0.5] m, got 5: are these millimetres?"),
    (("rehearse", "--port", "/dev/none", "--stroke", 0.06, "--speed", 20), {}, "are these millimetres per second?"),
    (("calibrate", "board", "board.pdf", "--square", 28), {}, "smaller than 1 m, got 28: are these millimetres?"),
]


def test_every_option_is_in_si_units():
    """What is printed is in millimetres; what is asked for, never."""
    names = [name for name in cli.catalog() if name != "calibrate"]
    options = [one for name in names for one in cli.load(name).params]
    options += [one for name, command in cli.load("calibrate").commands.items() for one in command.params]
    units = {unit for one in options for unit in re.findall(r"\[([a-z/^0-9]+)\]", one.help or "")}
    assert units == {"bit/s", "kg", "m", "m/s", "m/s^2", "rad", "s"}


@pytest.mark.parametrize(("arguments", "change", "question"), WRONG, ids=lambda one: str(one)[:60])
def test_other_units_are_refused_with_a_question(call, tmp_path, monkeypatch, arguments, change, question):
    write(tmp_path, FILES | change)
    monkeypatch.chdir(tmp_path)
    said = call(*arguments)
    assert said.returncode == 2
    assert question in said.stderr.strip().splitlines()[-1]


def test_the_document_names_the_bounds():
    text = " ".join((pathlib.Path(__file__).parents[3] / "docs/files.md").read_text(encoding="utf-8").split())
    lengths = f"objects longer than {LARGEST:g} m, coordinates beyond {FARTHEST:g} m"
    speeds = f"speeds beyond {FASTEST:g} m/s and {FASTEST_TURN:g} rad/s, forces beyond {STRONGEST / 1e3:g} kN"
    assert f"{lengths}, {speeds}, observations that take longer than {LONGEST:g} s" in text


def test_a_plan_in_millimetres_is_refused_with_a_question(tmp_path):
    write(tmp_path, FILES | changed("plan.yaml", pushes=[{"edge": 0, "offset": 20}]))
    with pytest.raises(
        InvalidInput, match=r"plan.yaml: pushes.0: offset must lie within 0.06 m .* 20 m: are these millimetres\?"
    ):
        load_plan(str(tmp_path / "plan.yaml"), load_object(str(tmp_path / "object.yaml")))
