"""How a run went, from its bag alone."""

import contextlib
import pathlib
import shutil
import time
import types

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rich.console import Console
from rich.live import Live

from pushfric_core.bags.bag import Bag
from pushfric_msgs.msg import EstimatorProgress, FrictionEstimate, PlanProgress
from pushfric_ros.commands import watch
from pushfric_ros.commands.recorded_run import failures, result_of, write_result
from pushfric_ros.graph.supervisor import Ended

DEMO = pathlib.Path(__file__).parents[3] / "bags/rubber_rect4"


def test_a_run_whose_plan_bag_and_estimate_agree_has_not_failed():
    assert failures(DEMO, "/cell", result_of(DEMO)) == []


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("aborted", 2, "2 of 14 pushes were aborted"),
        ("phase", PlanProgress.PHASE_PUSHING, "the plan is not finished: it stood at push 14"),
        ("push_id", 77, "no observation came from push 8 (again)"),
    ],
)
def test_what_went_wrong_is_in_the_bag(monkeypatch, tmp_path, field, value, said):
    """And in the result once, whoever saw it."""
    read = Bag.deserialize

    def changed(bag, message):
        msg = read(bag, message)
        if message.topic == "/cell/plan_progress" and (field != "aborted" or msg.phase == PlanProgress.PHASE_FINISHED):
            setattr(msg, field, value)
        return msg

    monkeypatch.setattr(Bag, "deserialize", changed)
    assert failures(DEMO, "/cell", result_of(DEMO))[0] == said
    bag = shutil.copytree(DEMO, tmp_path / "bag")
    write_result(bag, result := result_of(bag), [said])
    assert [doubt.text for doubt in result.estimation.ledger.doubts].count(said) == 1


def test_a_bag_without_a_plan_or_no_bag_is_a_failed_run(tmp_path):
    assert failures(DEMO, "/other", result_of(DEMO)) == ["no plan was begun"]
    (said,) = failures(tmp_path, "/cell", result_of(tmp_path))
    assert said.startswith(f"the bag {tmp_path} does not say how the run went: {tmp_path}: is not a bag")


def test_an_estimator_that_goes_on_is_awaited_after_the_end(monkeypatch):
    """On a busy machine it may be far behind the player, but each of its estimates comes within the patience."""
    wall = [0.0]
    monkeypatch.setattr(watch, "time", types.SimpleNamespace(monotonic=lambda: wall[0]))
    over = types.SimpleNamespace(poll=lambda: Ended(0, "player has finished"))
    with contextlib.closing(watch.Monitor(Console(quiet=True), "/awaited", "replaying", 1, live=False)) as monitor:

        def spin_once(_: float, last: int = 5) -> None:
            wall[0] += 0.9 * watch.PROGRESS_TIMEOUT
            count = min(last, 1 + monitor.complete)
            msg = FrictionEstimate(status=FrictionEstimate.STATUS_OPTIMAL, data_points=count, pushes=1)
            msg.contact_friction.histogram = [count]
            msg.spread.data_points = count
            monitor._on_estimate(msg)

        monkeypatch.setattr(monitor._visit, "spin_once", spin_once)
        assert monitor.watch(over, lambda: monitor.complete == 5).code == 0
        assert monitor.complete == 5
        begin = wall[0]
        monitor.watch(over, lambda: False)  # nothing new comes
        assert wall[0] - begin < 3 * watch.PROGRESS_TIMEOUT


def test_a_last_estimate_that_is_late_is_awaited_though_its_stamp_is_that_of_the_one_before():
    """A push was left out when half of it was seen; at rest it is taken back, and the word of that may come first."""
    with contextlib.closing(watch.Monitor(Console(quiet=True), "/late", "pushing", None, live=False)) as monitor:
        before, after = (
            FrictionEstimate(status=FrictionEstimate.STATUS_OPTIMAL, data_points=count, pushes=pushes)
            for count, pushes in ((79, 7), (91, 8))
        )
        for msg in (before, after):
            msg.contact_friction.histogram, msg.spread.data_points = [msg.data_points], msg.data_points
        monitor._on_progress(PlanProgress(phase=PlanProgress.PHASE_FINISHED, count=8, completed=8))
        monitor._on_estimate(before)
        monitor._visit.node._on_estimator_progress(EstimatorProgress(data_points=91, judged=True))
        assert not monitor.settled()
        monitor._on_estimate(after)
        assert monitor.settled()
        monitor._visit.node._on_estimator_progress(EstimatorProgress(judged=True))
        monitor._on_estimate(FrictionEstimate(status=FrictionEstimate.STATUS_NO_DATA))  # all pushes were left out
        assert monitor.estimate is None
        assert monitor.settled()


