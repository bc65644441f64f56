"""What docs/files.md and docs/cell.md say is true: the keys of JSON, the example of recognize, the example of a cell."""

import pathlib
import re

import numpy as np
import pytest
import yaml
from calls import figures
from problems import observations_of, save_csv

from docs import reference
from pushfric_core.cell.cell_file import load_cell
from pushfric_core.files.csv_files import REQUIRED
from pushfric_core.files.object_file import load_object
from pushfric_core.files.plan_file import load_plan
from pushfric_core.geometry.support import friction_directions
from pushfric_core.geometry.table_1 import TABLE_1
from pushfric_core.trajectories.ledger import POSES, USED, DoubtCode, Ledger
from pushfric_ros.commands import doctor
from pushfric_ros.commands.doctor import Check, Grade

ROOT = pathlib.Path(__file__).parents[3]
TEXT = (ROOT / "docs/files.md").read_text()

NAME = "delrin_rect_right"
"""An object that looks the same as others, so that it has hypotheses."""


def documented(commands):
    """The keys in the table of these commands."""
    table = TEXT.split(f"\n{commands}:\n\n")[1].split("\n\n")[0]
    return [key for cell in re.findall(r"^\| (`.*?`) \|", table, re.MULTILINE) for key in re.findall(r"`([^`]+)`", cell)]


def keys_of(value, name=""):
    """`a.b` for a key of an object in an object, `a[].b` for one of the objects in a list."""
    if isinstance(value, dict):
        return [key for own, item in value.items() for key in keys_of(item, f"{name}.{own}" if name else own)]
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return keys_of(value[0], f"{name}[]")
    return [name]


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Pushes with measured forces, so that every key appears."""
    known = TABLE_1[NAME]
    rows = []
    for o in observations_of(known.outline, known.support, known.mu_c, 8, np.random.default_rng(3)):
        friction = known.support.weights @ friction_directions(known.support.points, o.twist)
        rows.append((*o.contact_point, *o.contact_normal, *o.twist, o.push_id, *-friction))
    return save_csv(tmp_path_factory.mktemp("data") / "data.csv", (*REQUIRED, "force_x", "force_y"), *rows)


def test_the_keys_of_an_estimate_are_documented(data):
    options = ("--terms", "moment,force", "--slipping-push", 1, "--samples")
    found = figures("estimate", data, "--object", NAME, *options)
    # demo adds these
    found |= {"truth": TABLE_1[NAME].to_dict(), "bag": "runs/demo"}
    assert sorted(keys_of(found)) == sorted(documented("`estimate`, `replay` and `demo`"))


def test_the_keys_of_a_ledger_are_documented():
    ledger = Ledger()
    ledger.accounts[POSES].enter(USED)
    for code in DoubtCode:
        ledger.doubt(code, "a push is missing")
    keys = {key.split(".")[0] if key.startswith("accounts") else key for key in keys_of(ledger.to_dict())}
    assert keys == set(documented("`estimate --ledger`, under the key `ledger`, or `--ledger FILE.json`"))
    assert [code for code in DoubtCode if f"`{code}`" not in TEXT] == []


@pytest.mark.parametrize("command", ["recognize", "region"])
def test_the_keys_of_other_commands_are_documented(data, command):
    assert sorted(keys_of(figures(command, data, "--object", NAME))) == sorted(documented(f"`{command}`"))


def test_the_keys_of_the_doctor_are_documented():
    findings = doctor.findings([Check("port", Grade.OK, "/dev/ttyUSB0", "")])
    assert sorted(keys_of(findings)) == sorted(documented("`doctor`"))


EXAMPLE = ROOT / "docs/example_cell"


def test_the_example_of_a_cell_is_valid(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # its files are relative to its own folder
    cell = load_cell(EXAMPLE / "cell.yaml")
    model = load_object(cell.object)
    plan = load_plan(cell.plan.plan, model)
    assert (cell.object, cell.plan.plan) == (str(EXAMPLE / "object.yaml"), str(EXAMPLE / "plan.yaml"))
    assert (model.name, len(plan)) == ("box", 6)
    assert cell.plan.distance < cell.pusher.stroke


@pytest.mark.parametrize("page", reference.PAGES)
def test_the_tables_of_keys_and_codes_are_those_of_settings_and_messages(page):
    text = (ROOT / "docs" / page).read_text()
    assert reference.PAGES[page](text) == text, f"stale; update it with: {reference.COMMAND}"


def test_the_tables_name_every_key_of_the_example_and_mark_the_required_ones():
    (text,) = re.findall(f"{reference.BEGIN}(.*){reference.END}", (ROOT / "docs/cell.md").read_text(), re.DOTALL)
    for name, section in yaml.safe_load((EXAMPLE / "cell.yaml").read_text()).items():
        assert f"| `{name}` |" in text or f"### `{name}`" in text
        assert all(f"| `{key}` |" in text for key in (section if isinstance(section, dict) else ()))
    required = re.findall(r"^\| `(\w+)` \| \*required\*", text, re.MULTILINE)
    stage = ["line_origin", "line_direction", "tip_radius", "stroke", "max_speed"]
    assert required == ["object", "calibration", *stage, "port", "tip_radius"]
