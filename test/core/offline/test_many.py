"""Many inputs at once: broken ones, interrupted runs, and what the table and the models say."""

import csv
import dataclasses
import json
import os
import pathlib
import shutil
import signal
import subprocess

import numpy as np
import pytest
from calls import PROGRAM, invoked, pushfric, wait_until
from cluster import local_cluster
from problems import observations_of
from semantic_damage import Recording

from pushfric_core import TABLE_1, Observations, Twist
from pushfric_core.files.model_file import load_model
from pushfric_core.offline.estimation import Choices
from pushfric_core.offline.many import RESULTS, estimate_many, fingerprint, model_of

BAG = pathlib.Path(__file__).resolve().parents[3] / "bags/rubber_rect4"
NAME = "delrin_square3"


def write_pushes(file: pathlib.Path, seed: int) -> None:
    """Twelve simulated pushes of the object."""
    known = TABLE_1[NAME]
    rng = np.random.default_rng(seed)
    pushes = []
    for one in observations_of(known.outline, known.support, known.mu_c, 12, rng):
        twist = np.array(one.twist) / np.hypot(*one.twist[:2]) + rng.normal(0, 1e-3, 3)
        pushes.append(dataclasses.replace(one, twist=Twist(*twist)))
    Observations(pushes).to_frame().to_csv(file, index=False)


@pytest.fixture
def inputs(tmp_path):
    """A folder of six CSVs, and one that is broken."""
    folder = tmp_path / "inputs"
    folder.mkdir()
    for seed, name in enumerate((*range(5), "\udcff")):  # a byte that is no text
        write_pushes(folder / f"run_{name}.csv", seed)
    (folder / "torn.csv").write_text("contact_x,contact_y\n0.1")
    return folder


def table_of(out: pathlib.Path) -> dict[str, dict[str, str]]:
    with (out / "table.csv").open(newline="") as stream:
        return {pathlib.Path(row["input"]).name: row for row in csv.DictReader(stream)}


def test_a_result_that_was_changed_is_made_again(tmp_path):
    write_pushes(tmp_path / "data.csv", 1)
    inputs, out = [tmp_path / "data.csv"], tmp_path / "out"
    (first,) = estimate_many(inputs, Choices(NAME), out, 1, None, lambda line: None)
    kept = (out / RESULTS).read_text()
    for text in (kept, kept.replace('"data_points": 12', '"data_points": 13'), kept.replace('"mu_c": {', '"mu_c": {"w": 0, '),
                 "[" * 100_000 + "\n", '"\\ud800"\n'):  # fmt: skip
        (out / RESULTS).write_text(text)
        (again,) = estimate_many(inputs, Choices(NAME), out, 1, None, lambda line: None)
        assert again == first
        assert len((out / RESULTS).read_text().splitlines()) == (1 if text == kept else 2)


def test_a_broken_input_costs_only_itself(inputs, tmp_path):
    os.mkfifo(inputs / "pipe.csv")  # which nobody writes to
    out = tmp_path / "out"
    run = pushfric(
        "estimate", inputs, "--object", NAME, "--grid", 5, 5, "--out", out, "--jobs", 2, "--useful-radius", 1, "--json"
    )
    assert run.returncode == 1, run.stderr
    told = json.loads(run.stdout)
    assert {name: told[name] for name in ("inputs", "usable", "not_usable", "broken")} == {
        "inputs": 8, "usable": 6, "not_usable": 0, "broken": 2,
    }  # fmt: skip
    rows = table_of(out)
    assert list(rows) == ["pipe.csv", *(f"run_{seed}.csv" for seed in (*range(5), r"\udcff")), "torn.csv"]
    assert rows["pipe.csv"]["error"].endswith("pipe.csv: is a pipe or a device; expected a bag or a CSV of observations")
    assert "missing column normal_x" in rows["torn.csv"]["error"]
    assert rows["torn.csv"]["p_cf_x"] == rows["torn.csv"]["model"] == ""
    assert run.stderr.count("torn.csv: ") == 1


def test_the_numbers_are_those_of_a_single_estimate(inputs, tmp_path):
    out = tmp_path / "out"
    options = ("--object", NAME, "--terms", "moment", "--exclude-push", 3)
    invoked("estimate", inputs / "run_1.csv", inputs / "run_2.csv", *options, "--out", out, "--jobs", 1)
    single = json.loads(invoked("estimate", inputs / "run_2.csv", *options, "--json").stdout)
    row = table_of(out)["run_2.csv"]
    assert [float(row["p_cf_x"]), float(row["p_cf_y"])] == single["belief"]["center_of_friction"]
    assert float(row["objective"]) == single["objective"]
    assert int(row["data_points"]) == single["data_points"] == 11
    model, _ = load_model(out / row["model"])
    assert list(model.w) == single["w"]


def test_a_bag_that_does_not_add_up_is_not_usable(tmp_path):
    recording = Recording(BAG)
    recording.write_elsewhere(tmp_path / "bag", recording.without_push(5))
    for how, code in (([], 1), (["--partial"], 0)):
        run = invoked("estimate", BAG, tmp_path / "bag", "--out", tmp_path / "out", "--jobs", 1, "--json", *how)
        counts = json.loads(run.stdout)
        assert (run.exit_code, counts["usable"], counts["not_usable"]) == (code, 2 - code, code)
        row = table_of(tmp_path / "out")["bag"]
        assert (row["use"] == "False", "pushes_missing" in row["reasons"]) == (bool(code), bool(code))
        assert ("push 5 is missing" in run.stderr) == bool(code)


