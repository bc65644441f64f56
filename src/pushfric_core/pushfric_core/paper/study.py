"""`pushfric study`: how far the estimates can be relied on, measured on simulated pushes of many seeds and on real ones.

Each cell of the study is an object, a camera's noise and a plan of pushes. For each cell, the study measures how often the 90 %
ellipse of p_CF contains the truth, its radius compared with the errors, the errors of the optimum and of the middle of the set,
and mu_c. Further cells are about screening (module `spoilt`) and the choice of the next push (module `choice`).
"""

import math
import pathlib
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from pushfric_core.datasets.zhou2015 import CORNERS, GRID, read_push_points
from pushfric_core.estimation.estimate import Estimate
from pushfric_core.estimation.estimator import EstimatorConfig
from pushfric_core.estimation.push_plan import PlannedPush, even_pushes, slipping_pushes
from pushfric_core.files.whole_file import make_folder, write_whole
from pushfric_core.geometry.contact import tangent
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, velocity_at
from pushfric_core.geometry.table_1 import TABLE_1
from pushfric_core.offline.workers import results
from pushfric_core.paper import choice, spoilt
from pushfric_core.paper.experiments import filmed
from pushfric_core.paper.tables import markdown
from pushfric_core.paper.trials import NOISES, eight_places, estimated, moved, objects, of_table_1, shapes
from pushfric_core.report.report import to_json
from pushfric_core.trajectories.observation import Observation
from pushfric_core.uncertainty.spread import ELLIPSE

SUBSETS = 30
"""Numbers of real pushes that are chosen at random from each log."""

SIZES = (10, 20, 40)
"""Numbers of real pushes."""

REAL_CENTER = np.full(2, 0.05)
"""True p_CF of the real triangle [m], by statics."""

SLIPPED = 1e-3
"""A real push slips if its tip moved along the edge by more than this [m]; then the force sensor measures mu_c."""

Numbers = dict[str, Any]


def run_seed(seed: int) -> dict[str, Any]:
    """All simulated cells of one seed.

    Returns:
        `seed`; under `cells` what was found in each, by its name; under `screened` what screening said of bad pushes and
        changed objects; and under `choice` how many pushes each object took.
    """
    cells: dict[str, Numbers] = {}
    screened: dict[str, Numbers] = {}
    chosen: dict[str, Numbers] = {}
    for number, (name, studied) in enumerate(objects().items()):
        rng = np.random.default_rng((seed, number))
        edge = int(rng.integers(len(studied.outline.vertices)))
        offset = float(rng.uniform(-0.3, 0.3) * studied.outline.lengths[edge])
        plans = {plan: even_pushes(studied.outline, counts) for plan, counts in studied.plans.items()}
        plans["one_place"] = [PlannedPush(edge, offset)] * 8
        for plan, pushes in plans.items():
            pushed = moved(studied, pushes, rng)
            for noise, spread in NOISES.items():
                data = filmed(studied.outline, pushed, spread, rng)
                cells[f"{name}/{plan}/{noise}"] = _found(data, studied.support_points, studied.support.center_of_friction)
        verdicts = spoilt.verdicts(studied, np.random.default_rng((seed, 200 + number)))
        screened |= {f"{name}/{case}": found for case, found in verdicts}
        chosen[name] = choice.pushes_needed(studied, np.random.default_rng((seed, 300 + number)))
    for number, (name, studied) in enumerate(shapes().items()):
        rng = np.random.default_rng((seed, 400 + number))
        for plan, pushes in (
            ("all", even_pushes(studied.outline, studied.plans["all"])),
            ("places", eight_places(studied.outline, rng)),
        ):
            pushed = moved(studied, pushes, rng)
            for noise, spread in NOISES.items():
                data = filmed(studied.outline, pushed, spread, rng)
                cells[f"{name}/{plan}/{noise}"] = _found(data, studied.support_points, studied.support.center_of_friction)
    for number, (name, known) in enumerate(TABLE_1.items()):
        rng = np.random.default_rng((seed, 100 + number))
        studied = of_table_1(name)
        pushed = moved(studied, even_pushes(known.outline, known.pushes) + slipping_pushes(known.outline, (0, 2)), rng)
        mu_c = _estimate(filmed(known.outline, pushed, known.noise, rng), known.support_points).mu_c
        if mu_c is not None:
            cells[f"mu_c/{name}"] = {"truth": known.mu_c, "value": mu_c.value, "low": mu_c.low, "high": mu_c.high}
    return {"seed": seed, "cells": cells, "screened": screened, "choice": chosen}


