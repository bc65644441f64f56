"""Wrong input ends with one line that says what, where and what was expected, and exit code 2."""

import json
import os
import pathlib
import re
import shutil
import subprocess
import sys

import pytest
from calls import pushfric

from pushfric_core.commands import cli
from pushfric_core.vision.camera import Camera, save_camera

COMMANDS = cli.catalog()

ROOT = pathlib.Path(__file__).resolve().parents[2]
BAG = ROOT / "bags/rubber_rect4"
HEADER = "contact_x,contact_y,normal_x,normal_y,vx,vy,omega,push_id\n"


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["demo", "--object", "brick"], "no object 'brick' in the simulated cell; expected one of delrin_square3"),
        (["demo", "--plan", "none.yaml"], "none.yaml: cannot be read"),
        (["demo", "--plan", "plan.yaml", "--choose", "5"], "give --plan or --choose, not both"),
        (["estimate", "good.csv", "--json", "x.json", "--ledger", "./x.json"], "--json and --ledger name the same file, "),
        (["region", "--object", "rubber_rect4", "--exclude-push", "3"], "--exclude-push, --partial and --namespace are for"),
        (["estimate", "x", "--exclude-push", "3", "--keep-push", "3"], "give --exclude-push 3 or --keep-push 3, not both"),
        (["region"], "give a bag, or --object OBJ.yaml or one of delrin_square3"),
        (
            ["estimate", "good.csv", "--object", "rubber_rect4", "--figure", "x.abc"],
            "x.abc: not the name of an image; expected one that ends",
        ),
        (["demo", "--json", "good.csv/x.json"], "good.csv: the folder cannot be created: "),
        (["replay", "nothing"], "nothing: no such file; expected a bag or a CSV"),
        (["replay", "nothing", "--rate", "0"], "--rate: expected a number from 0.01 to 1000, got '0'"),
        (["estimate", "nothing", "--object", "rubber_rect4"], "nothing: no such file"),
        (["view", "nothing"], "nothing: no such file"),
        (["estimate", "data.csv"], "data.csv does not name the pushed object; give --object"),
        (["estimate", "data.csv", "--object", "no_outline.yaml"], "no_outline.yaml: outline: expected a value, got only name"),
        (["estimate", "data.csv", "--object", "rubber_rect4"], "data.csv, line 2: vx must be finite, got nan"),
        (["replay", "runs"], "runs: is a folder of bags, expected one of them: runs/cut, runs/whole"),
        (
            ["estimate", "good.csv", "--object", "rubber_rect4", "--exclude-push", "5"],
            "no observation of push 5, which is to be left out",
        ),
        (
            ["estimate", "good.csv", "--object", "rubber_rect4", "--slipping-push", "7"],
            "no observation of push 7, which is to be left out, kept, or said to slip",
        ),
        (["estimate", "good.csv", "--object", "rubber_rect4", "--figure", "x.pgf"], "x.pgf: not the name of an image"),
        (["estimate", "good.csv", "--object", "rubber_rect4", "--save", "a" * 300 + ".yaml"], ".yaml: File name too long"),
        (["calibrate", "table", "none.csv", "--camera", "none.yaml"], "none.yaml"),
        (["run", "none.yaml"], "none.yaml: cannot be read"),
        (["doctor", "no_outline.yaml", "--json"], "no_outline.yaml: "),
        (["demo", "--json=."], ".: expected the name of a file to write that ends in .json"),
        (["estimate", "data.csv", "good.csv"], "got 2 inputs; expected one, or --out DIR"),
        (["push"], "no such command 'push'; see pushfric --help"),
        (["estimat", "x"], "no such command 'estimat'; did you mean estimate? see pushfric --help"),
        (["demo", "--sed", "1"], "no such option '--sed'; did you mean --seed? see pushfric demo --help"),
        (["demo", "--seed", "x"], "--seed: expected a whole number from 0 to 2147483648, got 'x'; see pushfric demo --help"),
        (["jog", "far"], "DISTANCE: expected a number, got 'far'; see pushfric jog --help"),
        (["estimate", "x", "--loss", "l3"], "--loss: expected l1 or l2, got 'l3'"),
        (["estimate"], "INPUT... is missing: Bag (folder or .mcap), or CSV of observations; see pushfric estimate --help"),
        (["estimate", "x", "--solver"], "--solver: expected simplex|osqp; see pushfric estimate --help"),
        (["predict", "x"], "--pushes is missing: "),
        (
            ["predict", "no_outline.yaml", "--pushes", "good.csv"],
            "no_outline.yaml: not a model, as `estimate --save` writes it",
        ),
        (["demo", "--headless", "3"], "unexpected '3'; see pushfric demo --help"),
        (["stop", "--cell", "x"], "no such option '--cell'; see pushfric stop --help"),
        (["calibrate"], "expected a command: board or markers or lens or table or tip; see pushfric calibrate --help"),
        ([], "expected a command; see pushfric --help"),
    ],
)
def test_wrong_input_gives_one_line_and_exit_code_2(tmp_path, monkeypatch, call, arguments, error):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data.csv").write_text(HEADER + "0.05,0,0,-1,nan,0.02,0,0\n")
    (tmp_path / "good.csv").write_text(HEADER + "0.05,-0.032,0,-1,0,0.02,0,0\n")
    (tmp_path / "no_outline.yaml").write_text("name: x\n")
    save_camera(Camera.looking_down(640, 480, (0.0, 0.0), 1e-3), tmp_path / "lens.yaml")
    for name in ("runs/whole/metadata.yaml", "runs/cut/cut_0.mcap", "runs/bench.png"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    run = call(*arguments)
    assert run.returncode == 2, run.stderr
    assert error in run.stderr
    assert run.stderr.count("\n") == 1
    assert run.stdout == ""


@pytest.fixture
def cell(tmp_path):
    """The folder of the example's files."""
    shutil.copytree(ROOT / "docs/example_cell", tmp_path / "my_cell")
    save_camera(Camera.looking_down(640, 480, (0.0, 0.06), 0.000625), tmp_path / "my_cell/camera.yaml")
    return tmp_path / "my_cell"


def test_a_run_is_not_recorded_where_another_one_is(cell, call):
    """Its report would be written over the other one's."""
    run = call("run", cell / "cell.yaml", "--simulated", "--bag", cell, "--headless")
    assert (run.returncode, run.stdout) == (2, "")
    assert run.stderr == f"error: {cell}: already holds files, expected a new or empty folder for the bag\n"


@pytest.mark.parametrize("missing", ["object.yaml", "plan.yaml", "camera.yaml"])
def test_a_missing_file_of_a_cell_is_named_before_anything_starts(cell, tmp_path, missing):
    (cell / missing).unlink()
    run = pushfric("run", cell / "cell.yaml", "--simulated", "--bag", tmp_path / "bag", "--headless")
    assert run.returncode == 2
    (line,) = run.stderr.splitlines()
    assert line.startswith("error: ")
    assert str(cell / missing) in line
    assert not (tmp_path / "bag").exists()


def test_an_existing_bag_is_not_overwritten(tmp_path, call):
    (tmp_path / "metadata.yaml").write_text("precious")
    run = call("demo", "--bag", tmp_path)
    assert run.returncode == 2
    assert "expected a new or empty folder" in run.stderr
    assert (tmp_path / "metadata.yaml").read_text() == "precious"


LIST_AND_LOADED = """
import sys
from pushfric_core.commands import cli
sys.argv[1:] = ["--help"]
try:
    cli.main()
finally:
    print(*sys.modules)
"""


def test_the_list_of_commands_loads_none_of_them():
    run = subprocess.run([sys.executable, "-c", LIST_AND_LOADED], capture_output=True, text=True, timeout=60)
    assert all(f"\n  {name} " in run.stdout for name in COMMANDS)
    loaded = run.stdout.splitlines()[-1].split()
    assert "typer" in loaded
    assert not {"rclpy", "numpy", "matplotlib", "scipy", "cv2", "pydantic"} & {*loaded}


def test_no_node_of_a_cell_loads_what_only_few_runs_need():
    nodes = [f"pushfric_ros.nodes.{name}" for name in ("tracker", "actuator", "estimator", "experiment", "recorder", "view")]
    program = f"import sys, {', '.join(nodes)}; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    loaded = run.stdout.split()
    assert {*nodes} <= {*loaded}
    assert not {"scipy", "matplotlib", "osqp", "dask"} & {*loaded}


@pytest.mark.parametrize(
    "name", ["", *COMMANDS, "bag verify", "bag recover", "calibrate board", "calibrate lens", "calibrate table"]
)
def test_help_fits_80_columns_uncut(call, monkeypatch, name):
    monkeypatch.setenv("COLUMNS", "80")
    said = call(*name.split(), "--help").stdout
    assert COMMANDS.get(name, "") in " ".join(said.split())
    assert max(map(len, said.splitlines())) <= 80
    assert "…" not in said
    assert not re.search(r"[a-z]\.\.\.", said)  # cut short
    assert not re.search(r"\((m|mm|rad|s|N)\)", said)  # units stand in brackets
    assert not re.search(r"<\w|[{}]|\bx[<>]=|: \(", said)  # the words of a person
    assert said == call(*name.split(), "-h").stdout


@pytest.mark.parametrize(
    ("typed", "completed"),
    [("pushfric estim", ["estimate"]), ("pushfric bag v", ["verify"]), ("pushfric jog --sp", ["--speed"])],
)
def test_a_shell_completes_commands_and_options(typed, completed):
    words = {"COMP_WORDS": typed, "COMP_CWORD": str(typed.count(" ")), "_PUSHFRIC_COMPLETE": "complete_bash"}
    run = pushfric(env=os.environ | words)
    assert (run.returncode, run.stdout.split(), run.stderr) == (0, completed, "")


@pytest.mark.parametrize("place", ["before", "after"])
def test_json_without_a_file_is_printed_alone(call, place):
    arguments = ["--json", BAG] if place == "before" else [BAG, "--json"]
    assert json.loads(call("estimate", *arguments).stdout)["pushes"] == 14


def test_json_with_a_file_is_written_there_as_well(call, tmp_path):
    assert call("estimate", BAG, "--json", tmp_path / "result.json").stdout.endswith("from   72 observations of 14 pushes\n")
    assert json.loads((tmp_path / "result.json").read_text())["pushes"] == 14


def test_json_takes_no_input_for_its_file(call, tmp_path):
    data = tmp_path / "data.csv"
    data.write_text(HEADER + "0.05,-0.032,0,-1,0,0.02,0,0\n")
    figures = json.loads(call("region", "--json", data, "--object", "rubber_rect4").stdout)
    assert (figures["data_points"], data.read_text().count("\n")) == (1, 2)
