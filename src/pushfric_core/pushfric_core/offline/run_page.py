"""An estimate as one self-contained HTML page, to be handed on."""

import base64
import csv
import dataclasses
import io
import math
import os
import pathlib
import tempfile
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

import pushfric_core
from pushfric_core.errors import PushfricError
from pushfric_core.estimation.batch import last, taken
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.model_file import as_yaml
from pushfric_core.mechanics.prediction import friction_model, prediction_errors
from pushfric_core.offline.estimation import Estimation
from pushfric_core.report.figures import summary_figure
from pushfric_core.report.page import Cell, Section, Table, number, page
from pushfric_core.trajectories.ledger import REASONS
from pushfric_core.trajectories.observation import Observation
from pushfric_core.wording import counted, data_of

TESTED = 0.25
"""Share of the pushes, the last ones, that are predicted from all others."""

EARLIEST = 1.1e18
"""Stamps before this time [ns] come from a simulated clock."""

FEWEST_LEARNT = 4
"""With fewer pushes to learn from, nothing is predicted."""


def run_page(estimation: Estimation, file: pathlib.Path) -> str:
    """The page of an estimate.

    Args:
        estimation: with the estimates after each data point.
        file: where the page will lie; its link to the recorded data counts from there.
    """
    figures, data = estimation.figures(), list(estimation.estimator.observations)
    drawing = _drawing(estimation)
    folder = os.path.relpath(estimation.source.resolve(), file.resolve().parent)
    stamps = [one.stamp for one in data if one.stamp]
    verdict = figures["verdict"]
    downloads = {
        "model.yaml": ("application/yaml", as_yaml(estimation.to_model()) if estimation.result.contradiction is None else ""),
        "observations.csv": ("text/csv", _table_of(estimation)),
        "figure.svg": ("image/svg+xml", drawing),
    }
    return page(
        "pushfric_core.report",
        "run.html.j2",
        name=figures["object"],
        data=data_of(figures["data_points"], figures["pushes"]),
        when=time.strftime("%Y-%m-%d", time.gmtime(stamps[0] * 1e-9)) if stamps and stamps[0] > EARLIEST else "",
        usable=verdict["use"],
        reasons=[one["text"] for one in (*verdict["reasons"], *verdict["notes"])],
        cards=_cards(figures),
        downloads=[(name, kind, base64.b64encode(text.encode()).decode()) for name, (kind, text) in downloads.items() if text],
        bag=folder,
        sections=[
            Section("figure", "Pushes, support friction, contact friction, centre of friction", ""),
            _predictions(estimation, data),
            _pushes(figures, data),
            Section("ledger", "What became of every message", "", _ledger(estimation)),
            Section("settings", "Settings", "Those that differ from the defaults are in bold.", _settings(estimation.settings)),
        ],
        figures={"figure": drawing[drawing.index("<svg") :]},
        version=pushfric_core.__version__,
        source=estimation.source.name,
    )


def _cards(figures: dict[str, Any]) -> list[Cell]:
    mu = figures["mu_c"]
    x, y = (1e3 * value for value in figures["center_of_friction"])
    trust = f"within {number(1e3 * figures['confidence'])} mm with 90 % probability" if "confidence" in figures else ""
    if mu.get("value") is None:
        friction = Cell(f"≥ {number(mu['p90'])}", "contact friction mu_c", spread="a lower bound (90 % of the observations)")
    else:
        low, high = mu["interval"]
        friction = Cell(number(mu["value"]), "contact friction mu_c", spread=f"{number(low)} to {number(high)} with 90 %")
    solved = f"{figures['status']}, gap {1e3 * figures['gap']:.0e} mm"
    return [
        Cell(f"({number(x)}, {number(y)}) mm", "centre of friction p_CF", spread=trust),
        friction,
        Cell(f"{number(1e3 * figures['objective'], 3)} mm", "fit error", spread=solved),
        Cell(f"{figures['data_points']}", "observations", spread=f"of {counted(figures['pushes'], 'push', 'pushes')}"),
    ]


def _predictions(estimation: Estimation, data: Sequence[Observation]) -> Section:
    """The motion of the last pushes, predicted from those before them."""
    title = "Predictions tested on the last pushes"
    pushes = list(dict.fromkeys(one.push_id for one in data))
    tested = pushes[len(pushes) - math.ceil(TESTED * len(pushes)) :]
    learnt = [one for one in data if one.push_id not in tested]
    if len(pushes) - len(tested) < FEWEST_LEARNT:
        return Section("predictions", title, f"Not tested: fewer than {FEWEST_LEARNT} pushes would be left to learn from.")
    estimator = dataclasses.replace(estimation.settings, kept=tuple(pushes)).new_estimator(estimation.estimator.support_points)
    try:
        before = last(list(taken(estimator.add, learnt, lambda _: None)))
        model = friction_model(before)
        errors = {push: prediction_errors(model, [one for one in data if one.push_id == push]) for push in tested}
    except PushfricError as error:
        return Section("predictions", title, f"Not tested: {error}")
    claimed = math.degrees(model.misfit)
    rows = [
        [
            Cell(str(push + 1)),
            Cell(str(len(angles))),
            Cell(number(math.degrees(float(np.median(angles))), 1)),
            Cell(number(math.degrees(float(angles.max())), 1)),
        ]
        for push, angles in errors.items()
    ]
    text = (
        f"The last {counted(len(tested), 'push', 'pushes')}, predicted from the {len(pushes) - len(tested)} before: the angle"
        " between the measured motion and the predicted one, as (velocity of p_CF, turn). The model expects 90 % of them below"
        f" {number(claimed, 1)}°."
    )
    return Section("predictions", title, text, Table(("push", "observations", "median [°]", "largest [°]"), rows))


def _pushes(figures: dict[str, Any], data: Sequence[Observation]) -> Section:
    rejected = {one["push"]: one["reason"]["text"] for one in figures["rejected"]}
    counts = {push: sum(one.push_id == push for one in data) for push in sorted({*(one.push_id for one in data), *rejected})}
    rows = [
        [Cell(str(push + 1)), Cell(str(count)), Cell(f"left out: {rejected[push]}" if push in rejected else "counts")]
        for push, count in counts.items()
    ]
    return Section("pushes", "Pushes", "", Table(("push", "observations", ""), rows))


def _ledger(estimation: Estimation) -> Table:
    sums = estimation.ledger.sums()
    rows = [
        [Cell(reason), *(Cell(str(account.get(reason, ""))) for account in sums.values())]
        for reason in ("received", *REASONS)
        if any(reason in account for account in sums.values())
    ]
    rows += [[Cell(f"✗ {doubt}")] for doubt in estimation.ledger.doubts]
    return Table(("", *sums), rows)


def _settings(settings: EstimatorSettings) -> Table:
    usual = EstimatorSettings().parameters()
    rows = []
    for name, value in sorted(settings.parameters().items()):
        text = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
        rows.append([Cell(name), Cell(text, tone="" if usual.get(name) == value else "better")])
    return Table(("setting", "value"), rows)


def _table_of(estimation: Estimation) -> str:
    rows = estimation.estimator.observations.to_rows()
    text = io.StringIO()
    writer = csv.DictWriter(text, rows[0])
    writer.writeheader()
    writer.writerows({name: "" if math.isnan(value) else value for name, value in row.items()} for row in rows)
    return text.getvalue()


def _drawing(estimation: Estimation) -> str:
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "figure.svg"
        data, slipping = estimation.estimator.observations, estimation.settings.slipping
        summary_figure(path, estimation.model.outline, estimation.course, data, None, slipping)
        return path.read_text()
