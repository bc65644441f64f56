"""The command `estimate`."""

import dataclasses
import pathlib
import sys
from typing import Annotated

import typer

from pushfric_core.commands.application import STDOUT, Application
from pushfric_core.commands.console import console, say, warn
from pushfric_core.commands.options import (
    CellOption,
    DaskOption,
    GridOption,
    JobsOption,
    JsonOption,
    LedgerOption,
    ObjectOption,
    PartialFlag,
    SupportPointsOption,
)
from pushfric_core.commands.result import answer, ledger_table, print_result
from pushfric_core.commands.settings_options import with_settings
from pushfric_core.errors import InvalidInput
from pushfric_core.files.estimator_settings import ChosenSettings
from pushfric_core.files.model_file import check_name, save_model
from pushfric_core.offline.estimation import Choices, estimate_from


def estimate(
    inputs: Annotated[
        list[pathlib.Path], typer.Argument(metavar="INPUT", help="Bag (folder or .mcap), or CSV of observations.")
    ],
    settings: ChosenSettings,
    object_name: ObjectOption = "",
    grid: GridOption = None,
    support_points: SupportPointsOption = None,
    figure: Annotated[
        pathlib.Path | None, typer.Option(help="Draw pushes, w, mu_c and p_CF to this file (.png, .svg, .pdf).")
    ] = None,
    save: Annotated[
        pathlib.Path | None, typer.Option(help="Write the estimate to this file (.yaml), as a model for predict and stable.")
    ] = None,
    partial: PartialFlag = False,
    namespace: CellOption = None,
    samples: Annotated[bool, typer.Option("--samples", help="Add weighted samples of w and mu_c to the JSON.")] = False,
    out: Annotated[
        pathlib.Path | None, typer.Option(help="Folder to write: a table and models, from many inputs or folders of inputs.")
    ] = None,
    jobs: JobsOption = -1,
    dask: DaskOption = None,
    json: JsonOption = None,
    ledger: LedgerOption = None,
) -> None:
    """Exit code 1: do not use an estimate, or the bag does not add up; warnings say why.

    With --out, an input that cannot be read does not stop the others. If you interrupt the command, call it again: it goes on.
    """
    choices = Choices(object_name, grid, support_points, settings, partial, namespace)
    if out is not None:
        if figure is not None or save is not None or ledger is not None or samples:
            raise InvalidInput("--figure, --save, --ledger and --samples are for one input; --out writes models and a table")
        if not _many(inputs, choices, out, jobs, dask, json):
            sys.exit(1)
        return
    if dask is not None:
        raise InvalidInput("--dask is for many inputs: give --out DIR, too")
    if len(inputs) > 1:
        raise InvalidInput(f"got {len(inputs)} inputs; expected one, or --out DIR for the results of many")
    if save is not None:
        check_name(save)
    if figure is not None:
        # imported late: loading matplotlib takes longer than estimating most bags
        from pushfric_core.files.figure_file import check_image_name, save_figure
        from pushfric_core.page.report import figure_of

        check_image_name(figure)
    estimation = estimate_from(inputs[0], choices, warn, whole_course=figure is not None)
    result = estimation.result
    for reason in result.verdict.reasons:
        warn(reason.text)
    if figure is not None:
        save_figure(figure_of(estimation), figure)
    if save is not None:
        if result.contradiction is not None:
            raise InvalidInput(f"{save}: not written: {result.contradiction}")
        save_model(estimation.to_model(), save)
    figures = estimation.figures()
    if samples:
        figures["belief"]["samples"] = [] if result.belief is None else result.belief.samples
    if ledger is not None:
        figures["ledger"] = estimation.ledger.to_dict()
    if ledger == STDOUT:
        console.print(ledger_table(estimation.ledger))
    else:
        answer(estimation.ledger.to_dict(), ledger)
    print_result(figures, json, estimation.settings.estimator.loss)
    if not result.verdict.use or (estimation.ledger.doubts and not partial):
        sys.exit(1)


def _many(
    sources: list[pathlib.Path], choices: Choices, out: pathlib.Path, jobs: int, dask: str | None, json: str | None
) -> bool:
    # imported late: one estimate needs no bar
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    from pushfric_core.offline.many import TABLE, Line, counts, estimate_many, inputs_of, objections, write_table

    if pathlib.Path(choices.object_name).is_file():
        choices = dataclasses.replace(choices, object_name=str(pathlib.Path(choices.object_name).absolute()))
    if choices.support_points is not None:
        choices = dataclasses.replace(choices, support_points=choices.support_points.absolute())
    inputs = [one for one in inputs_of(sources) if one != (out / TABLE).absolute()]  # of an earlier call
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[broken]} broken"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("estimating", total=len(inputs), broken=0)

        def finished(line: Line) -> None:
            broken = progress.tasks[task].fields["broken"] + ("error" in line)
            progress.update(task, advance=1, broken=broken)

        lines = estimate_many(inputs, choices, out, jobs, dask, finished)
    for line in lines:
        where = f"{line['input']}: "
        if said := [line["error"]] if "error" in line else [one["text"] for one in objections(line)]:
            warn(where + "; ".join(said).removeprefix(where))
    table, number = write_table(lines, out), counts(lines)
    answer(number | {"files": [str(table)]}, json)
    if json != STDOUT:
        console.print(", ".join(f"{name.replace('_', ' ')}: {count}" for name, count in number.items()), highlight=False)
        say(f"wrote {table}")
    return number["usable"] == number["inputs"]


app = Application()
app.command()(with_settings(estimate))
