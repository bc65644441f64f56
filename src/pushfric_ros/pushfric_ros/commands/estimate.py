"""The command `estimate`."""

import pathlib
import sys
from collections import deque
from typing import Annotated

import typer

from pushfric_core.errors import InvalidInput
from pushfric_core.estimator import Estimator
from pushfric_ros.bags import data_points
from pushfric_ros.commands.console import warn
from pushfric_ros.commands.inputs import object_of, with_support
from pushfric_ros.commands.options import GridOption, Input, JsonFlag, ObjectOption, PartialFlag, SupportPointsOption
from pushfric_ros.commands.result import print_result
from pushfric_ros.commands.settings_options import with_settings
from pushfric_ros.files.estimator_settings import EstimatorSettings
from pushfric_ros.files.model_file import check_name, make_model, save_model
from pushfric_ros.messages.conversions import estimate_to_msg
from pushfric_ros.report.report import ensemble, report


def estimate(
    source: Input,
    settings: EstimatorSettings,
    object_name: ObjectOption = "",
    grid: GridOption = None,
    support_points: SupportPointsOption = None,
    figure: Annotated[
        pathlib.Path | None,
        typer.Option(help="Draw pushes, w, mu_c and p_CF to this file (.png, .svg, .pdf).", show_default=False),
    ] = None,
    save: Annotated[
        pathlib.Path | None, typer.Option(help="Write a model to keep there (.yaml), to predict with.", show_default=False)
    ] = None,
    partial: PartialFlag = False,
    samples: Annotated[bool, typer.Option("--samples", help="With --json, also weighted samples of w and mu_c.")] = False,
    json: JsonFlag = False,
) -> None:
    """Exit code 1: the estimate is not to be used; warnings say why."""
    if save is not None:
        check_name(save)
    model, _ = object_of(source, object_name)
    model = with_support(model, grid, support_points)
    data = data_points.observations(source, model, settings, warn, partial)
    estimator = Estimator(model.support_points, settings.estimator)
    # only the figure shows the estimates before the last
    course = deque(data_points.taken(estimator.add, data, warn), maxlen=None if figure is not None else 1)
    result = data_points.last(course)
    verdict = estimator.verdict(result)
    for reason in verdict.reasons:
        warn(reason)
    if figure is not None:
        from pushfric_ros.report.figures import (
            summary_figure,
        )  # imported late: loading matplotlib takes longer than estimating most bags

        summary_figure(figure, model.outline, course, estimator.observations, None, settings.slipping)
    if save is not None:
        if result.contradiction is not None:
            raise InvalidInput(f"{save}: not written: {result.contradiction}")
        save_model(make_model(model, result, estimator.observations, str(source), settings), save)
    slipping = [observation.push_id in settings.slipping for observation in estimator.observations]
    figures = report(estimate_to_msg(result, model.name, slipping, verdict))
    if samples:
        figures["samples"] = ensemble(result)
    print_result(figures, json, settings.estimator.loss)
    if not verdict.use:
        sys.exit(1)


app = typer.Typer(add_completion=False)
app.command()(with_settings(estimate))