def test_a_prompt_goes_with_the_node_that_gave_it(monkeypatch):
    console = Console(width=100)
    with contextlib.closing(watch.Monitor(console, "/silent", "pushing", None, live=True)) as monitor:
        monitor._on_progress(PlanProgress(phase=PlanProgress.PHASE_PLACING, count=3, message="move it by about 20 mm"))
        node = monitor._visit.node
        node._on_diagnostics(DiagnosticArray(status=[DiagnosticStatus(name="/silent/experiment")]))

        def shown() -> str:
            with console.capture() as captured:
                console.print(monitor._view())
            return captured.get()

        assert "20 mm" in shown()
        now = time.monotonic()
        monkeypatch.setattr(time, "monotonic", lambda: now + 3.1)
        assert "20 mm" not in shown()
        assert "the experiment does not report" in shown()
        monitor._on_progress(PlanProgress(phase=PlanProgress.PHASE_FINISHED, count=3, message="3 of 3 pushes done"))
        assert "3 of 3 pushes done" in shown()  # it has said all it had to


def test_what_a_run_without_prompts_awaits_is_printed_once_it_takes_long(monkeypatch):
    console = Console(width=100)
    wall = [0.0]
    monkeypatch.setattr(watch, "time", types.SimpleNamespace(monotonic=lambda: wall[0]))
    with (
        contextlib.closing(watch.Monitor(console, "/waits", "pushing", None, live=False)) as monitor,
        console.capture() as said,
    ):
        for message in ("waiting for: tracker", "push 1 of 3: place the object\x1b[2J"):
            monitor._on_progress(PlanProgress(phase=PlanProgress.PHASE_PLACING, count=3, message=message))
            wall[0] += 0.9 * watch.PATIENCE
            monitor._tell()  # not yet
        for _ in range(2):
            wall[0] += 0.2 * watch.PATIENCE
            monitor._tell()  # once
    assert said.get() == "push 1 of 3: place the object?[2J\n"  # nothing from a topic steers the terminal


def test_each_number_of_pushes_has_one_line_though_a_push_is_left_out_for_a_while():
    wide = Console(record=True, width=200)
    with contextlib.closing(watch.Monitor(wide, "/lines", "replaying", 9, live=False)) as monitor:
        for pushes, count in ((1, 5), (1, 6), (2, 9), (1, 6), (2, 11), (3, 15), (4, 20)):
            monitor._on_estimate(FrictionEstimate(status=FrictionEstimate.STATUS_OPTIMAL, data_points=count, pushes=pushes))
        lines = [line.split()[:3] for line in wide.export_text().splitlines()]
        assert lines == [["push", "1", "6"], ["push", "2", "11"], ["push", "3", "15"]]  # the fourth may not be whole
        monitor._on_estimate(FrictionEstimate(status=FrictionEstimate.STATUS_NO_DATA))
        for pushes in (1, 2):
            monitor._on_estimate(FrictionEstimate(status=FrictionEstimate.STATUS_OPTIMAL, data_points=7, pushes=pushes))
        assert wide.export_text().split()[:3] == ["push", "1", "7"]


def test_a_prompt_is_not_cut_by_the_end_of_the_line():
    """As the console of the commands would, which leaves it to the terminal to wrap what they print."""
    text = "push 3 of 14: place the object at x 0 mm, y 40 mm, turned by 0 degrees: move it by about 30 mm"
    narrow = Console(record=True, soft_wrap=True, width=80)
    with contextlib.closing(watch.Monitor(narrow, "/prompt", "pushing", None, live=True)) as monitor:
        monitor._on_progress(PlanProgress(phase=PlanProgress.PHASE_PLACING, count=14, message=text))
        with Live(monitor._view(), console=narrow):
            pass
    assert text in " ".join(line.strip() for line in narrow.export_text().splitlines())
