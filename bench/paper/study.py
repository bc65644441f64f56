"""`./pushfric study`: how far the estimates can be relied on, measured on simulated pushes of many seeds and on real ones.

Each cell of the study is an object, a camera's noise and a plan of pushes. For each cell, the study measures how often the 90 %
ellipse of p_CF contains the truth, its radius compared with the errors, the errors of the program and of the belief, and mu_c.
Further cells are about screening (`pushes.screened_runs`).
"""

import math
import pathlib
from collections.abc import Iterable, Iterator, Sequence
from typing import Annotated

import numpy as np
import typer

from bench import constants
from bench.paper.pushes import CHANGE, NOISES, eight_places, estimated, filmed, moved, objects, screened_runs
from bench.paper.tables import Nested, table_of
from bench.program import results_of
from bench.public.zhou2015 import object_on, read_push_points
from bench.public_pushes import center_off
from pushfric_core import InvalidInput, Observation
from pushfric_core.commands.console import say
from pushfric_core.commands.options import RUNS, DaskOption, JobsOption
from pushfric_core.estimation.push_plan import even_pushes, slipping_pushes
from pushfric_core.files.disk import make_folder, write_whole
from pushfric_core.geometry.planar import Array
from pushfric_core.geometry.table_1 import TABLE_1, TableObject
from pushfric_core.mechanics.prediction import ELLIPSE
from pushfric_core.records import to_json

SEEDS = 200
"""Simulated runs for each case."""

SUBSETS = 30
"""Numbers of real pushes that are chosen at random from each log."""

SIZES = (10, 20, 40)
"""Numbers of real pushes."""

SCREENED = ("unequal_feet", "triangle", "delrin_rect_right")
"""The objects with which bad pushes and changes are tried."""

REAL_CENTER = np.full(2, 0.05)
"""True p_CF of the real triangle [m], by statics."""

PARTS = ("simulated", "real", "mu_c", "screened")
"""The parts of study.json with numbers, each a table of study.md; docs/estimation.md explains them."""


def run_seed(seed: int) -> Nested:
    """All simulated cells of one seed.

    Returns:
        `seed`; under `cells` what was found in each, by its name; under `mu_c` that of each object of Table 1; and as
        `screened` the cases of bad pushes and changed objects, each with what was said of it.
    """
    found: Nested = {"seed": seed, "cells": {}, "mu_c": {}, "screened": []}
    for number, (name, studied) in enumerate(objects().items()):
        found["cells"] |= _cells(name, studied, np.random.default_rng((seed, 397 + number)))
        if name in SCREENED:
            found["screened"] += _screened(studied, np.random.default_rng((seed, 200 + number)))
    for number, (name, known) in enumerate(TABLE_1.items()):
        rng = np.random.default_rng((seed, 100 + number))
        pushes = even_pushes(known.outline, known.pushes) + slipping_pushes(known.outline, (0, 2))
        data = filmed(known.outline, moved(known, pushes, rng), known.noise, rng)
        if (mu_c := estimated(data, known.support_points)[1].mu_c) is not None:
            found["mu_c"][name] = {"truth": known.mu_c, "value": mu_c.value, "low": mu_c.low, "high": mu_c.high}
    return found


RUNS_OF_EACH = f"Simulated runs for each case [default: {SEEDS}; with --constants, 1]."
REAL = "push_points.csv of zhou2015, to study real pushes too."
CONSTANTS = "Instead, halve and double each constant of the belief; 40 minutes of one core."
PUBLIC = "With --constants: a folder of public pushes, as `import` writes them; may be repeated."


def study(
    out: Annotated[pathlib.Path, typer.Option(help="Folder to write: study.json and study.md.")] = RUNS / "study",
    seeds: Annotated[int | None, typer.Option(help=RUNS_OF_EACH, min=1, max=10_000)] = None,
    pushes: Annotated[pathlib.Path | None, typer.Option(help=REAL, show_default=False)] = None,
    of_constants: Annotated[bool, typer.Option("--constants", help=CONSTANTS)] = False,
    public: Annotated[list[pathlib.Path] | None, typer.Option(help=PUBLIC)] = None,
    jobs: JobsOption = -1,
    dask: DaskOption = None,
) -> None:
    """Measure how far the estimates can be relied on, with simulated pushes of many seeds and with real ones."""
    if public and not of_constants:
        raise InvalidInput("--public is for --constants; expected --pushes, or both")
    make_folder(out)
    if of_constants:
        found = constants.measure(seeds or 1, public or (), lambda trials: results_of(constants.scores, trials, jobs, dask))
        _write(out, found, "Constants of the belief", [part for part, numbers in found.items() if numbers])
        return
    seeds = seeds or SEEDS
    logs = {} if pushes is None else read_push_points(pushes)
    runs = sorted(results_of(run_seed, range(seeds), jobs, dask), key=lambda one: int(one["seed"]))
    summary: Nested = {
        "seeds": seeds,
        "simulated": {name: _summary([one["cells"][name] for one in runs]) for name in runs[0]["cells"]},
        "mu_c": {name: _within([one["mu_c"][name] for one in runs if name in one["mu_c"]]) for name in TABLE_1},
        "screened": _totals(one for run in runs for one in run["screened"]),
        "real": _real(logs),
    }
    _write(out, summary, f"Study of {seeds} seeds", [part for part in PARTS if summary[part]])


