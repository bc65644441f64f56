"""The benchmark runs and prints its figures, and its contenders solve the same program."""

import itertools
import json
import pathlib
import subprocess
import sys

import numpy as np
import pytest
from scipy.optimize import linprog

from bench.observations import data_points
from pushfric_core.commands.cli import main

NEEDED = "python -m pip install -r bench/requirements.txt brings what is compared"
contenders, updates, program = (
    pytest.importorskip(f"bench.{name}", reason=NEEDED) for name in ("contenders", "updates", "__main__")
)
ROOT = pathlib.Path(__file__).resolve().parents[2]


@pytest.fixture
def groups():
    return list(itertools.islice(data_points(15, seed=3), 60))


def test_quick_run_writes_the_figures_it_shows(tmp_path):
    command = [sys.executable, ROOT / "bench", "--quick", "--json", tmp_path / "a.json"]
    run = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=240, cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    report = json.loads((tmp_path / "a.json").read_text())
    assert report["disagreements"] == []
    cells = {(row["M"], row["N"], row["contender"]) for row in report["updates"]}
    assert cells == {(m, 24, name) for m in (50, 100, 1000) for name in ("pushfric", "highs", "linprog")}
    for row in report["updates"]:
        assert row["count"] == 40 or (row["contender"] != "pushfric" and 3 <= row["count"] < 40)  # its second was used up
        assert 0 < row["median_cpu_ms"] <= row["p99_cpu_ms"]
        assert row["objective_error"] <= 1e-6
    (held,) = report["bytes_per_observation"]
    assert held["N"] == 24
    assert held["bytes"] >= 2 * 24 * 8  # the coefficients of two rows
    assert [target["asked"] for target in report["targets"]] == [*[">= 25", ">= 2", "<= 20"] * 2, ">= 650", ">= 7", "<= 20"]
    assert "CPU ms of one new observation, p99" in " ".join(run.stdout.split())


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["--json=."], ".: expected the name of a file to write that ends in .json"),
        (["a"], "Invalid value for FOLDER: is for --public"),
        (["--public", "a", "b"], "a: no *.strokes.csv, no bags and no push_points.csv; expected what `import` writes"),
    ],
)
def test_wrong_input_gives_one_line_and_exit_code_2(monkeypatch, capsys, arguments, error):
    monkeypatch.setattr(sys, "argv", ["bench", *arguments])
    with pytest.raises(SystemExit) as stop:
        main(program.app, "./pushfric bench")
    assert stop.value.code == 2
    assert capsys.readouterr().err.replace("; see ./pushfric bench --help", "") == f"error: {error}\n"


def test_every_contender_follows_the_optimum(groups):
    everyone = {name: kind(15, len(groups)) for name, kind in contenders.CONTENDERS.items()}
    for contender in everyone.values():
        contender.load(groups[:50])
    for count, rows in enumerate(groups[50:], start=51):
        a, b = np.stack([group.a for group in groups[:count]], axis=1)
        # |a . w| as the larger of two sides: the tests' own form of the program
        expected = linprog(
            np.repeat((0.0, 1.0), (15, count)),
            A_ub=np.block([[a, -np.eye(count)], [-a, -np.eye(count)], [-b, np.zeros((count, count))]]),
            b_ub=np.zeros(3 * count),
            A_eq=[np.repeat((1.0, 0.0), (15, count))],
            b_eq=[1.0],
        ).fun
        for name, contender in everyone.items():
            contender.update(rows)
            assert contender.objective() == pytest.approx(expected, rel=1e-6), name


def test_a_disagreeing_contender_is_reported(monkeypatch):
    class Wrong(contenders.Pushfric):
        def objective(self):
            return 1.1 * super().objective()

    monkeypatch.setitem(updates.CONTENDERS, "linprog", Wrong)
    measured = updates.measure([20], [15], updates=2, budget=10.0, held=10, progress=lambda what: None)
    assert measured["disagreements"] == ["linprog at M = 20, N = 15: its objective is 1.0e-01 off pushfric's"] * 2


def row(m, contender, median, p99):
    return {"M": m, "N": 24, "contender": contender, "median_cpu_ms": median, "p99_cpu_ms": p99}


def test_verdicts_compare_with_highs_and_with_fewer_observations():
    rows = [row(100, "pushfric", 1.0, 30.0), row(100, "highs", 2.5, 5.0)]
    rows.append(row(100_000, "pushfric", 2.5, 3.0))
    assert [(verdict.measured, verdict.met) for verdict in updates.verdicts({"updates": rows})] == [
        (None, False),  # linprog was not measured
        (2.5, True),
        (30.0, False),
        (1.2, True),
        (2.5, False),  # grew 2.5-fold from M = 100
    ]
