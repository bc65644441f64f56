"""The commands `view` and `report`."""

import pathlib
import sys
import tempfile
import threading
import time
from typing import Annotated

import typer

from pushfric_core.bags.recorded import check_source
from pushfric_core.cell.node_settings import REPORT_FILE, VIEW_PORT, ViewConfig
from pushfric_core.commands.application import Application
from pushfric_core.commands.console import say, warn
from pushfric_core.commands.options import CellOption, Input, ObjectOption, PartialFlag
from pushfric_core.estimation.estimate import Estimate
from pushfric_core.estimation.estimate_report import EstimateReport
from pushfric_core.files.disk import write_whole
from pushfric_core.files.object_file import ObjectModel
from pushfric_core.page.run_server import Server
from pushfric_core.page.story import Change, Story
from pushfric_core.trajectories.observation import Observation
from pushfric_core.wording import counted

BETWEEN = 0.5
"""Time between two changes of the page while the run is read [s]."""

app = Application()


@app.command()
def view(
    source: Input,
    port: Annotated[int, typer.Option(help=f"Port on this machine; 0: {VIEW_PORT}, or a free one.", min=0, max=65535)] = 0,
    object_name: ObjectOption = "",
    partial: PartialFlag = False,
    namespace: CellOption = None,
) -> None:
    """Ctrl-C ends it; other machines can be given the file that report writes."""
    check_source(source)  # before an address is printed
    with tempfile.TemporaryDirectory() as folder:
        report = pathlib.Path(folder) / REPORT_FILE
        over = {"done": False, "message": "the run is over"}
        server = Server(ViewConfig(port=port), lambda request: request.answer(over), lambda looking: None, report)
        try:
            say(f"view: {server.url} (Ctrl-C ends it)")
            server.show({"recorded": True, "reading": [f"Reading {source} …", ""]})
            from pushfric_core.offline.estimation import Choices, estimate_from  # imported late: a page is shown before
            from pushfric_core.page.report import beginning, in_one_file, told_again

            story: Story | None = None
            waiting, shown_at, all_told = Change(), 0.0, threading.Event()

            def show_read(model: ObjectModel, observation: Observation, estimate: Estimate) -> None:
                """Show what was observed, and now and then what follows from it."""
                nonlocal story, waiting, shown_at
                if story is None:
                    story, waiting = beginning(model, observation)
                waiting |= story.on_observation(observation)
                if time.monotonic() - shown_at > BETWEEN:
                    waiting |= story.on_estimate(EstimateReport.of(estimate, model.name, None))
                    far = f"{counted(estimate.pushes, 'push', 'pushes')} so far"
                    server.show(waiting | {"reading": [f"Reading {source} …", far]})
                    waiting, shown_at = Change(), time.monotonic()

            choices = Choices(object_name, partial=partial, namespace=namespace)
            estimation = estimate_from(source, choices, warn, whole_course=True, on_estimate=show_read)
            seen = 0
            for change, jpeg in told_again(estimation):
                waiting |= change
                seen += any(key.startswith("moment/") for key in change)
                if jpeg or time.monotonic() - shown_at > BETWEEN:
                    far = f"{seen} of {counted(len(estimation.data), 'observation')}"
                    server.show(waiting | {"reading": ["Estimating again, moment by moment …", far]}, jpeg)
                    waiting, shown_at = Change(), time.monotonic()
            server.show(waiting | {"reading": None})
            server.call(all_told.set)
            all_told.wait()
            report.write_text(in_one_file(server.broadcast), encoding="utf-8")
            server.show({"reported": True})
            threading.Event().wait()
        finally:
            server.close()


@app.command()
def report(
    source: Input,
    html: Annotated[pathlib.Path, typer.Option(help="File to write: a page that needs no other file.")],
    object_name: ObjectOption = "",
    partial: PartialFlag = False,
    namespace: CellOption = None,
) -> None:
    """Exit code 1: the page says not to use the estimate, or the bag does not add up."""
    from pushfric_core.offline.estimation import Choices, estimate_from  # imported late, as above
    from pushfric_core.page.report import report as page_of

    estimation = estimate_from(source, Choices(object_name, partial=partial, namespace=namespace), warn, whole_course=True)
    write_whole(html, page_of(estimation, html))
    say(f"wrote {html}")
    if not estimation.result.verdict.use or (estimation.ledger.doubts and not partial):
        sys.exit(1)
