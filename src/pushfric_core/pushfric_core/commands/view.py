"""The command `view`."""

import pathlib
import tempfile
import threading
import time
from typing import Annotated

import typer

from pushfric_core.cell.node_settings import REPORT_FILE, VIEW_PORT, ViewConfig
from pushfric_core.commands.application import Application
from pushfric_core.commands.console import say, warn
from pushfric_core.commands.options import CellOption, Input, ObjectOption, PartialFlag
from pushfric_core.pages.run_server import Answer, Server
from pushfric_core.report.story import Change

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
    """Needs no node graph. Ctrl-C ends it; other machines can be given the file that report writes."""
    with tempfile.TemporaryDirectory() as folder:
        report = pathlib.Path(folder) / REPORT_FILE
        over = Answer(False, "the run is over")
        server = Server(ViewConfig(port=port), lambda request: request.answer(over), lambda looking: None, report)
        try:
            say(f"view: {server.url} (Ctrl-C ends it)")
            server.show({"recorded": True, "reading": f"Reading {source} …"})
            from pushfric_core.files.object_file import ObjectModel  # imported late: a page is shown before
            from pushfric_core.offline.estimation import Choices, estimate_from
            from pushfric_core.offline.run_page import beginning, run_page
            from pushfric_core.trajectories.observation import Observation

            waiting, seen, shown_at = Change(), 0, time.monotonic()

            def begin(model: ObjectModel, data: list[Observation]) -> None:
                """Show what was observed, before anything is estimated."""
                story, told = beginning(model, data)
                for observation in data:
                    told |= story.on_observation(observation)
                server.show(told | {"reading": f"Estimating from {source} …"})

            def show(change: Change, jpeg: bytes) -> None:
                nonlocal waiting, seen, shown_at
                waiting |= change
                seen += "estimate" in change
                if jpeg or time.monotonic() - shown_at > BETWEEN:
                    server.show(waiting | {"reading": f"Estimating from {source} again: {seen} observations so far"}, jpeg)
                    waiting, shown_at = Change(), time.monotonic()

            choices = Choices(object_name, partial=partial, namespace=namespace)
            estimation = estimate_from(source, choices, warn, whole_course=True, on_data=begin)
            report.write_text(run_page(estimation, namespace=namespace, show=show), encoding="utf-8")
            server.show(waiting | {"reading": None, "reported": True})
            threading.Event().wait()
        finally:
            server.close()
