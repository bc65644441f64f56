"""The benchmark runs and prints its figures, and its contenders solve the same program."""

import importlib.util
import itertools
import json
import pathlib
import subprocess
import sys

import numpy as np
import pytest
from scipy.optimize import linprog

ROOT = pathlib.Path(__file__).resolve().parents[2]
EXTRAS = [name for name in ("highspy", "cvxpy", "clarabel") if importlib.util.find_spec(name) is None]

pytestmark = pytest.mark.skipif(
    bool(EXTRAS), reason=f"{', '.join(EXTRAS)} not installed: python -m pip install -r bench/requirements.txt"
)


@pytest.fixture
def contenders(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    from bench import contenders

    return contenders


@pytest.fixture
def groups(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    from bench.observations import data_points

    return list(itertools.islice(data_points(15, seed=3), 60))


def test_quick_run_writes_the_figures_it_shows(tmp_path):
    options = {"--points": 50, "--supports": 15, "--json": tmp_path / "a.json"}
    command = [sys.executable, ROOT / "bench", "--quick", *itertools.chain(*options.items())]
    run = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=240, cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    report = json.loads((tmp_path / "a.json").read_text())
    assert report["disagreements"] == []
    names = {row["contender"] for row in report["updates"]}
    exact = {"pushfric", "highs_primal", "highs_dual", "linprog", "linprog_dual", "cvxpy"}
    assert names == exact | {"osqp"}
    for row in report["updates"]:
        assert (row["M"], row["N"], row["count"]) == (50, 15, 40)
        assert 0 < row["median_cpu_ms"] <= row["p99_cpu_ms"]
        assert row["objective_error"] <= (1e-6 if row["contender"] in exact else 1.0)
    (held,) = report["bytes_per_observation"]
    assert held["N"] == 15
    assert held["bytes"] >= 2 * 15 * 8  # the coefficients of two rows
    assert [target["asked"] for target in report["targets"]] == [">= 25", ">= 2", "<= 20"]
    assert "CPU ms of one new observation, p99" in " ".join(run.stdout.split())


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["--supports", "16"], "Invalid value for --supports: must be of 15, 24, 36, 100, 400, got 16"),
        (["--points", "0"], "--points: expected a whole number from 1 to 1000000, got '0'"),
        (["--json=."], ".: expected the name of a file to write that ends in .json"),
        (["--public", "a", "b"], "a: no *.strokes.csv, no bags and no push_points.csv; expected what `import` writes"),
    ],
)
def test_wrong_input_gives_one_line_and_exit_code_2(contenders, monkeypatch, capsys, arguments, error):
    from bench.__main__ import app
    from pushfric_core.commands.cli import main

    monkeypatch.setattr(sys, "argv", ["bench", *arguments])
    with pytest.raises(SystemExit) as stop:
        main(app, "./pushfric bench")
    assert stop.value.code == 2
    assert capsys.readouterr().err.replace("; see ./pushfric bench --help", "") == f"error: {error}\n"


def test_every_contender_follows_the_optimum(contenders, groups):
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
            tolerance = 0.5 if name in contenders.APPROXIMATE else 1e-6
            assert contender.objective() == pytest.approx(expected, rel=tolerance), name


def updated_objective(contender, rows):
    contender.update(rows)
    return contender.objective()


def test_contradicting_data_points_have_no_optimum(contenders, groups):
    pulled = groups[0]._replace(a=-np.abs(groups[0].a))
    for name in ("pushfric", "highs_primal", "highs_dual", "linprog", "linprog_dual", "cvxpy"):
        contender = contenders.CONTENDERS[name](15, 51)
        contender.load(groups[:50])
        with pytest.raises(contenders.NoOptimum):
            updated_objective(contender, pulled)


def test_a_disagreeing_contender_is_reported(contenders, monkeypatch):
    from bench import updates

    class Wrong(contenders.Pushfric):
        def objective(self):
            return 1.1 * super().objective()

    monkeypatch.setitem(updates.CONTENDERS, "linprog", Wrong)
    measured = updates.measure([20], [15], updates=2, budget=10.0, held=10, progress=lambda what: None)
    assert measured["disagreements"] == ["linprog at M = 20, N = 15: its objective is 1.0e-01 off pushfric's"] * 2


def test_pushfric_without_an_optimum_is_reported(contenders, monkeypatch):
    from bench import updates

    class Lost(contenders.Pushfric):
        def objective(self):
            raise contenders.NoOptimum("uncertified")

    monkeypatch.setitem(updates.CONTENDERS, "pushfric", Lost)
    measured = updates.measure([20], [15], updates=1, budget=10.0, held=10, progress=lambda what: None)
    assert measured["disagreements"] == ["pushfric at M = 20, N = 15: uncertified"]


@pytest.mark.parametrize("at", ["load", "update"])
def test_only_a_contender_out_of_time_is_left_out(contenders, monkeypatch, at):
    from bench import updates

    def out_of_time(self, data):
        raise contenders.OutOfTime

    slow = type("Slow", (contenders.Pushfric,), {at: out_of_time})
    monkeypatch.setitem(updates.CONTENDERS, "highs_primal", slow)
    measured = updates.measure([20, 30], [15], updates=2, budget=10.0, held=10, progress=lambda what: None)
    assert measured["disagreements"] == []
    others = contenders.CONTENDERS.keys() - {"highs_primal"}
    assert {(row["M"], row["contender"]) for row in measured["updates"]} == {(m, name) for m in (20, 30) for name in others}


def test_a_contender_with_too_slow_an_update_is_left_out(contenders, monkeypatch):
    from bench import updates

    monkeypatch.setattr(updates, "LIMIT", 0.0)
    measured = updates.measure([20], [15], updates=2, budget=10.0, held=10, progress=lambda what: None)
    assert {row["contender"] for row in measured["updates"]} == {"pushfric"}


def row(m, contender, median, p99):
    return {"M": m, "N": 24, "contender": contender, "median_cpu_ms": median, "p99_cpu_ms": p99}


def test_verdict_compares_with_the_better_form_of_highs(contenders):
    from bench.updates import verdicts

    rows = [row(100, "pushfric", 1.0, 30.0), row(100, "highs_primal", 3.0, 4.0), row(100, "highs_dual", 2.5, 5.0)]
    rows.append(row(100_000, "pushfric", 2.5, 3.0))
    assert [(verdict.measured, verdict.met) for verdict in verdicts({"updates": rows})] == [
        (None, False),  # linprog was not measured
        (2.5, True),
        (30.0, False),
        (1.2, True),
        (2.5, False),  # grew 2.5-fold from M = 100
    ]
