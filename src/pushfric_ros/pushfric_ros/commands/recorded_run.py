"""The bag of a run: where it goes, what an interrupted run leaves in it, and the course of its estimates."""

import pathlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from pushfric_core.cell.node_settings import REPORT_FILE
from pushfric_core.commands.console import warn
from pushfric_core.errors import PushfricError
from pushfric_core.estimation.push_plan import index_of, number_of
from pushfric_core.files.disk import write_whole
from pushfric_core.trajectories.ledger import DoubtCode
from pushfric_core.wording import counted
from pushfric_msgs.msg import FrictionEstimate, PlanProgress

if TYPE_CHECKING:
    from rich.console import Console

    from pushfric_core.geometry.table_1 import TableObject
    from pushfric_core.offline.estimation import Estimation

FIGURE_FILE, MODEL_FILE = "figure.png", "model.yaml"


class Result(NamedTuple):
    """The result of a run, from its bag alone."""

    estimation: "Estimation | None"  # None: the bag gives none
    doubts: list[str]  # in words: what is missing from the bag, or why it gives no estimate


def result_of(bag: pathlib.Path) -> Result:
    """The result of a run, however it ended."""
    from pushfric_core.bags.bag import DamagedBag  # not before the run has ended: it would hold 10 MB meanwhile
    from pushfric_core.offline.estimation import Choices, estimate_from

    try:
        try:
            return Result(estimate_from(bag, Choices(), warn, whole_course=True), [])
        except DamagedBag as damage:
            return Result(estimate_from(bag, Choices(partial=True), warn, whole_course=True), [str(damage)])
    except PushfricError as error:
        return Result(None, [f"the bag {bag} gives no estimate: {error}"])


def left_behind(bag: pathlib.Path, had_an_end: bool = True) -> str:
    """The remains of an interrupted run, in words; one that would have had no end has ended well."""
    if not bag.exists() or not any(bag.iterdir()):
        return "interrupted before there was a bag"
    result = result_of(bag)
    if result.estimation is None:
        return result.doubts[0]
    try:
        write_result(bag, result, ["the run was interrupted"] if had_an_end else [])
    except PushfricError as error:
        return f"bag left in {bag}; no report: {error}"
    pushes, how = len({point.push_id for point in result.estimation.data}), " --partial" * bool(result.doubts)
    return f"report: {bag / REPORT_FILE}\nbag left in {bag} (pushes: {pushes}); ./pushfric estimate {bag}{how} reads it"


def disagreements(result: Result, live: FrictionEstimate | None, planned: int, aborted: int) -> list[str]:
    """Contradictions between the bag, the live estimate and the plan of a finished run, in words; empty if all agree.

    Args:
        result: of the run.
        live: the last estimate that the run published; None if there was none.
        planned: number of pushes that the run was to carry out.
        aborted: number of those that did not reach their end.
    """
    said = [f"{aborted} of {counted(planned, 'push was', 'pushes were')} aborted"] if aborted else []
    said += result.doubts
    if result.estimation is None:
        return said
    said += [one.text for one in result.estimation.ledger.doubts]
    last, bag = result.estimation.result, result.estimation.recorded.path
    counts, live_counts = (last.data_points, last.pushes), (0, 0) if live is None else (live.data_points, live.pushes)
    if live is not None and live.object != result.estimation.model.name:
        said.append(f"the live estimate is of {live.object}, what is written here of {result.estimation.model.name}")
    if counts != live_counts:
        said.append(
            "one of bag and live estimate missed messages, or the estimate was begun again: it has {} observations of {} "
            "pushes, the bag {} of {}; read the bag with ./pushfric estimate {}".format(*live_counts, *counts, bag)
        )
    return said


def failures(bag: pathlib.Path, namespace: str, result: Result) -> list[str]:
    """Failures of a finished run that its bag shows, in words; empty without any.

    Args:
        bag: folder of the bag.
        namespace: of the cell.
        result: of the run.
    """
    from pushfric_core.bags.bag import Bag

    live: FrictionEstimate | None = None
    course: list[PlanProgress] = []
    try:
        recorded = Bag(bag)
        for message in recorded.messages([f"{namespace}/plan_progress", f"{namespace}/friction_estimate"]):
            msg = recorded.deserialize(message)
            if message.topic.endswith("plan_progress"):
                course.append(msg)
            else:
                live = msg if msg.status != FrictionEstimate.STATUS_NO_DATA else None
    except (PushfricError, ValueError) as error:
        return [f"the bag {bag} does not say how the run went: {error}"]
    number = number_of(course[-1].push_id, course[-1].count) if course else ""
    if not course or course[-1].phase != PlanProgress.PHASE_FINISHED:
        return [f"the plan is not finished: it stood at push {number}" if course else "no plan was begun"]
    return disagreements(result, live, pushes_of(course[0]), course[-1].aborted)


def pushes_of(first: PlanProgress) -> int:
    """Number of pushes that a run is to carry out, by the first progress of its plan that was heard of."""
    return first.count - index_of(first.push_id, first.count) + first.completed + first.aborted + first.skipped


def write_result(bag: pathlib.Path, result: Result, doubts: Sequence[str], known: "TableObject | None" = None) -> None:
    """Write page, figure and model of a run, if it gave an estimate, into its bag's folder.

    Args:
        bag: folder of the bag.
        result: of the run.
        doubts: what was wrong with the run, in words; they stand on top, with those about the bag.
        known: the simulated object.
    Raises:
        PushfricError: they cannot be written.
    """
    from pushfric_core.files.figure_file import save_figure  # not before the run has ended, as above
    from pushfric_core.page.report import figure_of, model_of, report

    if (estimation := result.estimation) is None:
        return
    told = [one.text for one in estimation.ledger.doubts]
    for doubt in (*doubts, *result.doubts):
        if doubt not in told:
            estimation.ledger.doubt(DoubtCode.RUN_FAILED, doubt)
            told.append(doubt)
    figure = figure_of(estimation, known)
    write_whole(bag / REPORT_FILE, report(estimation, bag / REPORT_FILE, figure))
    save_figure(figure, bag / FIGURE_FILE)
    if model := model_of(estimation):
        write_whole(bag / MODEL_FILE, model)


def print_result(console: "Console", bag: pathlib.Path) -> None:
    """Name what a run has left."""
    for what, name in {"figure: ": FIGURE_FILE, "model:  ": MODEL_FILE, "report: ": REPORT_FILE, "bag:    ": ""}.items():
        if (bag / name).exists():
            console.print(f"{what}{bag / name}", markup=False)
