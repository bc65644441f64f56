"""`./pushfric run CELL --simulated` and `--simulated-camera`: the user's own files, simulated parts, the whole graph."""

import json
import os
import pty
import re
import shlex
import shutil
import subprocess
import time
import urllib.request

import pytest
import yaml
from calls import PROGRAM, all_was_seen, pushfric
from documents import ROOT, blocks, has_the_form, sessions
from typer.testing import CliRunner

from pushfric_core.commands.cli import app
from pushfric_core.simulated.grbl_firmware import SimulatedGrbl
from pushfric_ros.commands.demo import demo_cell

OBJECT = """
name: box
outline: [[-0.06, -0.03], [0.06, -0.03], [0.06, 0.03], [-0.06, 0.03]]
support: {points: [[-0.05, -0.02], [0.05, -0.02], [0.05, 0.02], [-0.05, 0.02]]}
"""
PATIENT = {"silence": 60.0, "owner_timeout": 60.0, "requires_timeout": 60.0, "memory": "", "retract_speed": 0.1}


@pytest.fixture
def cell(tmp_path):
    """The path of a cell's file, whose controller is at tmp_path / "tty"."""
    demo_cell("wood_rect4", tmp_path)  # writes the camera's calibration
    (tmp_path / "object.yaml").write_text(OBJECT)
    pushes = [{"edge": 0, "offset": 0.03}, {"edge": 2, "offset": 0.02}]
    (tmp_path / "plan.yaml").write_text(json.dumps({"pushes": pushes}))
    content = {
        "object": "object.yaml",
        "camera": {"source": "0", "calibration": "camera.yaml"},
        "pusher": {"port": str(tmp_path / "tty"), "line_origin": [0, 0], "line_direction": [0, 1], "tip_radius": 0.003,
                   "stroke": 0.06, "max_speed": 0.1, **PATIENT},
        # in real time, a busy machine sees a slow push often enough
        "plan": {"file": "plan.yaml", "distance": 0.03, "speed": 0.008, "lost_object": 60.0, "lost_result": 60.0},
        "simulation": {"contact_friction": 0.4},
    }  # fmt: skip
    (tmp_path / "cell.yaml").write_text(json.dumps(content))
    return tmp_path / "cell.yaml"


def run(cell, *options) -> subprocess.CompletedProcess:
    return pushfric("run", cell, "--headless", "--bag", cell.parent / "bag", *options)


def on_a_terminal(*arguments) -> str:
    """What the command line shows on a terminal, when it has ended well."""
    master, terminal = pty.openpty()
    command = [*PROGRAM, *arguments]
    shown = b""
    with subprocess.Popen(command, stdin=terminal, stdout=terminal, stderr=terminal) as process:
        os.close(terminal)
        try:
            while piece := os.read(master, 65536):
                shown += piece
        except OSError:  # the last process with this terminal has ended
            pass
        os.close(master)
    drawn_again = shown.decode().replace("\x1b[2K", "\n")
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]|\r", "", drawn_again)
    assert process.returncode == 0, text
    return text


def estimate(bag, code: int = 0) -> dict:
    result = pushfric("estimate", bag, "--json")
    assert result.returncode == code, result.stderr
    return json.loads(result.stdout)


TUTORIAL = "docs/tutorial.md"


def test_the_object_of_the_tutorial(tmp_path, monkeypatch):
    """Its files, its commands in its order, and what they are said to print; nothing of a real cell is there."""
    folder = tmp_path / "my_cell"
    shutil.copytree(ROOT / "docs/example_cell", folder)
    for block in blocks(TUTORIAL):
        if block.file:
            (tmp_path / block.file).write_text(block.text)
    file = yaml.safe_load((folder / "cell.yaml").read_text())
    file["plan"] |= {"lost_result": 60.0}
    (folder / "cell.yaml").write_text(yaml.safe_dump(file))
    commands = [one for block in blocks(TUTORIAL) if block.language == "console" for one in sessions(block)]
    first = next(index for index, (command, _) in enumerate(commands) if command.startswith("./pushfric run "))
    monkeypatch.chdir(tmp_path)
    for index, (command, expected) in enumerate(commands[first:]):
        arguments = shlex.split(command)[1:]
        said = CliRunner().invoke(app, arguments, catch_exceptions=False).output if index else on_a_terminal(*arguments)
        # the noise decides whether mu_c comes from slip, the computer whether the belief came before the next push
        varies = re.compile(r"^mu_c .*\n|(?<=\d) +(-|\d+\.\d\d) +(over \S+|\S+\.\.\S+|-)(?= +\S+$)", re.MULTILINE)
        said, expected = (varies.sub("", text) for text in (said, expected))
        assert has_the_form(said, expected), f"{command} prints\n{said}"
    assert (tmp_path / "my_box.png").stat().st_size > 10_000
    last = estimate(tmp_path / "runs/my_box")
    assert last["pushes"] == 6
    assert last["center_of_friction"] == pytest.approx([0.01, -0.01], abs=0.002)


def test_the_rendered_camera_follows_a_real_tip(cell):
    with SimulatedGrbl(time.monotonic, restarts=False) as controller:
        (cell.parent / "tty").symlink_to(controller.port)
        seen = all_was_seen(run(cell, "--simulated-camera"))
        assert controller.position() == pytest.approx(0.0, abs=1e-9)
    last = estimate(cell.parent / "bag", code=1)  # two pushes cannot tell how far p_CF is off
    assert last["pushes"] == 2
    if seen:
        assert last["center_of_friction"] == pytest.approx([0.0, 0.0], abs=0.02)


def test_a_run_that_a_person_ends_says_how_to_go_on(cell):
    """It is ended on its page, after the first push. Switches and sensors of the real controller do not hold it up."""
    content = json.loads(cell.read_text())
    content["pusher"] |= {"home": True, "axis": "-X", "max_force": 5.0, "enable_timeout": 1.0}
    cell.write_text(json.dumps(content))
    plan = cell.parent / "plan.yaml"  # a busy machine may tell of the first push while others go on
    plan.write_text(json.dumps({"pushes": 4 * json.loads(plan.read_text())["pushes"]}))
    command = ["run", str(cell), "--simulated", "--view", "0", "--headless", "--bag", str(cell.parent / "bag")]
    with subprocess.Popen([*PROGRAM, *command], stderr=subprocess.PIPE, text=True) as ended:
        url = next(line.split()[1] for line in ended.stderr if line.startswith("view: http"))
        for line in ended.stderr:
            if line.startswith("push   1 "):
                break
        with urllib.request.urlopen(urllib.request.Request(f"{url}end", method="POST"), timeout=60) as answer:
            assert json.load(answer)["done"]
        said = ended.stderr.read()
    assert ended.returncode == 0, said
    go_on = re.escape(f"the plan is not finished; go on with: ./pushfric run {cell} --start ")
    assert re.search(f"^{go_on}[2-8] --simulated$", said, re.MULTILINE)
    assert "report.html" in said