def study(out: pathlib.Path, seeds: int, pushes: pathlib.Path | None, jobs: int, dask: str | None, console: Console) -> Numbers:
    """Measure everything, and write study.json and study.md into a folder.

    Args:
        out: the folder.
        seeds: simulated runs of each cell.
        pushes: push_points.csv of zhou2015; None: no real pushes.
        jobs: processes; -1: one for each core.
        dask: address of a Dask scheduler; None: this machine.
        console: for the progress bar.
    Returns:
        What study.json holds.
    Raises:
        InvalidInput: the folder or the CSV cannot be used, or no cluster answers.
    """
    make_folder(out)
    logs = {} if pushes is None else read_push_points(pushes)
    found = list(track(results(run_seed, range(seeds), jobs, dask), "seeds", seeds, console=console))
    found.sort(key=lambda one: int(one["seed"]))
    names = [name for name in found[0]["cells"] if not name.startswith("mu_c/")]
    summary: Numbers = {
        "seeds": seeds,
        "simulated": {name: _summary([one["cells"][name] for one in found]) for name in names},
        "mu_c": {
            name: _within([one["cells"][f"mu_c/{name}"] for one in found if f"mu_c/{name}" in one["cells"]]) for name in TABLE_1
        },
        "screened": spoilt.summary([one["screened"] for one in found]),
        "choice": {name: choice.summary([one["choice"][name] for one in found]) for name in found[0]["choice"]},
        "real": _real(logs),
        "real_mu_c": {f"{log}/{terms}": _real_mu_c(data, terms) for log, data in logs.items() for terms in ("moment", "force")},
    }
    for name, text in (("study.json", to_json(summary) + "\n"), ("study.md", _report(summary))):
        write_whole(out / name, text)
    return summary


def _estimate(data: Iterable[Observation], points: Array, terms: tuple[str, ...] = ("moment",)) -> Estimate:
    return estimated(data, points, EstimatorConfig(terms=terms))[1]


def _found(data: Iterable[Observation], points: Array, truth: Array, terms: tuple[str, ...] = ("moment",)) -> Numbers:
    """Errors of an estimate [m], and its own figures for them; `given` is false if it has none."""
    estimate = _estimate(data, points, terms)
    error = estimate.center_of_friction - truth
    numbers: Numbers = {"error": float(np.hypot(*error)), "given": estimate.spread is not None}
    if estimate.spread is not None:
        covariance = estimate.spread.covariance
        numbers["held"] = bool(error @ np.linalg.solve(covariance, error) <= ELLIPSE)
        numbers["radius"] = math.sqrt(ELLIPSE * math.sqrt(float(np.linalg.det(covariance))))
        numbers["middle"] = float(np.hypot(*(estimate.spread.middle @ points - truth)))
    if (sampled := estimate.posterior) is not None:
        off = sampled.center_of_friction - truth
        numbers["sampled"] = float(np.hypot(*off))
        numbers["sampled_held"] = bool(off @ np.linalg.solve(sampled.covariance, off) <= ELLIPSE)
        numbers["sampled_radius"] = math.sqrt(ELLIPSE * math.sqrt(float(np.linalg.det(sampled.covariance))))
    return numbers


def _summary(runs: Sequence[Numbers]) -> Numbers:
    """The figures of the runs of one cell; lengths in mm."""
    given = [one for one in runs if one["given"]]
    numbers: Numbers = {"runs": len(runs), "given": len(given), **_quantiles("error", [1e3 * one["error"] for one in runs])}
    if given:
        numbers |= _quantiles("middle", [1e3 * one["middle"] for one in given])
        numbers["middle_to_optimum"] = float(np.median([o["middle"] for o in given]) / np.median([o["error"] for o in given]))
        numbers["held"] = float(np.mean([one["held"] for one in given]))
        errors = float(np.quantile([one["error"] for one in given], 0.9))
        if sampled := [one for one in given if "sampled" in one]:
            numbers |= _quantiles("sampled", [1e3 * one["sampled"] for one in sampled])
            off = [one["sampled"] for one in sampled]
            numbers["sampled_to_optimum"] = float(np.median(off) / np.median([one["error"] for one in sampled]))
            numbers["sampled_held"] = float(np.mean([one["sampled_held"] for one in sampled]))
            radius = float(np.median([one["sampled_radius"] for one in sampled]))
            numbers["sampled_radius_to_errors"] = radius / float(np.quantile(off, 0.9))
        numbers["radius_to_errors"] = float(np.median([one["radius"] for one in given])) / errors if errors > 0 else math.inf
    return numbers


def _quantiles(name: str, values: Sequence[float]) -> Numbers:
    return {f"{name}_median": float(np.median(values)), f"{name}_p90": float(np.quantile(values, 0.9))}


