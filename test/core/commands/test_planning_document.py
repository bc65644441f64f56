"""docs/planning.md: its commands and its Python run, in its order, and print what it says."""

import itertools
import json
import pathlib
import re
import shlex

import pytest
from calls import invoked, printed

from pushfric_core.files.model_file import ModelFile

ROOT = pathlib.Path(__file__).parents[3]
TEXT = (ROOT / "docs/planning.md").read_text()
COMMANDS = re.findall(r"^\$ \./pushfric (.*)$", TEXT, re.MULTILINE)
PUSHES, TURNS = re.findall(r"```csv\n(.*?)```", TEXT, re.DOTALL)


def said(command):
    return printed(*shlex.split(command))


def documented(after):
    """The keys of the first table after some words."""
    lines = TEXT.split(after)[1].splitlines()
    first = next(number for number, line in enumerate(lines) if line.startswith("|---")) + 1
    rows = itertools.takewhile(lambda line: line.startswith("|"), lines[first:])
    return [key for row in rows for key in re.findall(r"`([\w.]+)`", row.split("|")[1])]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "bags").symlink_to(ROOT / "bags")
    (tmp_path / "pushes.csv").write_text(PUSHES)
    (tmp_path / "turns.csv").write_text(TURNS)
    monkeypatch.chdir(tmp_path)
    said(COMMANDS[0])
    return tmp_path


def test_the_commands_run_and_print_the_documented_keys(folder):
    lines = [said(command) for command in COMMANDS[1:5]]
    motions, turns = json.loads(lines[1]), json.loads(lines[3])
    assert [list(motion) for motion in motions] == [documented("## Where will it go")] * 3
    assert list(turns[0]) == documented("## Which pushes hold")
    assert [motion["mode"] for motion in motions] == ["sticking", "sticking", "sticking"]
    assert motions[0]["twist"] == pytest.approx([0, 0.02, 0], abs=1e-3)  # rubber_rect4: p_CF is in the middle
    assert [turn["stable"] for turn in turns] == [True, False]
    assert len(lines[0].splitlines()) == 3
    assert "sticking" in lines[0]
    assert "slips, margin -" in lines[2]


def test_a_model_that_is_not_to_be_used_is_warned_of(folder):
    rest = [option for push in range(1, 14) for option in ("--exclude-push", str(push))]
    invoked("estimate", "bags/rubber_rect4", *rest, "--save", "one.yaml")
    for source, said_of in (("one.yaml", True), ("model.yaml", False)):
        for command, pushes in (("predict", "pushes.csv"), ("stable", "turns.csv")):
            run = invoked(command, source, "--pushes", pushes)
            assert (run.exit_code, "warning: the model is not to be used: p_CF rests on 1 push" in run.stderr) == (0, said_of)


def test_the_exported_files_have_the_documented_keys(folder):
    said(COMMANDS[5])
    said(COMMANDS[6])
    assert (folder / "rubber_rect4.xml").read_text().splitlines()[2].endswith("verdict: may be used")
    assert list(json.loads((folder / "rubber_rect4.json").read_text())) == documented("### The keys of the JSON")


def test_the_keys_of_the_model_are_documented():
    keys = documented("Its keys:")
    assert {key.split(".")[0] for key in keys} == set(ModelFile.model_fields)