def _write(out: pathlib.Path, numbers: Nested, title: str, parts: Iterable[str]) -> None:
    """Write study.json, and these parts of it as tables into study.md."""
    write_whole(out / "study.json", to_json(numbers) + "\n")
    tables = (f"\n## {part}\n\n{table_of(numbers[part])}" for part in parts)
    write_whole(out / "study.md", "".join((f"# {title}\n", *tables)))
    say(f"report: {out / 'study.md'}")


def _cells(name: str, studied: TableObject, rng: np.random.Generator) -> Iterator[tuple[str, Nested]]:
    """What is found with each plan and noise, by the name of the cell."""
    plans = {"all": even_pushes(studied.outline, studied.pushes), "places": eight_places(studied.outline, rng)}
    for plan, pushes in plans.items():
        pushed = moved(studied, pushes, rng)
        for noise, spread in NOISES.items():
            data = filmed(studied.outline, pushed, spread, rng)
            yield f"{name}/{plan}/{noise}", _found(data, studied.support_points, studied.support.center_of_friction)


def _screened(studied: TableObject, rng: np.random.Generator) -> Iterator[tuple[str, Nested]]:
    """What is said of runs with a fault: whether it is found (None: there is none), and how many good pushes are lost."""
    for case, right, data in screened_runs(studied, rng):
        estimator, estimate = estimated(data, studied.support_points)
        left_out = {one.push_id for one in estimator.rejected}
        changed = estimate.judgement.doubts.change is not None
        found = None if case.startswith("none") else changed if right == CHANGE else right is None or right in left_out
        good = {one.push_id for one in data if right != CHANGE} - {right}
        lost, changed = len(good & left_out), changed and right != CHANGE
        yield case, {"runs": 1, "found": found, "good": len(good), "lost": lost, "changed": changed}


def _totals(said: Iterable[tuple[str, Nested]]) -> Nested:
    """The sums of all runs of each case; None: not asked."""
    cases: Nested = {}
    for case, numbers in said:
        total = cases.setdefault(case, dict.fromkeys(numbers, 0))
        total |= {key: None if value is None else total[key] + value for key, value in numbers.items()}
    return cases


def _found(data: Iterable[Observation], points: Array, truth: Array) -> Nested:
    """Errors of an estimate [mm], and its own figures for them; `given` is false if it has none."""
    _, estimate = estimated(data, points)
    numbers = {"error": float(np.hypot(*(estimate.center_of_friction - truth))), "given": estimate.confidence is not None}
    if numbers["given"]:
        numbers["middle"], square = center_off(estimate.belief, truth)
        numbers["held"] = square <= ELLIPSE
        numbers["radius"] = math.sqrt(ELLIPSE * math.sqrt(float(np.linalg.det(estimate.belief.covariance))))
    return numbers


def _summary(runs: Sequence[Nested]) -> Nested:
    """The figures of the runs of one cell; lengths in mm."""
    given = [one for one in runs if one["given"]]
    numbers: Nested = {"runs": len(runs), "given": len(given), **_quantiles("error", runs)}
    if given:
        errors = float(np.quantile([one["middle"] for one in given], 0.9))
        radius, median, optimum = (float(np.median([one[key] for one in given])) for key in ("radius", "middle", "error"))
        numbers |= {
            **_quantiles("middle", given),
            "held": float(np.mean([one["held"] for one in given])),
            "radius_to_errors": radius / errors if errors > 0 else math.inf,
            "middle_to_optimum": median / optimum,
        }
    return numbers


def _quantiles(name: str, runs: Sequence[Nested]) -> Nested:
    values = [1e3 * one[name] for one in runs]
    return {f"{name}_median": float(np.median(values)), f"{name}_p90": float(np.quantile(values, 0.9))}


def _within(runs: Sequence[Nested]) -> Nested:
    """How often mu_c is within 10 % of the truth, and how often its interval holds the truth."""
    values = [one["value"] for one in runs if one["value"] is not None]
    return {
        "truth": runs[0]["truth"],
        "runs": len(runs),
        "given": len(values),
        "median": float(np.median(values)) if values else None,
        "within_10_percent": sum(abs(value / runs[0]["truth"] - 1) <= 0.1 for value in values),
        "held": sum(one["low"] <= one["truth"] <= one["high"] for one in runs),
    }


def _real(logs: dict[str, list[Observation]]) -> Nested:
    """Random choices of pushes from each log."""
    points = object_on("triangle").support_points
    cells: Nested = {}
    for size in SIZES:
        runs = []
        for number, data in enumerate(logs.values()):
            rng = np.random.default_rng((number, size))
            for _ in range(SUBSETS if len(data) >= size else 0):
                chosen = sorted(rng.permutation(len(data))[:size].tolist())
                runs.append(_found([data[index] for index in chosen], points, REAL_CENTER))
        if runs:
            cells[f"{size} pushes"] = _summary(runs)
    return cells
