"""The bag of a run: where it goes, what an interrupted run leaves in it, and the course of its estimates."""

import pathlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

from pushfric_core.cell.node_settings import REPORT_FILE
from pushfric_core.commands.console import warn
from pushfric_core.errors import PushfricError
from pushfric_core.estimation.batch import taken
from pushfric_core.estimation.push_plan import index_of, number_of
from pushfric_core.files.disk import write_whole
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.object_file import OBJECT_FILE, ObjectModel, load_object
from pushfric_core.trajectories.ledger import DoubtCode
from pushfric_core.wording import counted
from pushfric_msgs.msg import FrictionEstimate, PlanProgress

if TYPE_CHECKING:
    from rich.console import Console

    from pushfric_core.bags.recorded import Reading
    from pushfric_core.geometry.table_1 import TableObject
    from pushfric_core.offline.estimation import Estimation

FIGURE_FILE, MODEL_FILE = "figure.png", "model.yaml"


def left_behind(bag: pathlib.Path) -> str:
    """The remains of an interrupted run, in words."""
    if not bag.exists() or not any(bag.iterdir()):
        return "interrupted before there was a bag"
    try:
        data = write_result(bag, ["the run was interrupted"]).data
    except PushfricError as error:
        return f"bag left in {bag}, which gives no estimate: {error}"
    from pushfric_core.bags.bag import Bag  # not before the run has ended, as below

    pushes, how = len({point.push_id for point in data}), " --partial" * (Bag(bag).damage is not None)
    return f"report: {bag / REPORT_FILE}\nbag left in {bag} (pushes: {pushes}); ./pushfric estimate {bag}{how} reads it"


def disagreements(bag: pathlib.Path, live: FrictionEstimate | None, planned: int, aborted: int) -> list[str]:
    """Contradictions between the bag, the live estimate and the plan of a finished run, in words; empty if all agree.

    Args:
        bag: folder of the bag.
        live: the last estimate that the run published; None if there was none.
        planned: number of pushes that the run was to carry out.
        aborted: number of those that did not reach their end.
    """
    said = [f"{aborted} of {counted(planned, 'push was', 'pushes were')} aborted"] if aborted else []
    try:
        model, settings, reading = _recorded(bag)
    except PushfricError as error:
        return [*said, f"the bag {bag} gives no estimate: {error}"]
    said += [one.text for one in reading.ledger.doubts]
    estimator = settings.new_estimator(model.support_points)
    # the node has reported the observations that it refused
    counts = (0, 0)
    for estimate in taken(estimator.add, reading.observations, lambda _: None):
        counts = estimate.data_points, estimate.pushes
    live_counts = (0, 0) if live is None else (live.data_points, live.pushes)
    if counts != live_counts:
        said.append(
            "the live estimate missed messages that are in the bag, or the other way round: it has {} observations of {} "
            "pushes, the bag {} of {}; read the bag with ./pushfric estimate {}".format(*live_counts, *counts, bag)
        )
    return said


def failures(bag: pathlib.Path, namespace: str) -> list[str]:
    """Failures of a finished run that its bag shows, in words; empty without any.

    Args:
        bag: folder of the bag.
        namespace: of the cell.
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
            elif msg.status != FrictionEstimate.STATUS_NO_DATA:
                live = msg
    except (PushfricError, ValueError) as error:
        return [f"the bag {bag} does not say how the run went: {error}"]
    number = number_of(course[-1].push_id, course[-1].count) if course else ""
    if not course or course[-1].phase != PlanProgress.PHASE_FINISHED:
        return [f"the plan is not finished: it stood at push {number}" if course else "no plan was begun"]
    return disagreements(bag, live, pushes_of(course[0]), course[-1].aborted)


def pushes_of(first: PlanProgress) -> int:
    """Number of pushes that a run is to carry out, by the first progress of its plan that was heard of."""
    return first.count - index_of(first.push_id, first.count) + first.completed + first.aborted + first.skipped


def write_result(bag: pathlib.Path, doubts: Sequence[str], known: "TableObject | None" = None) -> "Estimation":
    """Write page, figure and model of a run, however it ended, into its bag's folder.

    Args:
        bag: folder of the bag.
        doubts: what was wrong with the run, in words; they stand on top, with those about the bag.
        known: the simulated object.
    Returns:
        The estimation.
    Raises:
        PushfricError: the bag gives no estimate.
    """
    from pushfric_core.bags.bag import DamagedBag  # not before the run has ended, as below
    from pushfric_core.offline.estimation import Choices, estimate_from
    from pushfric_core.page.report import draw, model_of, report

    try:
        estimation = estimate_from(bag, Choices(), warn, whole_course=True)
    except DamagedBag as damage:
        estimation = estimate_from(bag, Choices(partial=True), warn, whole_course=True)
        doubts = [*doubts, str(damage)]
    told = [one.text for one in estimation.ledger.doubts]
    for doubt in doubts:
        if doubt not in told:
            estimation.ledger.doubt(DoubtCode.RUN_FAILED, doubt)
    write_whole(bag / REPORT_FILE, report(estimation, bag / REPORT_FILE))
    draw(estimation, bag / FIGURE_FILE, known)
    if model := model_of(estimation):
        write_whole(bag / MODEL_FILE, model)
    return estimation


def print_result(console: "Console", bag: pathlib.Path) -> None:
    """Name what a run has left."""
    for what, name in {"figure: ": FIGURE_FILE, "model:  ": MODEL_FILE, "report: ": REPORT_FILE}.items():
        if (bag / name).exists():
            console.print(f"{what}{bag / name}", markup=False)
    console.print(f"bag:    {bag}", markup=False)


def _recorded(bag: pathlib.Path) -> "tuple[ObjectModel, EstimatorSettings, Reading]":
    """The object of a bag, the settings it was estimated with, and what it gives."""
    from pushfric_core.bags.recorded import Recorded  # not before the run has ended: it would hold 10 MB meanwhile

    model, recorded = load_object(str(bag / OBJECT_FILE)), Recorded(bag)
    return model, recorded.settings, recorded.read(model, recorded.settings, lambda _: None)