def _within(runs: Sequence[Numbers]) -> Numbers:
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


def _real(logs: dict[str, list[Observation]]) -> Numbers:
    """Random choices of pushes from each log, without and with their forces."""
    points = Outline(np.array(CORNERS)).grid(*(GRID.grid or (10, 10)), GRID.inset)
    cells: Numbers = {}
    for terms in (("moment",), ("moment", "force")):
        for size in SIZES:
            runs = []
            for number, data in enumerate(logs.values()):
                rng = np.random.default_rng((number, size))
                for _ in range(SUBSETS if len(data) >= size else 0):
                    chosen = sorted(rng.permutation(len(data))[:size].tolist())
                    runs.append(_found([data[index] for index in chosen], points, REAL_CENTER, terms))
            if runs:
                cells[f"{size} pushes, {terms[-1]}"] = _summary(runs)
    return cells


def _real_mu_c(data: Sequence[Observation], terms: str) -> Numbers:
    """mu_c without the forces, or with them, compared with the median that the sensor gives for slipping pushes."""
    points = Outline(np.array(CORNERS)).grid(*(GRID.grid or (10, 10)), GRID.inset)
    sensed = []
    for one in data:
        normal = np.asarray(one.contact_normal)
        slip = (np.asarray(one.tip_velocity) - velocity_at(one.twist, np.asarray(one.contact_point))) @ tangent(normal)
        if abs(float(slip)) > SLIPPED and one.force is not None:
            sensed.append(abs(float(np.asarray(one.force) @ tangent(normal)) / float(np.asarray(one.force) @ normal)))
    used = data if terms == "force" else [replace(one, force=None) for one in data]
    mu_c = _estimate(used, points, ("moment",) if terms == "moment" else ("moment", "force")).mu_c
    truth = float(np.median(sensed))
    if mu_c is None or mu_c.value is None:
        return {"sensor": truth, "value": None}
    held = mu_c.low <= truth <= mu_c.high
    return {"sensor": truth, "value": mu_c.value, "low": mu_c.low, "high": mu_c.high, "kind": mu_c.kind.value, "held": held}


def _report(summary: Numbers) -> str:
    lines = [f"# Study of {summary['seeds']} seeds", "", "Lengths in mm; error: of the certified optimum.", ""]
    heads = (
        *("cell", "runs", "given", "held", "radius / p90 of errors", "error (p90)", "middle (p90)", "middle / optimum"),
        *("sampled (p90)", "sampled / optimum", "sampled held", "its radius / p90"),
    )
    rows = []
    for name, cell in {**summary["simulated"], **{f"real, {key}": value for key, value in summary["real"].items()}}.items():
        held = radius = middle = ratio = "-"
        sampled = ["-"] * 4
        if "sampled_held" in cell:
            sampled = [
                f"{cell['sampled_median']:.2f} ({cell['sampled_p90']:.2f})",
                f"{cell['sampled_to_optimum']:.2f}",
                f"{100 * cell['sampled_held']:.0f} %",
                f"{cell['sampled_radius_to_errors']:.2f}",
            ]
        if cell["given"]:
            held, radius = f"{100 * cell['held']:.0f} %", f"{cell['radius_to_errors']:.2f}"
            middle, ratio = f"{cell['middle_median']:.2f} ({cell['middle_p90']:.2f})", f"{cell['middle_to_optimum']:.2f}"
        error = f"{cell['error_median']:.2f} ({cell['error_p90']:.2f})"
        rows.append((name, cell["runs"], cell["given"], held, radius, error, middle, ratio, *sampled))
    lines += markdown(heads, rows)
    of_mu_c = []
    for name, cell in summary["mu_c"].items():
        median = "-" if cell["median"] is None else f"{cell['median']:.3f}"
        counts = (f"{cell[key]} of {cell['runs']}" for key in ("within_10_percent", "held"))
        of_mu_c.append((name, cell["truth"], median, *counts, cell["given"]))
    for name, cell in summary["real_mu_c"].items():
        value = "-" if cell["value"] is None else f"{cell['value']:.3f} ({cell['low']:.2f} to {cell['high']:.2f})"
        of_mu_c.append((name, f"{cell['sensor']:.3f} (sensor)", value, "", cell.get("held", "-"), ""))
    lines += ["", *markdown(("mu_c of", "truth", "median", "within 10 %", "interval holds it", "given"), of_mu_c)]
    lines += ["", *spoilt.report(summary["screened"]), "", *choice.report(summary["choice"]), ""]
    return "\n".join(lines)
