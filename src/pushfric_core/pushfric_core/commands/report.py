"""The command `report`."""

import pathlib
import sys
from typing import Annotated

import typer

from pushfric_core.commands.application import Application
from pushfric_core.commands.console import say, warn
from pushfric_core.commands.options import CellOption, Input, ObjectOption, PartialFlag
from pushfric_core.files.whole_file import write_whole
from pushfric_core.offline.estimation import Choices, estimate_from

app = Application()


@app.command()
def report(
    source: Input,
    html: Annotated[pathlib.Path, typer.Option(help="File to write: a page that needs no other file.", show_default=False)],
    object_name: ObjectOption = "",
    partial: PartialFlag = False,
    namespace: CellOption = None,
) -> None:
    """Exit code 1: the page says not to use the estimate, or the bag does not add up."""
    from pushfric_core.page.report import report as page_of  # imported late: it draws

    estimation = estimate_from(source, Choices(object_name, partial=partial, namespace=namespace), warn, whole_course=True)
    write_whole(html, page_of(estimation, html, namespace))
    say(f"wrote {html}")
    if not estimation.verdict.use or (estimation.ledger.doubts and not partial):
        sys.exit(1)