def test_a_bag_keeps_its_own_object_among_many_and_another_one_is_told(tmp_path):
    write_pushes(tmp_path / "data.csv", 1)
    invoked("estimate", BAG, tmp_path / "data.csv", "--object", NAME, "--out", tmp_path / "out", "--jobs", 1)
    rows = table_of(tmp_path / "out")
    assert {name: row["object"] for name, row in rows.items()} == {"data.csv": NAME, BAG.name: "rubber_rect4"}
    other = tmp_path / "other.yaml"
    other.write_text((BAG / "object.yaml").read_text().replace("rubber_rect4", "brick"))
    told = f"{BAG}: its own object 'rubber_rect4' is not used, but the given 'brick'"
    for given, said in ((other, True), ("rubber_rect4", False)):
        run = invoked("estimate", BAG, "--object", given)
        assert (run.exit_code, told in " ".join(run.stderr.split())) == (0, said)


def test_a_run_goes_on_where_it_was(inputs):
    out = inputs  # its table is no input
    arguments = ("estimate", inputs, "--object", NAME, "--out", out, "--jobs", 1)
    invoked(*arguments)
    first = (out / "table.csv").read_bytes()
    lines = (out / "results.jsonl").read_text().splitlines()
    assert len(lines) == 7
    # as if killed in mid-line
    (out / "results.jsonl").write_text("\n".join(lines[:4]) + "\n" + lines[4][:40])
    invoked(*arguments)
    assert (out / "table.csv").read_bytes() == first
    kept = (out / "results.jsonl").read_text().splitlines()
    assert kept[:4] == lines[:4]
    assert sorted(json.loads(line)["input"] for line in kept[5:]) == [json.loads(line)["input"] for line in sorted(lines[4:])]
    # an input that has changed is estimated again, and so is one that failed, and every input with other settings
    os.utime(inputs / "run_0.csv", (1, 1))
    next((out / "models").glob("run_1*")).unlink()
    invoked(*arguments)
    assert len((out / "results.jsonl").read_text().splitlines()) == len(kept) + 3
    invoked(*arguments, "--loss", "l2")
    assert len((out / "results.jsonl").read_text().splitlines()) == len(kept) + 10


def test_an_input_of_the_same_name_and_an_object_that_changes_are_told_apart(tmp_path, monkeypatch):
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        write_pushes(tmp_path / folder / "data.csv", 1)
        monkeypatch.chdir(tmp_path / folder)
        invoked("estimate", "data.csv", "--object", NAME, "--out", "../out", "--jobs", 1)
    assert len(list((tmp_path / "out/models").iterdir())) == 2
    bag = shutil.copytree(BAG, tmp_path / "bag")
    (recording,) = bag.glob("*.mcap")
    before = fingerprint(recording, Choices(NAME))
    (bag / "object.yaml").write_text((bag / "object.yaml").read_text() + "\n")
    assert fingerprint(recording, Choices(NAME)) != before


def test_what_the_disk_refused_is_tried_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_pushes(tmp_path / "data.csv", 1)
    model = tmp_path / "out" / model_of(tmp_path / "data.csv")
    model.parent.mkdir(parents=True)
    model.with_name(f".{model.name}.{os.getpid()}").symlink_to("/dev/full")  # the draft of the model
    arguments = ("estimate", "data.csv", "--object", NAME, "--out", "out", "--jobs", 1)
    assert "No space left on device" in " ".join(invoked(*arguments).stderr.split())
    assert invoked(*arguments).exit_code == 0
    assert model.is_file()


def test_ctrl_c_while_the_workers_load_is_quiet(inputs, tmp_path):
    arguments = ("estimate", inputs, "--object", NAME, "--out", tmp_path / "out", "--jobs", 2)
    with subprocess.Popen([*PROGRAM, *map(str, arguments)], stderr=subprocess.PIPE, text=True, start_new_session=True) as run:
        children = pathlib.Path(f"/proc/{run.pid}/task/{run.pid}/children")

        def a_worker_has_begun_to_load() -> bool:
            return any("/numpy/" in pathlib.Path(f"/proc/{pid}/maps").read_text() for pid in children.read_text().split())

        wait_until(a_worker_has_begun_to_load)
        os.killpg(run.pid, signal.SIGINT)
        _, said = run.communicate(timeout=60)
    assert (run.returncode, "Traceback" in said) == (130, False), said


def test_bags_in_a_folder_are_estimated_on_a_cluster(tmp_path):
    for name in ("a", "b"):
        shutil.copytree(BAG, tmp_path / "bags" / name)
    (tmp_path / "dask").mkdir()
    with local_cluster(tmp_path / "dask") as address:
        run = pushfric("estimate", tmp_path / "bags", "--out", tmp_path / "out", "--dask", address)
    assert run.returncode == 0, run.stderr
    rows = table_of(tmp_path / "out")
    single = json.loads(invoked("estimate", BAG, "--json").stdout)
    for name in ("a", "b"):
        assert [float(rows[name]["p_cf_x"]), float(rows[name]["p_cf_y"])] == single["belief"]["center_of_friction"]
        assert (tmp_path / "out" / rows[name]["model"]).is_file()
