"""The command `recognize`."""

import sys
from collections.abc import Iterator
from typing import Any

from pushfric_core.bags.recorded import Recorded
from pushfric_core.commands.application import Application
from pushfric_core.commands.console import warn
from pushfric_core.commands.options import (
    CellOption,
    GridOption,
    Input,
    JsonOption,
    ObjectOption,
    PartialFlag,
    SupportPointsOption,
)
from pushfric_core.commands.result import answer
from pushfric_core.commands.settings_options import with_settings
from pushfric_core.errors import InvalidInput
from pushfric_core.estimation.estimator import last, taken
from pushfric_core.estimation.recognition import Recognizer
from pushfric_core.files.estimator_settings import ChosenSettings
from pushfric_core.offline.inputs import object_of, with_support


def recognize(
    source: Input,
    settings: ChosenSettings,
    object_name: ObjectOption = "",
    grid: GridOption = None,
    support_points: SupportPointsOption = None,
    partial: PartialFlag = False,
    namespace: CellOption = None,
    json: JsonOption = None,
) -> None:
    recorded = Recorded(source, namespace)
    chosen = settings.over(recorded.settings)
    model, where = object_of(source, object_name, warn)
    model = with_support(model, grid, support_points)
    if not model.hypotheses:
        raise InvalidInput(f"{where} names no hypotheses; expected a list of them under hypotheses")
    reading = recorded.read(model, chosen, warn, partial)
    data = chosen.relied_on(reading.observations, model.support_points, warn)
    ranking = last(taken(Recognizer(model.hypotheses, chosen.estimator).add, data, warn))
    for ranked in ranking.hypotheses:
        if ranked.contradiction is not None:
            warn(f"{ranked.name}: {ranked.contradiction}")
    names = ("name", "fit_error", "ratio", "feasible")
    found = [{name: getattr(hypothesis, name) for name in names} for hypothesis in ranking.hypotheses]
    figures = {"best": ranking.best, "hypotheses": found}
    answer(figures, json, _lines(figures))
    if reading.ledger.doubts and not partial:
        sys.exit(1)


app = Application()
app.command()(with_settings(recognize, without=("tie_break",)))


def _lines(figures: dict[str, Any]) -> Iterator[str]:
    for hypothesis in figures["hypotheses"]:
        fit = f"fit {hypothesis['fit_error']:.4g}, ratio {hypothesis['ratio']:.3f}"
        yield f"{hypothesis['name']}: {fit if hypothesis['feasible'] else 'infeasible'}"
    yield f"best: {figures['best'] or 'none is feasible'}"
